// Particles to tiles of 4^3 cells: counted, given a place in their tile's list, and the lists cut into pieces
// of bounded length for the blocks of a scatter. Nodes are kept in blocks of 4^3 that go with the tiles.
//
// A particle belongs to the lowest of the three nodes it reaches along each axis, base = floor(x/dx - 1/2),
// which runs from -2 (only the upper node lies in the array) to nodes - 1. Tile t holds the bases 4t-2 ..
// 4t+1, reaches the nodes 4t-2 .. 4t+3, and node block t holds the nodes 4t-2 .. 4t+1: a tile writes to its
// own node block and to the seven with one more along some axes.
//
// No sort. Each particle gets a slot of its tile's list, in four passes without an atomic at L2 for all but
// a few:
//   mark_tiles       one row of 32 particles in so many marks the tiles it finds
//   count_particles  a block for a contiguous part of the particles, an SM each: numbers the marked tiles,
//                    looks its particles' tiles up and counts them, all in shared memory
//   plan_tiles       adds up the parts' counts, reserves slots, gives each part its first slot of each tile
//   assign_slots     a block a part again: slots from counters in shared memory
// and whoever writes the records reads the slots. Particles whose tile the sample missed, or for whose tile
// shared memory had no counter, are counted at L2 and take their slots there. The lists lie in memory in
// whatever order the blocks of plan_tiles() come to reserve them.
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

namespace gpuphys::particle_grid {

inline constexpr int kTileSide = 4;
inline constexpr int kTileNodes = kTileSide * kTileSide * kTileSide;

struct TileGrid {
  int nodes[3];  ///< of the array
  int tiles[3];
  float dx;
  float inverse_dx;  ///< of a power of two, whose products are the quotients by dx; else 0

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
  int exponent = 0;
  const bool power_of_two = std::frexp(dx, &exponent) == 0.5f && std::abs(exponent) < 100;
  g.inverse_dx = power_of_two ? 1.0f / dx : 0.0f;
  return g;
}

struct Place {
  int tile;         ///< -1: reaches no node of the array
  float offset[3];  ///< position from node 4t-2 of the tile, in cells: [1/2, 9/2]
};

__device__ __forceinline__ Place locate(const TileGrid& g, float x, float y, float z) {
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
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const float cells = in_cells[d];
    // Whole cells from the lowest base on; what no integer holds becomes the largest or smallest of them.
    const unsigned from_lowest = static_cast<unsigned>(__float2int_rd(cells - 0.5f)) + 2u;
    reaches = reaches && from_lowest < static_cast<unsigned>(g.nodes[d]) + 2u;
    tile[d] = static_cast<int>(from_lowest / kTileSide);
    p.offset[d] = cells - static_cast<float>(static_cast<int>(from_lowest / kTileSide * kTileSide - 2u));
  }
  p.tile = reaches ? g.tile(tile[0], tile[1], tile[2]) : -1;
  return p;
}

/// Which of a tile's four cells along an axis an offset lies in. Rounding may put an offset on the upper end.
__device__ __forceinline__ int cell_of(float offset) {
  return static_cast<int>(min(static_cast<unsigned>(offset - 0.5f), kTileSide - 1u));
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
template <int Threads, int Stride>
__global__ void __launch_bounds__(Threads)
    mark_tiles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins,
               const float* __restrict__ x, std::int64_t n) {
  const std::int64_t thread = static_cast<std::int64_t>(blockIdx.x) * Threads + threadIdx.x;
  const std::int64_t p = thread / 32 * (32 * Stride) + thread % 32;
  if (p >= n) return;
  const int tile = listed_tile(locate(grid, x[3 * p], x[3 * p + 1], x[3 * p + 2]), p, n);
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
template <int Threads>
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
    const int tile = listed_tile(locate(grid, px, py, pz), p, n);
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
/// that the tiles write to, and clears those (`accumulators`: 64 float4 a block). One thread a tile: the
/// pieces of a block's tiles follow each other as the tiles do, first along z.
template <int Threads>
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
    float4* nodes = accumulators + static_cast<std::size_t>(block) * kTileNodes;
    for (int i = lane; i < kTileNodes; i += 32) nodes[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  }
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

}  // namespace gpuphys::particle_grid
