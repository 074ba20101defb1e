// p2g_mpm: momentum and elastic forces of particles to grid velocities, quadratic B-splines, FP32.
//
// For every node: u = (sum_p w m v - dt sum_p V0 tau grad w) / sum_p w m, tau the Kirchhoff stress of fixed
// corotated elasticity; 0 where no mass arrives.
//
// Passes over data in random order:
//   mark, count, plan, assign   (particle_tiles.cuh) a slot of its tile's list, of 4^3 cells, for each
//              particle; lists cut into pieces, node blocks cleared
//   place      a thread a particle: stress from F; the packed record {offset 3, v 3, tau 6, padding 4}
//              goes to its slot, written by four lanes at once
//   scatter    two warps for a piece of a list: sort it by cell in shared memory; a thread owns a cell and
//              sums 27 nodes' {mass, momentum} in registers; cells side by side along y and z are added up
//              by shuffles, along x through shared memory; one vector reduction for each of the tile's 216
//              nodes goes out to L2, but for those that wait in shared memory for the block's next piece, if
//              that is of the next tile along z. Between pieces: zeros where no particle reaches
//   normalise  a thread for 16 nodes that some particle may reach: divides
//
// What bounds it (16.86M particles): DRAM in count (0.24 GB), assign (0.10 GB) and place (1.08 GB read, 1.08
// GB written at random places); in scatter instructions (271 a particle, some 170 more around them) nearly as
// much as its 1.08 GB read and 0.18 GB written.
//
// What pays: no atomics at L2, 55 G/s whatever their addresses, for counts and slots. A stress near a
// rotation takes no rotation (fixed_corotated.cuh). A record is two whole sectors and leaves in one
// instruction: as three 16-byte stores at random places, records kept DRAM busy with row changes, and records
// of 48 bytes, written at once, leave half sectors behind that cost half as much time again, more than their
// fewer bytes save (docs/lab/particle_grid.md). The next piece's list is on its way while the present one's
// sums are added up. Summing in registers first leaves some 30 shared accesses a cell instead of 864 atomics;
// factoring the 27 weights, with the sum of three nodes in place of the middle one along each axis, takes 10
// multiply-adds and additions a node and particle for all four sums; one thread for all 27 nodes of a cell
// reads each record once.
#include <algorithm>

#include "cases/particle_grid/p2g_mpm.hpp"
#include "references/common/alignment.hpp"
#include "references/particle_grid/mpm_scatter.cuh"

namespace gpuphys::p2g_mpm {
namespace {

using mpm_scatter::kTileNodes;
using mpm_scatter::kTileSide;
using mpm_scatter::Policy;
using mpm_scatter::Result;
using tiles::TileGrid;

// A block for a row of node blocks along z, a thread for the 16 nodes of one that share z.
__global__ void __launch_bounds__(Policy::normalise_threads, 1024 / Policy::normalise_threads)
    normalise(const __grid_constant__ TileGrid grid, const unsigned char* __restrict__ touched,
              const float4* __restrict__ accumulators, const __grid_constant__ Result result) {
  const int tile_x = static_cast<int>(blockIdx.x) / grid.tiles[1],
            tile_y = static_cast<int>(blockIdx.x) - tile_x * grid.tiles[1];
  const int first_i = kTileSide * tile_x - 2, first_j = kTileSide * tile_y - 2;
  for (int k = static_cast<int>(threadIdx.x); k < grid.nodes[2]; k += Policy::normalise_threads) {
    const int block = grid.tile(tile_x, tile_y, (k + 2) / kTileSide);
    if (touched[block] == 0) continue;  // scatter() left zeros
    const float4* nodes = accumulators + static_cast<std::size_t>(block) * kTileNodes + (k + 2) % kTileSide;
#pragma unroll 2
    for (int y = 0; y < kTileSide; ++y) {
      const int j = first_j + y;
      if (j < 0 || j >= grid.nodes[1]) continue;
      float4 node[kTileSide];
#pragma unroll
      for (int s = 0; s < kTileSide; ++s) node[s] = __ldcs(nodes + (s * kTileSide + y) * kTileSide);
#pragma unroll
      for (int s = 0; s < kTileSide; ++s) {
        const int i = first_i + s;
        if (i < 0 || i >= grid.nodes[0]) continue;
        const std::int64_t at = (static_cast<std::int64_t>(i) * grid.nodes[1] + j) * grid.nodes[2] + k;
        const bool has_mass = node[s].x > 0.0f;
        __stcs(result.u[0] + at, has_mass ? node[s].y / node[s].x : 0.0f);
        __stcs(result.u[1] + at, has_mass ? node[s].z / node[s].x : 0.0f);
        __stcs(result.u[2] + at, has_mass ? node[s].w / node[s].x : 0.0f);
      }
    }
  }
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>& out) {
    scatter_.allocate(grid_of(in, out), in.x.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("p2g_mpm", "x", in.x.data);  // counted by 16 bytes
    const TileGrid grid = grid_of(in, out);
    const Result result{{out.ux.data, out.uy.data, out.uz.data}};
    scatter_.compute(grid, mpm_scatter::particles_of(in), mpm_scatter::moduli_of(in), result);
    normalise<<<static_cast<unsigned>(grid.tiles[0] * grid.tiles[1]), Policy::normalise_threads>>>(
        grid, scatter_.bins().touched, scatter_.sums(), result);
  }

 private:
  using Scatter = mpm_scatter::Scatter<false>;

  static TileGrid grid_of(const Inputs& in, const Outputs<float>& out) {
    return Scatter::grid_of(out.ux.shape[0], out.ux.shape[1], out.ux.shape[2], in.dx);
  }

  Scatter scatter_;
};

}  // namespace
}  // namespace gpuphys::p2g_mpm

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(p2g_mpm, p2g_mpm::Reference)
}
