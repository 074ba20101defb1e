// g2p_apic: velocities of the faces of a MAC grid to particles, with their affine state, quadratic B-splines,
// FP32.
//
// For every particle: v_c = sum w u_c and B_cb = sum w u_c (x_face - x_p)_b, indices clamped to the array,
// positions not.
//
// Passes over data in random order (references/blocks/tile_gather.cuh):
//   mark, count, plan, assign, place   a slot for each particle in its tile's list, its place in its cell
//   there gather   a block for a piece of a list, the tile's faces in shared memory: v and first moments per
//   cell, 12 numbers, to
//            the slot
//   finish   a thread a particle in the order of the input: fetches the 12 numbers and writes them in whole
//   lines
//
// What bounds it (33.0M particles): DRAM. count and assign 0.8 GB, place 1.06 GB, gather 2.7 GB, finish 3.8
// GB, more than half of that read at random places, 64 bytes each. In gather instructions (some 480 a
// particle) come next.
//
// What pays: rows of 36 and 12 bytes are never written at random places, where DRAM would read what is around
// them. A result is padded to two whole sectors, read by four lanes at once. Differences from the middle
// face, formed first: B keeps its digits in a smooth field.
#include "cases/particle_grid/g2p_apic.hpp"
#include "references/common/alignment.hpp"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/mac_gather.cuh"

namespace gpuphys::g2p_apic {
namespace {

using mac_gather::kComponents;
constexpr int kOrder = 2;  // of the spline: quadratic
using Tiling = mac_gather::Tiling<kOrder>;
using Source = tiles::Samples<kComponents>;

struct Policy {
  static constexpr int mark_threads = 256;
  static constexpr int mark_stride = 32;  // one row of 32 particles in so many
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int plan_threads = 128;
  static constexpr int count_threads = 512;
  static constexpr int count_shared = 40 * 1024;  // takes half the tiles of the paper's size
  static constexpr int place_threads = 128;
  static constexpr int gather_threads = 128;
  static constexpr int piece = 320;
  static constexpr int result_stride = 3;
  static constexpr int gather_blocks_per_sm = 6;
  static constexpr int finish_threads = 256;
#else
  static constexpr int plan_threads = 256;
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int place_threads = 256;
  static constexpr int gather_threads = 256;
  static constexpr int piece = 512;  // half a full tile: 41 KB of shared memory a block
  static constexpr int gather_blocks_per_sm = 4;
  static constexpr int result_stride = 4;  // float4: three, padded to two whole sectors
  static constexpr int finish_threads = 128;
#endif
};

/// {v 3, first moments in cells 9}
struct VelocityAndMoments {
  static constexpr int quads = 3, stride = Policy::result_stride;

  template <int C>
  static __device__ __forceinline__ void component(const mac_gather::Tile<kOrder>& tile,
                                                   const tiles::Placed& placed, float (&result)[4 * quads]) {
    const tiles::Sum27 sum = mac_gather::quadratic<C>(tile, placed);
    result[C] = sum.value;
#pragma unroll
    for (int d = 0; d < 3; ++d) result[3 + 3 * C + d] = sum.first[d];
  }

  static __device__ __forceinline__ void evaluate(const mac_gather::Tile<kOrder>& tile,
                                                  const tiles::Placed& placed, float (&result)[4 * quads]) {
    component<0>(tile, placed, result);
    component<1>(tile, placed, result);
    component<2>(tile, placed, result);
  }
};
constexpr int kQuads = VelocityAndMoments::quads, kStride = VelocityAndMoments::stride;

__global__ void __launch_bounds__(Policy::finish_threads)
    finish(float* __restrict__ v, float* __restrict__ affine, std::int64_t n, float dx,
           const int* __restrict__ slots, const float4* __restrict__ results) {
  __shared__ __align__(16) float staging[Policy::finish_threads / 32][32 * 4 * kQuads];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::finish_threads + threadIdx.x;
  const int slot = p < n ? __ldcs(slots + p) : tiles::kNoSlot;
  tiles::read_results<kQuads, kStride>(results, slot, reinterpret_cast<float4*>(stage));
  __syncwarp();
  const float* own = stage + 4 * kQuads * lane;
  const float velocity[3] = {own[0], own[1], own[2]};
  float moments[9];
#pragma unroll
  for (int e = 0; e < 9; ++e) moments[e] = dx * own[3 + e];
  __syncwarp();  // all results are read: their memory takes the rows
  store_rows(affine, p - lane, n, stage, moments);
  store_rows(v, p - lane, n, stage + 32 * 9, velocity);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { gather_.allocate(grid_of(in), in.x.shape[0]); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("g2p_apic", "x", in.x.data);  // counted by 16 bytes
    const std::int64_t n = in.x.shape[0];
    Source faces{{in.ux.data, in.uy.data, in.uz.data}, {}};
    mac_gather::set_extents(faces.extent, in.ux, in.uy, in.uz);
    gather_.compute(grid_of(in), in.x.data, n, faces);
    finish<<<Gather::blocks(n, Policy::finish_threads), Policy::finish_threads>>>(
        out.v.data, out.B.data, n, in.dx, gather_.slots(), gather_.results());
  }

 private:
  using Gather = tiles::TileGather<Policy, VelocityAndMoments, Tiling, Source>;

  static tiles::TileGrid grid_of(const Inputs& in) {
    return mac_gather::grid_of<kOrder>(in.ux, in.uy, in.uz, in.dx);
  }

  Gather gather_;
};

}  // namespace
}  // namespace gpuphys::g2p_apic

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(g2p_apic, g2p_apic::Reference)
}
