// velocity_gradient_mpm: gradient of the nodes' velocities at particles, quadratic B-splines, FP32.
//
// For every particle: G = sum u (x) grad w, the nodes' indices clamped to the array.
//
// Passes over data in random order (references/blocks/tile_gather.cuh):
//   mark, count, plan, assign, place   a slot for each particle in its tile's list, its place in its cell
//   there gather   a block for a piece of a list, the tile's nodes in shared memory: dv per metre, 9 numbers,
//   to the slot finish   a thread a particle in the order of the input: fetches the 9 numbers and writes them
//   in whole lines
//
// What bounds it (16.78M particles): DRAM. count and assign 0.4 GB, place 0.54 GB, gather 1.4 GB, finish 1.75
// GB, two thirds of that read at random places, 64 bytes each.
//
// What pays: results go through their slots and not straight to their particles: rows of 36 bytes at random
// places are two or three sectors each, written in part, and DRAM would have to read what is around them.
#include "cases/particle_grid/velocity_gradient_mpm.hpp"
#include "references/common/alignment.hpp"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/node_gather.cuh"

namespace gpuphys::velocity_gradient_mpm {
namespace {

struct Policy : node_gather::Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int finish_threads = 256;
#else
  static constexpr int finish_threads = 128;
#endif
};

/// {dv per cell 9, padding 3}
struct Gradient {
  static constexpr int quads = 3, stride = Policy::result_stride;

  static __device__ __forceinline__ void evaluate(const node_gather::Tile& tile, const tiles::Placed& placed,
                                                  float (&result)[4 * quads]) {
    const node_gather::Local at = node_gather::at_particle(tile, placed);
#pragma unroll
    for (int e = 0; e < 4 * quads; ++e) result[e] = e < 9 ? at.per_cell[e / 3][e % 3] : 0.0f;
  }
};
constexpr int kQuads = Gradient::quads, kStride = Gradient::stride;

__global__ void __launch_bounds__(Policy::finish_threads)
    finish(float* __restrict__ gradient, std::int64_t n, float dx, const int* __restrict__ slots,
           const float4* __restrict__ results) {
  __shared__ __align__(16) float staging[Policy::finish_threads / 32][32 * 4 * kQuads];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::finish_threads + threadIdx.x;
  const int slot = p < n ? __ldcs(slots + p) : tiles::kNoSlot;
  tiles::read_results<kQuads, kStride>(results, slot, reinterpret_cast<float4*>(stage));
  __syncwarp();
  float row[9];
#pragma unroll
  for (int e = 0; e < 9; ++e) row[e] = stage[4 * kQuads * lane + e] / dx;
  __syncwarp();
  store_rows(gradient, p - lane, n, stage, row);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    gather_.allocate(node_gather::grid_of(in), in.x.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("velocity_gradient_mpm", "x", in.x.data);  // counted by 16 bytes
    const std::int64_t n = in.x.shape[0];
    gather_.compute(node_gather::grid_of(in), in.x.data, n, node_gather::samples_of(in));
    finish<<<Gather::blocks(n, Policy::finish_threads), Policy::finish_threads>>>(
        out.G.data, n, in.dx, gather_.slots(), gather_.results());
  }

 private:
  using Gather = tiles::TileGather<Policy, Gradient, node_gather::Tiling, node_gather::Source>;
  Gather gather_;
};

}  // namespace
}  // namespace gpuphys::velocity_gradient_mpm

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(velocity_gradient_mpm, velocity_gradient_mpm::Reference)
}
