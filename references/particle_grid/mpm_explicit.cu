// mpm_explicit: one step of an explicit material point method, quadratic B-splines, FP32: p2g_mpm, then
// g2p_mpm with the velocities that it leaves at the nodes.
//
// Composed of what those two are made of, and sorted once: the lists of tiles that particles scatter from are
// gathered to as well. Passes over data in random order:
//   mark, count, plan, assign, place, scatter   as in p2g_mpm (mpm_scatter.cuh): {mass, momentum} of the
//   nodes gather   a block for a piece of a list: the tile's nodes, divided on their way to shared memory,
//   and the places that
//            the records begin with; v and dv per cell, 12 numbers, to the slot
//   finish   a thread a particle in the order of the input: fetches the 12 numbers, updates F and x
//
// No node velocity goes to memory: node sums are 16 bytes, read by the gather of a tile (216 of them) and its
// neighbours. A particle out of reach of the array lies in a list one cell further out: what it scatters
// falls outside, and what it gathers is clamped.
//
// What bounds it (16.86M particles): DRAM. Up to scatter as p2g_mpm, 2.6 GB; gather reads 0.54 GB and
// writes 1.08 GB, finish reads 1.08 GB at random places and moves 1.8 GB in order.
#include "cases/particle_grid/mpm_explicit.hpp"
#include "references/common/alignment.hpp"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/mpm_scatter.cuh"
#include "references/particle_grid/node_gather.cuh"
#include "references/particle_grid/particle_update.cuh"

namespace gpuphys::mpm_explicit {
namespace {

using mpm_scatter::kTileNodes;
using mpm_scatter::kTileSide;
using Scatter = mpm_scatter::Scatter<true>;
using Tiling = Scatter::T;
using Tile = tiles::Tile<Tiling, node_gather::kComponents>;

struct Policy : mpm_scatter::Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int gather_threads = 64;
  static constexpr int gather_blocks_per_sm = 8;
  static constexpr int finish_threads = 256;
#else
  static constexpr int gather_threads = 128;
  static constexpr int gather_blocks_per_sm = 5;
  static constexpr int finish_threads = 128;
#endif
};

/// {v 3, dv per cell 9}
struct VelocityAndGradient {
  static constexpr int quads = 3, stride = 4;  // float4, and in memory: two whole sectors

  static __device__ __forceinline__ void evaluate(const Tile& tile, const tiles::Placed& placed,
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

/// Places are what the records of the scatter begin with.
struct RecordPlaces {
  static constexpr int stride = mpm_scatter::kStride;

  static __device__ __forceinline__ tiles::Placed placed(const float4& offset) {
    const int cell = mpm_scatter::cell_of(offset);
    const int x = cell / (kTileSide * kTileSide), y = cell / kTileSide % kTileSide, z = cell % kTileSide;
    return {{offset.x - static_cast<float>(x + 1), offset.y - static_cast<float>(y + 1),
             offset.z - static_cast<float>(z + 1)},
            cell};
  }
};

/// Samples are the nodes' velocities, divided as they are read.
struct NodeSums {
  static constexpr int arrays = node_gather::kComponents;
  tiles::TileGrid grid;
  const unsigned char* __restrict__ touched;
  const float4* __restrict__ sums;
};

/// Velocities of a tile's nodes and their halo. Sums of node blocks that no particle reaches are not there.
template <class T, int Threads>
__device__ __forceinline__ void load_tile(Tile& tile, const NodeSums& source, const int4& at) {
  const int first[3] = {at.x * kTileSide + T::first(0), at.y * kTileSide + T::first(1),
                        at.z * kTileSide + T::first(2)};
  for (int s = static_cast<int>(threadIdx.x); s < Tile::kSamples; s += Threads) {
    const int offset[3] = {s / Tile::kPlane, s / Tile::kRow % mpm_scatter::kSide, s % Tile::kRow};
    int block[3], local[3];
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const int node = min(max(first[d] + offset[d], 0), source.grid.nodes[d] - 1) - T::first(d);
      block[d] = node / kTileSide;
      local[d] = node % kTileSide;
    }
    const int number = source.grid.tile(block[0], block[1], block[2]);
    float4 sum = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    if (source.touched[number] != 0) {
      sum = source.sums[static_cast<std::size_t>(number) * kTileNodes +
                        static_cast<std::size_t>((local[0] * kTileSide + local[1]) * kTileSide + local[2])];
    }
    const bool has_mass = sum.x > 0.0f;
    tile.values[0][s] = has_mass ? sum.y / sum.x : 0.0f;
    tile.values[1][s] = has_mass ? sum.z / sum.x : 0.0f;
    tile.values[2][s] = has_mass ? sum.w / sum.x : 0.0f;
  }
}

struct Updated {
  float* __restrict__ v;
  float* __restrict__ f;
  float* __restrict__ x;
};

__global__ void __launch_bounds__(Policy::finish_threads)
    finish(const __grid_constant__ mpm_scatter::Particles particles, const __grid_constant__ Updated updated,
           float dt, float dx, const int* __restrict__ slots, const float4* __restrict__ results) {
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
  store_rows(updated.f, first, particles.n, stage_f, f_new);
  store_rows(updated.x, first, particles.n, stage_x, x_new);
  store_rows(updated.v, first, particles.n, stage, v);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0];
    int device = 0, processors = 0, resident = 0;
    GPUPHYS_CUDA(cudaGetDevice(&device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
    scatter_.allocate(grid_of(in), n);
    results_ = DeviceBuffer<float4>(static_cast<std::size_t>(kStride * n));
    GPUPHYS_CUDA(cudaFuncSetAttribute(gather, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(kSharedBytes)));
    GPUPHYS_CUDA(cudaFuncSetAttribute(gather, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      static_cast<int>(cudaSharedmemCarveoutMaxShared)));
    GPUPHYS_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&resident, gather, Policy::gather_threads,
                                                               kSharedBytes));
    gather_blocks_ = processors * std::max(resident, 1);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("mpm_explicit", "x", in.x.data);  // counted by 16 bytes
    const tiles::TileGrid grid = grid_of(in);
    const mpm_scatter::Particles particles = mpm_scatter::particles_of(in);
    scatter_.compute(grid, particles, mpm_scatter::moduli_of(in), {});
    const tiles::BinningView& bins = scatter_.bins();
    gather<<<static_cast<unsigned>(gather_blocks_), Policy::gather_threads, kSharedBytes>>>(
        NodeSums{grid, bins.touched, scatter_.sums()}, bins.items, bins.cursors + 1, scatter_.records(),
        results_.get());
    const Updated updated{out.v_new.data, out.F_new.data, out.x_new.data};
    finish<<<mpm_scatter::blocks(particles.n, Policy::finish_threads), Policy::finish_threads>>>(
        particles, updated, in.dt, in.dx, bins.slots, results_.get());
  }

 private:
  static constexpr auto gather = tiles::gather<VelocityAndGradient, Tiling, NodeSums, Policy::gather_threads,
                                               Policy::piece, Policy::gather_blocks_per_sm, RecordPlaces>;
  static constexpr std::size_t kSharedBytes =
      sizeof(tiles::GatherShared<Tiling, NodeSums::arrays, Policy::piece, kQuads>);

  static tiles::TileGrid grid_of(const Inputs& in) { return Scatter::grid_of(in.nx, in.ny, in.nz, in.dx); }

  Scatter scatter_;
  DeviceBuffer<float4> results_;
  int gather_blocks_ = 0;
};

}  // namespace
}  // namespace gpuphys::mpm_explicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(mpm_explicit, mpm_explicit::Reference)
}
