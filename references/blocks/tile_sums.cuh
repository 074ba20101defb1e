// Building block: sums of particles over the nodes of a tile, the second half of a particle-to-grid transfer
// (particle_tiles.cuh is the first). A block has a piece of a tile's list in shared memory; it
//
//   sort_by_cell()   lists the piece's records by cell, so that a thread owns a cell and sums the nodes that
//   its
//                    particles reach in registers: no atomic, and one order of terms whatever the block does
//   add_along()      adds up the cells that lie side by side in the lanes of a warp
//
// and leaves one sum for each node of the tile.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

namespace gpuphys::tiles {

/// Shared memory of a sort of up to Piece records by Cells cells.
template <int Cells, int Piece>
struct CellOrder {
  int counts[Cells];
  int starts[Cells + 1];            ///< of each cell's records in `order`
  unsigned short order[Piece + 1];  ///< records by cell, and one that is read, not used
};

/// Lists records 0 .. count-1 by cell: order[starts[c]] .. order[starts[c+1] - 1] are those of cell c.
/// `cell_of(record)` is asked for records up to Piece - 1, in the list or not. All `counts` are 0 and the
/// records are there for all threads; so is the order when it returns.
template <int Threads, int Cells, int Piece, class CellOf>
__device__ __forceinline__ void sort_by_cell(CellOrder<Cells, Piece>& shared, int count, CellOf&& cell_of) {
  static_assert(Cells % 32 == 0);
  constexpr int rounds = (Piece + Threads - 1) / Threads;
  constexpr int cells_per_lane = Cells / 32;
  const int thread = static_cast<int>(threadIdx.x);
  // Straight through, whether or not there is a record: branches would have each round wait for the last.
  int cells[rounds], ranks[rounds] = {};
#pragma unroll
  for (int s = 0; s < rounds; ++s) {
    int p = thread + s * Threads;
    if ((s + 1) * Threads > Piece) p = min(p, Piece - 1);
    cells[s] = cell_of(p);
  }
#pragma unroll
  for (int s = 0; s < rounds; ++s) {
    if (thread + s * Threads < count) ranks[s] = atomicAdd(&shared.counts[cells[s]], 1);
  }
  __syncthreads();
  if (thread < 32) {
    int own[cells_per_lane], lanes = 0;
#pragma unroll
    for (int c = 0; c < cells_per_lane; ++c) lanes += own[c] = shared.counts[cells_per_lane * thread + c];
    int sum = lanes;
#pragma unroll
    for (int step = 1; step < 32; step *= 2) {
      const int below = __shfl_up_sync(0xffffffffu, sum, static_cast<unsigned>(step));
      if (thread >= step) sum += below;
    }
    if (thread == 31) shared.starts[Cells] = sum;
    sum -= lanes;
#pragma unroll
    for (int c = 0; c < cells_per_lane; ++c) {
      shared.starts[cells_per_lane * thread + c] = sum;
      sum += own[c];
    }
  }
  __syncthreads();
#pragma unroll
  for (int s = 0; s < rounds; ++s) {
    const int p = thread + s * Threads;
    if (p < count) shared.order[shared.starts[cells[s]] + ranks[s]] = static_cast<unsigned short>(p);
  }
  __syncthreads();
}

/// Adds up cells side by side along an axis, Lanes lanes apart. `nodes` are the cell's sums from the lowest
/// node to the highest; the first becomes that node's whole sum, in the last of the cells so do the others.
template <int Lanes, class... Nodes>
__device__ __forceinline__ void add_along(bool has_below, Nodes&... nodes) {
  float* node[] = {&nodes...};
#pragma unroll
  for (int r = static_cast<int>(sizeof...(Nodes)) - 2; r >= 0; --r) {
    const float below = __shfl_up_sync(0xffffffffu, *node[r + 1], Lanes);
    if (has_below) *node[r] += below;
  }
}

}  // namespace gpuphys::tiles
