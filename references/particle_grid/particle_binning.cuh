// Particles to tiles of 4^3 cells: counted, given a place in their tile's list, and the lists cut into pieces
// of bounded length for the blocks of a scatter. Nodes are kept in blocks of 4^3 that go with the tiles.
//
// A particle belongs to the lowest of the three nodes it reaches along each axis, base = floor(x/dx - 1/2),
// which runs from -2 (only the upper node lies in the array) to nodes - 1. Tile t holds the bases 4t-2 ..
// 4t+1, reaches the nodes 4t-2 .. 4t+3, and node block t holds the nodes 4t-2 .. 4t+1: a tile writes to its
// own node block and to the seven with one more along some axes.
//
// No sort: one pass over the particles counts them, a later one takes the slots of their tiles' lists with an
// atomic each, in whatever order it comes to them; and the lists lie in memory in whatever order the blocks
// of plan_tiles() come to reserve them.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "core/module.hpp"
#include "references/common/device_buffer.cuh"

namespace gpuphys::particle_grid {

inline constexpr int kTileSide = 4;
inline constexpr int kTileNodes = kTileSide * kTileSide * kTileSide;

struct TileGrid {
  int nodes[3];  ///< of the array
  int tiles[3];
  float dx;

  __host__ __device__ int tile_count() const { return tiles[0] * tiles[1] * tiles[2]; }
  __device__ __forceinline__ int tile(int x, int y, int z) const { return (x * tiles[1] + y) * tiles[2] + z; }
};

/// Throws std::runtime_error for an array that is too large for 32-bit node numbers.
inline TileGrid make_tile_grid(std::int64_t nx, std::int64_t ny, std::int64_t nz, float dx) {
  TileGrid g{};
  const std::int64_t n[3] = {nx, ny, nz};
  double nodes = kTileNodes;
  for (int d = 0; d < 3; ++d) {
    if (n[d] < 1 || n[d] >= (1 << 24))
      throw std::runtime_error("the array must have 1 to 2^24 - 1 nodes an axis");
    g.nodes[d] = static_cast<int>(n[d]);
    g.tiles[d] = (g.nodes[d] + 1) / kTileSide + 1;
    nodes *= g.tiles[d];
  }
  if (nodes >= 2147483648.0)
    throw std::runtime_error("the array must have fewer than 2^31 nodes in whole tiles");
  g.dx = dx;
  return g;
}

struct Place {
  int tile;         ///< -1: reaches no node of the array
  float offset[3];  ///< position from node 4t-2 of the tile, in cells: [1/2, 9/2]
};

__device__ __forceinline__ Place locate(const TileGrid& g, float x, float y, float z) {
  const float position[3] = {x, y, z};
  Place p;
  int tile[3];
  bool reaches = true;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    // A division, so that both passes over the particles round alike: a product could be fused differently.
    const float cells = position[d] / g.dx;
    const float base = floorf(cells - 0.5f);
    const bool ok = base >= -2.0f && base <= static_cast<float>(g.nodes[d] - 1);
    reaches = reaches && ok;
    tile[d] = ((ok ? static_cast<int>(base) : 0) + 2) / kTileSide;
    p.offset[d] = cells - static_cast<float>(kTileSide * tile[d] - 2);
  }
  p.tile = reaches ? g.tile(tile[0], tile[1], tile[2]) : -1;
  return p;
}

/// Which of a tile's four cells along an axis an offset lies in. Rounding may put an offset on the upper end.
__device__ __forceinline__ int cell_of(float offset) {
  return min(max(static_cast<int>(offset - 0.5f), 0), kTileSide - 1);
}

/// *sum += value, 16 bytes in one reduction at L2 (sm_90). Spelled out, because atomicAdd(float4*) asks for
/// the old value as well.
__device__ __forceinline__ void reduce_add(float4* sum, const float4& value) {
  asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
               :
               : "l"(sum), "f"(value.x), "f"(value.y), "f"(value.z), "f"(value.w)
               : "memory");
}

/// The tile in whose list particle p of n at `place` gets a slot, or -1. Both passes over the particles ask
/// this: a list has as many slots as the first pass counted.
__device__ __forceinline__ int listed_tile(const Place& place, std::int64_t p, std::int64_t n) {
  return p < n ? place.tile : -1;
}

/// counts[tile] += 1 for each particle. counts must be zero.
template <int Threads, int PerThread>
__global__ void __launch_bounds__(Threads)
    count_particles(const __grid_constant__ TileGrid grid, const float* __restrict__ x, std::int64_t n,
                    int* __restrict__ counts) {
  const std::int64_t first = static_cast<std::int64_t>(blockIdx.x) * (Threads * PerThread) + threadIdx.x;
  float position[PerThread][3];
#pragma unroll
  for (int s = 0; s < PerThread; ++s) {
    const std::int64_t p = first + s * Threads;
#pragma unroll
    for (int d = 0; d < 3; ++d) position[s][d] = p < n ? x[3 * p + d] : 0.0f;
  }
#pragma unroll
  for (int s = 0; s < PerThread; ++s) {
    const std::int64_t p = first + s * Threads;
    const Place place = locate(grid, position[s][0], position[s][1], position[s][2]);
    const int tile = listed_tile(place, p, n);
    if (tile >= 0) atomicAdd(&counts[tile], 1);
  }
}

/// A piece of a tile's list.
struct alignas(16) WorkItem {
  int first, count;  ///< slots in the list of all records
  int4 tile;         ///< along x, y, z
};

/// Device memory of a binning, and what its kernels exchange.
struct BinningView {
  int* counts;             ///< particles of each tile
  int* cursors;            ///< [0] records reserved, [1] work items; lie behind counts, cleared with them
  int* next;               ///< next free record slot of each tile
  unsigned char* touched;  ///< node blocks that some particle reaches
  WorkItem* items;
};

/// Reserves record slots for each tile, cuts its list into pieces of at most `piece`, marks the node blocks
/// that the tiles write to, and clears those (`accumulators`: 64 float4 a block). One thread a tile.
template <int Threads>
__global__ void __launch_bounds__(Threads)
    plan_tiles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins, int piece,
               float4* __restrict__ accumulators) {
  static_assert(Threads % 32 == 0 && Threads <= 1024);
  constexpr int warps = Threads / 32;
  __shared__ unsigned long long warp_totals[warps];
  __shared__ int reserved[2];
  const int tile = static_cast<int>(blockIdx.x) * Threads + static_cast<int>(threadIdx.x);
  const int lane = static_cast<int>(threadIdx.x) % 32, warp = static_cast<int>(threadIdx.x) / 32;
  const int tiles = grid.tile_count();
  const int z = tile % grid.tiles[2], y = tile / grid.tiles[2] % grid.tiles[1],
            x = tile / grid.tiles[2] / grid.tiles[1];
  const int count = tile < tiles ? bins.counts[tile] : 0;
  const int pieces = count / piece + (count % piece != 0);

  // Both running sums in one word: records below, pieces above.
  const unsigned long long own =
      static_cast<unsigned long long>(pieces) << 32 | static_cast<unsigned long long>(count);
  unsigned long long sum = own;
#pragma unroll
  for (int step = 1; step < 32; step *= 2) {
    const unsigned long long below = __shfl_up_sync(0xffffffffu, sum, static_cast<unsigned>(step));
    if (lane >= step) sum += below;
  }
  if (lane == 31) warp_totals[warp] = sum;
  __syncthreads();
  unsigned long long before = 0, total = 0;
#pragma unroll
  for (int w = 0; w < warps; ++w) {
    if (w < warp) before += warp_totals[w];
    total += warp_totals[w];
  }
  if (threadIdx.x == 0 && total != 0) {
    reserved[0] = atomicAdd(&bins.cursors[0], static_cast<int>(total & 0xffffffffu));
    reserved[1] = atomicAdd(&bins.cursors[1], static_cast<int>(total >> 32));
  }
  __syncthreads();
  if (count > 0) {
    const unsigned long long place = before + sum - own;
    const int start = reserved[0] + static_cast<int>(place & 0xffffffffu);
    const int first_item = reserved[1] + static_cast<int>(place >> 32);
    bins.next[tile] = start;
    // Pieces of equal length within one: no block is left with a stub.
    const int length = count / pieces, longer = count % pieces;
    int first = start;
    for (int s = 0; s < pieces; ++s) {
      const int n = length + (s < longer);
      bins.items[first_item + s] = {first, n, make_int4(x, y, z, 0)};
      first += n;
    }
  }

  bool touched = false;
  if (tile < tiles) {
#pragma unroll
    for (int s = 0; s < 8; ++s) {
      const int bx = x - s / 4, by = y - s / 2 % 2, bz = z - s % 2;
      if (bx >= 0 && by >= 0 && bz >= 0) touched = touched || bins.counts[grid.tile(bx, by, bz)] > 0;
    }
    bins.touched[tile] = touched;
  }
  for (unsigned left = __ballot_sync(0xffffffffu, touched); left != 0; left &= left - 1) {
    const int block = tile - lane + __ffs(static_cast<int>(left)) - 1;
    float4* nodes = accumulators + static_cast<std::size_t>(block) * kTileNodes;
    for (int i = lane; i < kTileNodes; i += 32) nodes[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  }
}

/// Owns the memory of a BinningView.
class Binning {
 public:
  Binning() = default;
  Binning(const TileGrid& grid, std::int64_t n, int piece)
      : counts_(static_cast<std::size_t>(grid.tile_count()) + 2),
        next_(static_cast<std::size_t>(grid.tile_count())),
        touched_(static_cast<std::size_t>(grid.tile_count())),
        // Full pieces, and at most one more for each tile that has particles.
        items_(static_cast<std::size_t>(n / piece + (n < grid.tile_count() ? n : grid.tile_count()) + 1)) {
    if (n >= 2147483648ll) throw std::runtime_error("at most 2^31 - 1 particles");
    counts_bytes_ = (static_cast<std::size_t>(grid.tile_count()) + 2) * sizeof(int);
    cursors_ = counts_.get() + grid.tile_count();
  }

  BinningView view() const { return {counts_.get(), cursors_, next_.get(), touched_.get(), items_.get()}; }

  void clear() const { GPUPHYS_CUDA(cudaMemsetAsync(counts_.get(), 0, counts_bytes_)); }

 private:
  DeviceBuffer<int> counts_, next_;
  DeviceBuffer<unsigned char> touched_;
  DeviceBuffer<WorkItem> items_;
  std::size_t counts_bytes_ = 0;
  int* cursors_ = nullptr;
};

}  // namespace gpuphys::particle_grid
