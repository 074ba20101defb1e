// Building block: particles to tiles of cells, the first half of a particle-to-grid transfer. Particles are
// counted by tile, each gets a place in its tile's list, and the lists are cut into pieces of bounded length
// for the blocks of a scatter (tile_sums.cuh has what those do with them). Node sums are kept in blocks of
// nodes that go with the tiles.
//
// Tiling<...> says which cells there are: the spline's order and whether samples are staggered decide what a
// particle reaches. Along an axis, with g = x/dx:
//
//   collocated, order 2   key floor(g - 1/2), reaches nodes key .. key + 2
//   collocated, order 1   key floor(g),       reaches nodes key, key + 1
//   staggered, order 2    key floor(g),       reaches samples key - 1 .. key + 2 of one component or another
//   staggered, order 1    key floor(g),       reaches samples key - 1 .. key + 1
//
// Tile t holds the keys first + Side t .. + Side - 1; node block t holds the nodes that begin `lowest` (0 or
// -1) below them, so that a tile writes to its own node block and to the seven with one more along some axes.
//
// No sort. Each particle gets a slot of its tile's list, in four passes without an atomic at L2 for all but
// a few:
//   mark_tiles       one row of 32 particles in so many marks the tiles it finds
//   count_particles  a block for a contiguous part of the particles, an SM each: numbers the marked tiles,
//                    looks its particles' tiles up and counts them, all in shared memory
//   plan_tiles       adds up the parts' counts, reserves slots, gives each part its first slot of each tile
//   assign_slots     a block a part again: slots from counters in shared memory
// and whoever writes the records reads the slots. The overflow path: particles whose tile the sample missed,
// or for whose tile shared memory had no counter, are counted at L2 and take their slots there (slot_of()).
// The lists lie in memory in whatever order the blocks of plan_tiles() come to reserve them.
//
// Why the slots go through memory (4 bytes written and read) and not straight into the records: the writer of
// the records goes through the particles in order, with all SMs in the same part of them at a time, so that
// the records of a tile that are written together lie together.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/common/device_buffer.cuh"
#include "references/common/vector_reduction.cuh"

namespace gpuphys::tiles {

/// Tiles of SideX x SideY x SideZ cells for splines of order 1 (hat) or 2 (quadratic) on collocated nodes or
/// on the faces of a MAC grid.
///
/// Clamped: for gathers (locate_clamped()). Along an axis, a particle that no node reaches counts as one in
/// the nearest cell that some node does reach: clamped to the array, all its nodes are the same, and its
/// place in the cell is nothing. Where particles scatter as well, Beyond = 1: the cell is the next one, which
/// no node reaches.
template <int SideX, int SideY, int SideZ, int Order, bool Staggered, bool Clamped = false, int Beyond = 0>
struct Tiling {
  static_assert(Order == 1 || Order == 2);
  static constexpr int order = Order;
  static constexpr bool staggered = Staggered;
  static constexpr bool clamped = Clamped;
  static constexpr int beyond = Beyond;              ///< cells more at either end
  static constexpr int lowest = Staggered ? -1 : 0;  ///< node reached, from the key
  static constexpr int highest = Order;
  static constexpr int reach = highest - lowest + 1;  ///< nodes from the lowest to the highest
  static constexpr int cells = SideX * SideY * SideZ;
  __host__ __device__ static constexpr int side(int d) { return d == 0 ? SideX : d == 1 ? SideY : SideZ; }
  /// Key of tile 0's first cell. Staggered: a tile begins at cell 0, as the blocks of particles often do.
  __host__ __device__ static constexpr int first(int d) { return Staggered ? -side(d) : -Order - beyond; }
  static_assert(SideX >= highest && SideY >= highest && SideZ >= highest && SideX > highest - lowest - 1);
};

struct TileGrid {
  int nodes[3];  ///< along each axis; of a MAC grid the most that any component has: cells + 1
  int tiles[3];
  float dx;
  float inverse_dx;  ///< of a power of two, whose products are the quotients by dx; else 0
  float dx_high,
      dx_low;  ///< dx in two parts of 12 bits: their products with 12 bits of a cell's number are exact

  __host__ __device__ int tile_count() const { return tiles[0] * tiles[1] * tiles[2]; }
  __device__ __forceinline__ int tile(int x, int y, int z) const { return (x * tiles[1] + y) * tiles[2] + z; }
};

/// Throws std::runtime_error for an array that is too large for 32-bit node numbers.
template <class Tiling>
TileGrid make_tile_grid(std::int64_t nx, std::int64_t ny, std::int64_t nz, float dx) {
  TileGrid g{};
  const std::int64_t n[3] = {nx, ny, nz};
  double nodes = Tiling::cells;
  for (int d = 0; d < 3; ++d) {
    if (n[d] < 1 || n[d] >= (1 << 24))
      throw std::runtime_error("the array must have 1 to 2^24 - 1 nodes along each axis");
    g.nodes[d] = static_cast<int>(n[d]);
    const int keys = g.nodes[d] - Tiling::lowest + Tiling::beyond - Tiling::first(d);
    g.tiles[d] = (keys + Tiling::side(d) - 1) / Tiling::side(d);
    nodes *= g.tiles[d];
  }
  if (nodes >= 2147483648.0)
    throw std::runtime_error("the array must have fewer than 2^31 nodes in whole tiles");
  g.dx = dx;
  int exponent = 0;
  const float mantissa = std::frexp(dx, &exponent);
  const bool power_of_two = mantissa == 0.5f && std::abs(exponent) < 100;
  g.inverse_dx = power_of_two ? 1.0f / dx : 0.0f;
  g.dx_high = std::ldexp(std::floor(std::ldexp(mantissa, 12)), exponent - 12);
  g.dx_low = dx - g.dx_high;
  return g;
}

struct Place {
  int tile;         ///< -1: reaches no node of the array
  float offset[3];  ///< collocated: position from the tile's first node, in cells, Order/2 - 1/2 and more;
                    ///< collocated and clamped: position from the nearest node, [-1/2, 1/2];
                    ///< staggered: position from the nearest whole cell's plane, [-1/2, 1/2], below 0 in the
                    ///< upper half of the cell
  int cell;  ///< number of the cell in the tile, z fastest (collocated: cell_of() says, unless clamped)
};

/// Position x in cells, less the whole number `cell`: as exact as float32 holds it, for any spacing.
__device__ __forceinline__ float beyond(const TileGrid& g, float x, int cell) {
  const int high = cell / 4096 * 4096, low = cell - high;
  const float a = static_cast<float>(high), b = static_cast<float>(low);
  // Every product is exact, and the differences are so small that they are too.
  const float left = ((x - a * g.dx_high) - b * g.dx_high) - a * g.dx_low - b * g.dx_low;
  return left / g.dx;
}

/// A whole number from a float; what no integer holds becomes one that is far outside of every array.
__device__ __forceinline__ int whole(float x) {
  return __float2int_rd(fminf(fmaxf(x, -1e9f), 1e9f));
}

/// locate() of a gather: every particle has a tile and a cell. The remainder decides the cell, not the
/// quotient, so that rounding never puts a particle a cell away from its place.
template <class Tiling>
__device__ __forceinline__ Place locate_clamped(const TileGrid& g, float x, float y, float z) {
  const float position[3] = {x, y, z};
  Place p;
  int tile[3];
  p.cell = 0;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const int side = Tiling::side(d);
    const float cells = g.inverse_dx != 0.0f ? position[d] * g.inverse_dx : position[d] / g.dx;
    int nearest = whole(cells + 0.5f);  // half-way, either will do
    float from_nearest =
        g.inverse_dx != 0.0f ? cells - static_cast<float>(nearest) : beyond(g, position[d], nearest);
    // Where rounding went across the half: the hat has a kink there.
    const int next = from_nearest > 0.5f ? 1 : from_nearest < -0.5f ? -1 : 0;
    nearest += next;
    from_nearest -= static_cast<float>(next);
    static_assert(Tiling::staggered || Tiling::order == 2, "of two nodes the lower one is not the nearest");
    const int key = !Tiling::staggered || from_nearest < 0.0f ? nearest - 1 : nearest;
    const int lowest = -Tiling::highest - Tiling::beyond,
              highest = g.nodes[d] - Tiling::lowest - 1 + Tiling::beyond;
    const unsigned from_first = static_cast<unsigned>(min(max(key, lowest), highest) - Tiling::first(d));
    tile[d] = static_cast<int>(from_first / static_cast<unsigned>(side));
    p.cell = p.cell * side + static_cast<int>(from_first % static_cast<unsigned>(side));
    p.offset[d] = fminf(fmaxf(from_nearest, -0.5f), 0.5f);  // far outside anything will do
  }
  p.tile = g.tile(tile[0], tile[1], tile[2]);
  return p;
}

template <class Tiling>
__device__ __forceinline__ Place locate(const TileGrid& g, float x, float y, float z) {
  if constexpr (Tiling::clamped) return locate_clamped<Tiling>(g, x, y, z);
  const float position[3] = {x, y, z};
  // Quotients, rounded alike in all passes over the particles: an inexact product could be fused differently.
  float in_cells[3];
  if (g.inverse_dx != 0.0f) {
#pragma unroll
    for (int d = 0; d < 3; ++d) in_cells[d] = position[d] * g.inverse_dx;
  } else {
#pragma unroll
    for (int d = 0; d < 3; ++d) in_cells[d] = position[d] / g.dx;
  }
  Place p;
  int tile[3];
  bool reaches = true;
  p.cell = 0;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    constexpr float shift = Tiling::staggered || Tiling::order == 1 ? 0.0f : 0.5f;
    const int side = Tiling::side(d), first = Tiling::first(d);
    const float cells = in_cells[d];
    const int key = whole(cells - shift);
    reaches = reaches && key >= -Tiling::highest && key < g.nodes[d] - Tiling::lowest;
    const unsigned from_first = static_cast<unsigned>(key - first);
    tile[d] = static_cast<int>(from_first / static_cast<unsigned>(side));
    if constexpr (Tiling::staggered) {
      p.cell = p.cell * side + static_cast<int>(from_first % static_cast<unsigned>(side));
      // The difference of two floats near each other is exact.
      const float whole_cells = static_cast<float>(key);
      const bool upper = cells - whole_cells >= 0.5f;
      p.offset[d] = g.inverse_dx != 0.0f ? cells - (upper ? whole_cells + 1.0f : whole_cells)
                                         : beyond(g, position[d], upper ? key + 1 : key);
      // Where the quotient was rounded across a plane.
      p.offset[d] = upper ? fminf(p.offset[d], -0x1p-30f) : fmaxf(p.offset[d], 0.0f);
    } else {
      const int near = Tiling::order == 1 ? key : key + 1, tile_first = tile[d] * side + first;
      p.offset[d] = g.inverse_dx != 0.0f
                        ? cells - static_cast<float>(tile_first)
                        : static_cast<float>(near - tile_first) + beyond(g, position[d], near);
    }
  }
  p.tile = reaches ? g.tile(tile[0], tile[1], tile[2]) : -1;
  return p;
}

/// Collocated: which of a tile's cells along an axis an offset lies in. Rounding may put an offset on the
/// upper end.
template <class Tiling>
__device__ __forceinline__ int cell_of(int axis, float offset) {
  constexpr float shift = Tiling::order == 1 ? 0.0f : 0.5f;
  return static_cast<int>(
      min(static_cast<unsigned>(offset - shift), static_cast<unsigned>(Tiling::side(axis) - 1)));
}

/// The tile in whose list particle p of n at `place` gets a slot, or -1. Both passes over the particles ask
/// this: a list has as many slots as the first pass counted.
__device__ __forceinline__ int listed_tile(const Place& place, std::int64_t p, std::int64_t n) {
  return p < n ? place.tile : -1;
}

/// A piece of a tile's list.
struct alignas(16) WorkItem {
  int first, count;  ///< slots in the list of all records
  int4 tile;         ///< along x, y, z; w: the next piece is of the next tile along z
};

/// Device memory of a binning, and what its kernels exchange. All zero or unset before the first kernel:
/// clear() sees to sampled, counts and cursors.
struct BinningView {
  int* counts;              ///< particles of each tile that are in no part's row of `rows`
  int* cursors;             ///< [0] records reserved, [1] work items, [2] marked tiles
  unsigned char* sampled;   ///< 1: a sampled particle lies in the tile
  unsigned* marks;          ///< the same: bit t % 32 of word t / 32 is tile t
  unsigned short* below;    ///< marks in earlier words; kMostIndexed stands for all more
  int* rows;                ///< [part][indexed tile]: count, then first slot, of the part's particles there
  unsigned short* indices;  ///< of the particles' tiles; kMostIndexed: counted in `counts`, or nowhere
  int* slots;               ///< of the particles; kNoSlot: to be asked for, or no tile
  int* next;                ///< next free record slot of each tile, for particles without
  unsigned char* touched;   ///< node blocks that some particle reaches
  WorkItem* items;
  std::int64_t part_size;  ///< particles that one block counts, a multiple of kSlotsAtOnce
  int parts;
  int words;    ///< of marks: of all tiles, or as many as shared memory takes
  int indexed;  ///< tiles in a row at most: as many as shared memory takes

  __device__ __forceinline__ bool marked(int tile) const { return tile / 32 < words && sampled[tile] != 0; }
};

inline constexpr int kMostIndexed = 65535;
inline constexpr int kNoSlot = -1;
inline constexpr int kSlotsAtOnce = 8;

/// Sum of `own` over the lower threads of the block; every thread's sum to `total`.
template <int Threads>
__device__ __forceinline__ int sum_below(int own, int (&warp_totals)[Threads / 32], int& total) {
  const int lane = static_cast<int>(threadIdx.x) % 32, warp = static_cast<int>(threadIdx.x) / 32;
  int sum = own;
#pragma unroll
  for (int step = 1; step < 32; step *= 2) {
    const int below = __shfl_up_sync(0xffffffffu, sum, static_cast<unsigned>(step));
    if (lane >= step) sum += below;
  }
  if (lane == 31) warp_totals[warp] = sum;
  __syncthreads();
  int before = 0;
  total = 0;
#pragma unroll
  for (int w = 0; w < Threads / 32; ++w) {
    if (w < warp) before += warp_totals[w];
    total += warp_totals[w];
  }
  return before + sum - own;
}

/// Marks the tiles of a sample: each `Stride`-th row of 32 particles. A thread a particle.
template <class Tiling, int Threads, int Stride>
__global__ void __launch_bounds__(Threads)
    mark_tiles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins,
               const float* __restrict__ x, std::int64_t n) {
  const std::int64_t thread = static_cast<std::int64_t>(blockIdx.x) * Threads + threadIdx.x;
  const std::int64_t p = thread / 32 * (32 * Stride) + thread % 32;
  if (p >= n) return;
  const int tile = listed_tile(locate<Tiling>(grid, x[3 * p], x[3 * p + 1], x[3 * p + 2]), p, n);
  if (tile < 0 || tile / 32 >= bins.words) return;
  bins.sampled[tile] = 1;  // whoever comes: nothing to ask for first, and no atomic
}

/// Four bytes, 0 or 1 each, as four bits: the product brings byte b to bit 24 + b.
__device__ __forceinline__ unsigned bits_of(unsigned bytes) {
  return bytes * 0x01020408u >> 24 & 15u;
}

/// Bytes of shared memory that count_particles() takes.
inline std::size_t count_shared_bytes(const BinningView& bins) {
  const auto words = static_cast<std::size_t>(bins.words);
  return sizeof(int) * static_cast<std::size_t>(bins.indexed) +
         (sizeof(unsigned) + sizeof(unsigned short)) * words;
}

/// A block a part: counts its particles by tile in shared memory, into its row, and numbers the marked tiles.
/// Particles of tiles without a place in the row are counted in `counts`.
template <class Tiling, int Threads>
__global__ void __launch_bounds__(Threads)
    count_particles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins,
                    const float* __restrict__ x, std::int64_t n) {
  extern __shared__ int histogram[];
  __shared__ int warp_totals[Threads / 32];
  auto* marks = reinterpret_cast<unsigned*>(histogram + bins.indexed);
  auto* below = reinterpret_cast<unsigned short*>(marks + bins.words);
  const int thread = static_cast<int>(threadIdx.x), part = static_cast<int>(blockIdx.x);
  for (int t = thread; t < bins.indexed; t += Threads) histogram[t] = 0;
#pragma unroll 4
  for (int w = thread; w < bins.words; w += Threads) {
    const uint4* bytes = reinterpret_cast<const uint4*>(bins.sampled) + 2 * w;
    const uint4 low = bytes[0], high = bytes[1];
    marks[w] = bits_of(low.x) | bits_of(low.y) << 4 | bits_of(low.z) << 8 | bits_of(low.w) << 12 |
               bits_of(high.x) << 16 | bits_of(high.y) << 20 | bits_of(high.z) << 24 | bits_of(high.w) << 28;
  }
  __syncthreads();
  const int span = (bins.words + Threads - 1) / Threads;
  const int first_word = min(span * thread, bins.words), end_word = min(first_word + span, bins.words);
  int own = 0, total;
  for (int w = first_word; w < end_word; ++w) own += __popc(marks[w]);
  int sum = sum_below<Threads>(own, warp_totals, total);
  for (int w = first_word; w < end_word; ++w) {
    below[w] = static_cast<unsigned short>(min(sum, kMostIndexed));
    sum += __popc(marks[w]);
  }
  __syncthreads();

  const std::int64_t begin = bins.part_size * part;
  const std::int64_t end = begin + bins.part_size < n ? begin + bins.part_size : n;
  // A thread for four particles in a row.
  const auto index_of = [&](float px, float py, float pz, std::int64_t p) {
    const int tile = listed_tile(locate<Tiling>(grid, px, py, pz), p, n);
    int index = kMostIndexed;
    if (tile >= 0 && tile / 32 < bins.words) {
      const unsigned word = marks[tile / 32], bit = 1u << (tile % 32);
      if ((word & bit) != 0) index = below[tile / 32] + __popc(word & (bit - 1u));
    }
    if (index < bins.indexed) {
      atomicAdd(&histogram[index], 1);
    } else {
      index = kMostIndexed;
      if (tile >= 0) atomicAdd(&bins.counts[tile], 1);
    }
    return static_cast<unsigned>(index);
  };
  constexpr int at_once = 4;
  for (std::int64_t p = begin + at_once * thread; p < end; p += at_once * Threads) {
    if (p + at_once <= end) {
      const float4* rows = reinterpret_cast<const float4*>(x + 3 * p);
      const float4 a = rows[0], b = rows[1], c = rows[2];
      uint2 pairs;
      pairs.x = index_of(a.x, a.y, a.z, p) | index_of(a.w, b.x, b.y, p + 1) << 16;
      pairs.y = index_of(b.z, b.w, c.x, p + 2) | index_of(c.y, c.z, c.w, p + 3) << 16;
      *reinterpret_cast<uint2*>(bins.indices + p) = pairs;
    } else {
      for (std::int64_t q = p; q < end; ++q)
        bins.indices[q] = static_cast<unsigned short>(index_of(x[3 * q], x[3 * q + 1], x[3 * q + 2], q));
    }
  }
  __syncthreads();
  int* row = bins.rows + static_cast<std::size_t>(part) * static_cast<std::size_t>(bins.indexed);
  for (int t = thread; t < min(total, bins.indexed); t += Threads) row[t] = histogram[t];
  if (part != 0) return;
  for (int w = thread; w < bins.words; w += Threads) {
    bins.below[w] = below[w];
    bins.marks[w] = marks[w];
  }
  if (thread == 0) bins.cursors[2] = total;
}

/// A block a part: gives its particles their slots. A thread eight particles at a time.
template <int Threads>
__global__ void __launch_bounds__(Threads)
    assign_slots(const __grid_constant__ BinningView bins, std::int64_t n) {
  extern __shared__ int next_slots[];
  const int thread = static_cast<int>(threadIdx.x), part = static_cast<int>(blockIdx.x);
  const int* row = bins.rows + static_cast<std::size_t>(part) * static_cast<std::size_t>(bins.indexed);
  const int in_use = min(bins.cursors[2], bins.indexed);
  const std::int64_t begin = bins.part_size * part;
  const std::int64_t end = begin + bins.part_size < n ? begin + bins.part_size : n;
  constexpr int step = kSlotsAtOnce * Threads;
  const auto load = [&](std::int64_t p) {
    return p + kSlotsAtOnce <= end ? __ldcs(reinterpret_cast<const uint4*>(bins.indices + p)) : uint4{};
  };
  uint4 ahead = load(begin + kSlotsAtOnce * thread);
#pragma unroll 12
  for (int t = thread; t < in_use; t += Threads) next_slots[t] = row[t];
  __syncthreads();
  const auto take = [&](unsigned index) {
    return static_cast<int>(index) < bins.indexed ? atomicAdd(&next_slots[index], 1) : kNoSlot;
  };
  for (std::int64_t p = begin + kSlotsAtOnce * thread; p < end; p += step) {
    if (p + kSlotsAtOnce <= end) {
      const uint4 pairs = ahead;
      ahead = load(p + step);  // on its way while these take their slots
      int4 low, high;
      low.x = take(pairs.x & 0xffffu), low.y = take(pairs.x >> 16);
      low.z = take(pairs.y & 0xffffu), low.w = take(pairs.y >> 16);
      high.x = take(pairs.z & 0xffffu), high.y = take(pairs.z >> 16);
      high.z = take(pairs.w & 0xffffu), high.w = take(pairs.w >> 16);
      auto* slots = reinterpret_cast<int4*>(bins.slots + p);
      slots[0] = low;
      slots[1] = high;
    } else {
      for (std::int64_t q = p; q < end; ++q) bins.slots[q] = take(bins.indices[q]);
    }
  }
}

/// Reserves record slots for each tile, cuts its list into pieces of at most `piece`, marks the node blocks
/// that the tiles write to, and clears those (`accumulators`: Quads float4 a node block). One thread a tile:
/// the pieces of a block's tiles follow each other as the tiles do, first along z.
template <class Tiling, int Threads, int Quads>
__global__ void __launch_bounds__(Threads)
    plan_tiles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins, int piece,
               float4* __restrict__ accumulators) {
  static_assert(Threads % 32 == 0 && Threads <= 1024);
  constexpr int warps = Threads / 32;
  __shared__ unsigned long long warp_totals[warps];
  __shared__ int reserved[2];
  __shared__ bool filled[Threads + 1];  // the block's tiles that have particles; none beyond
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32, warp = thread / 32;
  const int tile = static_cast<int>(blockIdx.x) * Threads + thread;
  const int tiles = grid.tile_count();
  const int z = tile % grid.tiles[2], y = tile / grid.tiles[2] % grid.tiles[1],
            x = tile / grid.tiles[2] / grid.tiles[1];
  int count = tile < tiles ? bins.counts[tile] : 0;
  const bool marked = tile < tiles && bins.marked(tile);
  int index = kMostIndexed;
  if (marked) index = bins.below[tile / 32] + __popc(bins.marks[tile / 32] & ((1u << (tile % 32)) - 1u));
  const std::size_t row = static_cast<std::size_t>(bins.indexed);
  if (index < bins.indexed) {
#pragma unroll 33
    for (int part = 0; part < bins.parts; ++part) count += bins.rows[part * row + index];
  }
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
  filled[thread] = count > 0;
  if (thread == 0) filled[Threads] = false;
  __syncthreads();
  unsigned long long before = 0, total = 0;
#pragma unroll
  for (int w = 0; w < warps; ++w) {
    if (w < warp) before += warp_totals[w];
    total += warp_totals[w];
  }
  if (thread == 0 && total != 0) {
    reserved[0] = atomicAdd(&bins.cursors[0], static_cast<int>(total & 0xffffffffu));
    reserved[1] = atomicAdd(&bins.cursors[1], static_cast<int>(total >> 32));
  }
  __syncthreads();
  if (count > 0) {
    const unsigned long long place = before + sum - own;
    const int start = reserved[0] + static_cast<int>(place & 0xffffffffu);
    const int first_item = reserved[1] + static_cast<int>(place >> 32);
    bins.next[tile] = start;
    if (index < bins.indexed) {
      // Loads of several parts before the stores: for all the compiler knows, one might feed the other.
      constexpr int batch = 22;
      int slot = start;
      for (int first_part = 0; first_part < bins.parts; first_part += batch) {
        const int last = min(batch, bins.parts - first_part);
        int* const rows = bins.rows + first_part * row + index;
        int in_part[batch];
#pragma unroll
        for (int k = 0; k < batch; ++k) in_part[k] = k < last ? rows[k * row] : 0;
#pragma unroll
        for (int k = 0; k < batch; ++k) {
          if (k < last) rows[k * row] = slot;
          slot += in_part[k];
        }
      }
    }
    // Pieces of equal length within one: no block is left with a stub.
    const int length = count / pieces, longer = count % pieces;
    const bool before_next = z + 1 < grid.tiles[2] && filled[thread + 1];
    int first = start;
    for (int s = 0; s < pieces; ++s) {
      const int n = length + (s < longer);
      bins.items[first_item + s] = {first, n, make_int4(x, y, z, s == pieces - 1 && before_next)};
      first += n;
    }
  }

  bool touched = false;
  if (tile < tiles) {
#pragma unroll
    for (int s = 0; s < 8; ++s) {
      // At the array's end one of the others again. All are asked for at once: with branches, the next tile
      // would wait for the answer of the last.
      const int below = grid.tile(max(x - s / 4, 0), max(y - s / 2 % 2, 0), max(z - s % 2, 0));
      touched |= bins.marked(below);
      touched |= bins.counts[below] > 0;
    }
    bins.touched[tile] = touched;
  }
  for (unsigned left = __ballot_sync(0xffffffffu, touched); left != 0; left &= left - 1) {
    const int block = tile - lane + __ffs(static_cast<int>(left)) - 1;
    float4* nodes = accumulators + static_cast<std::size_t>(block) * Quads;
    for (int i = lane; i < Quads; i += 32) nodes[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  }
}

/// The slot of particle p of n at `place`: from assign_slots(), or asked for now; -1 for none.
__device__ __forceinline__ int slot_of(const BinningView& bins, const Place& place, std::int64_t p,
                                       std::int64_t n) {
  int slot = p < n ? __ldcs(bins.slots + p) : kNoSlot;
  const int tile = listed_tile(place, p, n);
  if (slot < 0 && tile >= 0) slot = atomicAdd(bins.next + tile, 1);
  return slot;
}

/// Owns the memory of a BinningView.
class Binning {
 public:
  Binning() = default;
  /// `shared_bytes`: what count_particles() may take; `parts`: blocks that count at most.
  Binning(const TileGrid& grid, std::int64_t n, int piece, std::size_t shared_bytes, int parts) {
    if (n >= 2147483648ll) throw std::runtime_error("at most 2^31 - 1 particles");
    const auto tiles = static_cast<std::size_t>(grid.tile_count());
    // Marks get at most half of the shared memory, counters the rest.
    constexpr std::size_t per_word = sizeof(unsigned) + sizeof(unsigned short);
    const std::size_t words = std::min((tiles + 31) / 32, shared_bytes / 2 / per_word);
    const std::size_t indexed = std::min({(shared_bytes - per_word * words) / sizeof(int), 32 * words,
                                          static_cast<std::size_t>(kMostIndexed)});
    constexpr std::int64_t smallest_part = 2048;
    const std::int64_t wanted = std::clamp<std::int64_t>(n / smallest_part, 1, parts);
    const std::int64_t part_size =
        ((n + wanted - 1) / wanted + kSlotsAtOnce - 1) / kSlotsAtOnce * kSlotsAtOnce;
    const auto items = static_cast<std::size_t>(n);

    // 32 bytes of `sampled` for a word of marks.
    zeroed_ = DeviceBuffer<int>(8 * words + tiles + kCursors + words);  // marks need no zeros
    zeroed_bytes_ = (8 * words + tiles + kCursors) * sizeof(int);
    below_ = DeviceBuffer<unsigned short>(words);
    rows_ = DeviceBuffer<int>(static_cast<std::size_t>(wanted) * indexed);
    indices_ = DeviceBuffer<unsigned short>(items);
    slots_ = DeviceBuffer<int>(items);
    next_ = DeviceBuffer<int>(tiles);
    touched_ = DeviceBuffer<unsigned char>(tiles);
    // Full pieces, and at most one more for each tile that has particles.
    items_ = DeviceBuffer<WorkItem>(items / static_cast<std::size_t>(piece) + std::min(items, tiles) + 1);
    view_.sampled = reinterpret_cast<unsigned char*>(zeroed_.get());
    view_.counts = zeroed_.get() + 8 * words;
    view_.cursors = view_.counts + tiles;
    view_.marks = reinterpret_cast<unsigned*>(view_.cursors + kCursors);
    view_.below = below_.get();
    view_.rows = rows_.get();
    view_.indices = indices_.get();
    view_.slots = slots_.get();
    view_.next = next_.get();
    view_.touched = touched_.get();
    view_.items = items_.get();
    view_.part_size = part_size;
    view_.parts = static_cast<int>(wanted);
    view_.words = static_cast<int>(words);
    view_.indexed = static_cast<int>(indexed);
  }

  const BinningView& view() const { return view_; }

  void clear() const { GPUPHYS_CUDA(cudaMemsetAsync(zeroed_.get(), 0, zeroed_bytes_)); }

 private:
  static constexpr std::size_t kCursors = 4;

  DeviceBuffer<int> zeroed_, rows_, slots_, next_;
  DeviceBuffer<unsigned short> below_, indices_;
  DeviceBuffer<unsigned char> touched_;
  DeviceBuffer<WorkItem> items_;
  std::size_t zeroed_bytes_ = 0;
  BinningView view_{};
};

}  // namespace gpuphys::tiles
