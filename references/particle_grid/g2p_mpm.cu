// g2p_mpm: velocities of the nodes to particles, quadratic B-splines, FP32.
//
// For every particle: v = sum w u, F' = (I + dt sum u (x) grad w) F, x' = x + dt v, the nodes' indices
// clamped to the array.
//
// Passes over data in random order (references/blocks/tile_gather.cuh):
//   mark, count, plan, assign, place   a slot for each particle in its tile's list, its place in its cell
//   there gather   a block for a piece of a list, the tile's nodes in shared memory: v and dv per cell, 12
//   numbers, to the slot finish   a thread a particle in the order of the input: fetches the 12 numbers,
//   updates F and x
//
// What bounds it (16.86M particles): DRAM. count and assign 0.4 GB, place 0.54 GB, gather 1.6 GB, finish 3.0
// GB, a third of that read at random places, 64 bytes each. In gather instructions (some 450 a particle) come
// next.
//
// What pays: no gather from L2 (576 bytes a particle, more than all the above). F takes no part in the sort:
// 36 bytes would go out and come in again. A result is padded to two whole sectors, read by four lanes at
// once. Differences from the middle node, formed first, lose nothing of a small gradient on a large velocity.
#include "cases/particle_grid/g2p_mpm.hpp"
#include "references/common/alignment.hpp"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/node_gather.cuh"
#include "references/particle_grid/particle_update.cuh"

namespace gpuphys::g2p_mpm {
namespace {

struct Policy : node_gather::Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int finish_threads = 256;
#else
  static constexpr int finish_threads = 128;
#endif
};

/// {v 3, dv per cell 9}
struct VelocityAndGradient {
  static constexpr int quads = 3, stride = Policy::result_stride;

  static __device__ __forceinline__ void evaluate(const node_gather::Tile& tile, const tiles::Placed& placed,
                                                  float (&result)[4 * quads]) {
    const node_gather::Local at = node_gather::at_particle(tile, placed);
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      result[c] = at.v[c];
#pragma unroll
      for (int d = 0; d < 3; ++d) result[3 + 3 * c + d] = at.per_cell[c][d];
    }
  }
};
constexpr int kQuads = VelocityAndGradient::quads, kStride = VelocityAndGradient::stride;

struct Particles {
  const float* __restrict__ x;
  const float* __restrict__ f;
  float* __restrict__ v;
  float* __restrict__ f_new;
  float* __restrict__ x_new;
  std::int64_t n;
};

__global__ void __launch_bounds__(Policy::finish_threads)
    finish(const __grid_constant__ Particles particles, float dt, float dx, const int* __restrict__ slots,
           const float4* __restrict__ results) {
  __shared__ __align__(16) float staging[Policy::finish_threads / 32][32 * (4 * kQuads + 9 + 3)];
  float* stage = staging[threadIdx.x / 32];
  float *stage_f = stage + 32 * 4 * kQuads, *stage_x = stage_f + 32 * 9;
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::finish_threads + threadIdx.x;
  const std::int64_t first = p - lane;
  const int slot = p < particles.n ? __ldcs(slots + p) : tiles::kNoSlot;
  float x[3], f[9];
  load_rows(particles.x, first, particles.n, x);
  load_rows(particles.f, first, particles.n, f);
  tiles::read_results<kQuads, kStride>(results, slot, reinterpret_cast<float4*>(stage));
  transpose_rows(stage_x, x);
  transpose_rows(stage_f, f);
  __syncwarp();
  const float* own = stage + 4 * kQuads * lane;
  const float v[3] = {own[0], own[1], own[2]};
  const float per_cell = dt / dx;
  float step[3][3];
#pragma unroll
  for (int e = 0; e < 9; ++e) step[e / 3][e % 3] = per_cell * own[3 + e];
  float f_new[9], x_new[3];
  particle_grid::deform(step, f, f_new);
  particle_grid::move(x, dt, v, x_new);
  __syncwarp();  // all rows are read: their memory takes the new ones
  store_rows(particles.f_new, first, particles.n, stage_f, f_new);
  store_rows(particles.x_new, first, particles.n, stage_x, x_new);
  store_rows(particles.v, first, particles.n, stage, v);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    gather_.allocate(node_gather::grid_of(in), in.x.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("g2p_mpm", "x", in.x.data);  // counted by 16 bytes
    const std::int64_t n = in.x.shape[0];
    gather_.compute(node_gather::grid_of(in), in.x.data, n, node_gather::samples_of(in));
    const Particles particles{in.x.data, in.F.data, out.v.data, out.F_new.data, out.x_new.data, n};
    finish<<<Gather::blocks(n, Policy::finish_threads), Policy::finish_threads>>>(
        particles, in.dt, in.dx, gather_.slots(), gather_.results());
  }

 private:
  using Gather = tiles::TileGather<Policy, VelocityAndGradient, node_gather::Tiling, node_gather::Source>;
  Gather gather_;
};

}  // namespace
}  // namespace gpuphys::g2p_mpm

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(g2p_mpm, g2p_mpm::Reference)
}
