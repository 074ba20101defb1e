// g2p_pic_flip: velocities of the faces of a MAC grid to particles, hat kernel, FP32.
//
// For every particle and component: v' = (1 - flip) P(new) + flip (v + P(new) - P(old)), P(u) the trilinear
// interpolation of a field at the particle, indices clamped to the array.
//
// Passes over data in random order (references/blocks/tile_gather.cuh):
//   mark, count, plan, assign, place   a slot for each particle in its tile's list, its place in its cell
//   there gather   a block for a piece of a list. The tile in shared memory holds (1 - flip) new + flip (new
//   - old) for each face:
//            one interpolation instead of two. 3 numbers, 16 bytes, to the slot
//   finish   a thread a particle in the order of the input: fetches them and adds flip v
//
// What bounds it (33.0M particles): DRAM. count and assign 0.8 GB, place 1.06 GB, gather 1.3 GB, finish 2.0
// GB, half of that 32-byte sectors at random places.
//
// What pays: the two fields are read once for a tile and blended there, on differences of the faces, so that
// a change smaller than a step of the field is kept. v takes no part in the sort.
#include "cases/particle_grid/g2p_pic_flip.hpp"
#include "references/common/alignment.hpp"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/mac_gather.cuh"

namespace gpuphys::g2p_pic_flip {
namespace {

using mac_gather::kComponents;
constexpr int kOrder = 1;  // of the spline: hat
using Tiling = mac_gather::Tiling<kOrder>;

struct Policy {
  static constexpr int mark_threads = 256;
  static constexpr int mark_stride = 32;  // one row of 32 particles in so many
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int plan_threads = 128;
  static constexpr int count_threads = 512;
  static constexpr int count_shared = 40 * 1024;  // takes half the tiles of the paper's size
  static constexpr int place_threads = 128;
  static constexpr int gather_threads = 128;
  static constexpr int piece = 640;
  static constexpr int gather_blocks_per_sm = 8;
  static constexpr int finish_threads = 128;
#else
  static constexpr int plan_threads = 256;
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int place_threads = 256;
  static constexpr int gather_threads = 256;
  static constexpr int piece = 1024;  // a full tile: 41 KB of shared memory a block
  static constexpr int gather_blocks_per_sm = 5;
  static constexpr int finish_threads = 256;
#endif
};

/// What a face gives: the part of v' that does not come from v.
struct BlendedFaces {
  static constexpr int arrays = kComponents;
  const float* __restrict__ before[kComponents];
  const float* __restrict__ after[kComponents];
  int extent[kComponents][3];
  float flip;

  __device__ __forceinline__ float at(int c, std::int64_t i) const {
    const float now = __ldg(after[c] + i);
    return (1.0f - flip) * now + flip * (now - __ldg(before[c] + i));
  }
};

/// {part of v' 3, padding}
struct Interpolated {
  static constexpr int quads = 1, stride = 1;

  static __device__ __forceinline__ void evaluate(const mac_gather::Tile<kOrder>& tile,
                                                  const tiles::Placed& placed, float (&result)[4 * quads]) {
    result[0] = mac_gather::trilinear<0>(tile, placed);
    result[1] = mac_gather::trilinear<1>(tile, placed);
    result[2] = mac_gather::trilinear<2>(tile, placed);
    result[3] = 0.0f;
  }
};

__global__ void __launch_bounds__(Policy::finish_threads)
    finish(const float* __restrict__ v, float* __restrict__ v_new, std::int64_t n, float flip,
           const int* __restrict__ slots, const float4* __restrict__ results) {
  __shared__ float staging[Policy::finish_threads / 32][32 * 3];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::finish_threads + threadIdx.x;
  float4 result = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  if (p < n) result = __ldcs(results + __ldcs(slots + p));
  float own[3];
  load_rows(v, p - lane, n, own);
  transpose_rows(stage, own);
  const float sum[3] = {flip * own[0] + result.x, flip * own[1] + result.y, flip * own[2] + result.z};
  __syncwarp();
  store_rows(v_new, p - lane, n, stage, sum);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { gather_.allocate(grid_of(in), in.x.shape[0]); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("g2p_pic_flip", "x", in.x.data);  // counted by 16 bytes
    const std::int64_t n = in.x.shape[0];
    BlendedFaces faces{{in.ux_old.data, in.uy_old.data, in.uz_old.data},
                       {in.ux_new.data, in.uy_new.data, in.uz_new.data},
                       {},
                       in.flip};
    mac_gather::set_extents(faces.extent, in.ux_new, in.uy_new, in.uz_new);
    gather_.compute(grid_of(in), in.x.data, n, faces);
    finish<<<Gather::blocks(n, Policy::finish_threads), Policy::finish_threads>>>(
        in.v.data, out.v_new.data, n, in.flip, gather_.slots(), gather_.results());
  }

 private:
  using Gather = tiles::TileGather<Policy, Interpolated, Tiling, BlendedFaces>;

  static tiles::TileGrid grid_of(const Inputs& in) {
    return mac_gather::grid_of<kOrder>(in.ux_new, in.uy_new, in.uz_new, in.dx);
  }

  Gather gather_;
};

}  // namespace
}  // namespace gpuphys::g2p_pic_flip

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(g2p_pic_flip, g2p_pic_flip::Reference)
}
