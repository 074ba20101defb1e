// Neighbour search on the device: items sorted by the cells of a uniform grid, for any payload and any
// cut-off.
//
// A build sorts in two levels and is three launches, each prepared during the one before
// (dependent_launch.cuh), without a round trip to the host:
//   1. find_bounds   bounding box and largest radius; its last block chooses the grid.
//   2. split_items   every bin, a range of `bin_cells` cells, has room for `bin_items` records. A block takes
//                    its items in tiles: it counts a tile by bins in shared memory, reserves the next places
//                    in each (one atomic a bin and tile, neighbouring bins by neighbouring lanes), sorts the
//                    tile's records by bins in shared memory and writes them in that order. What finds no
//                    room goes to a common list.
//   3. sort_bins     a block a bin: counts the bin's cells, writes their starts, and its records in order.
//                    All in shared memory, and each record is ranked once; a bin with more than
//                    `bin_items` goes through global memory instead, and looks for the rest in the list.
// Cells are contiguous along z, so that the cells [z0, z1] of one column are one range of slots:
// [start[row + z0], start[row + z1 + 1]).
//
// Neighbours are searched by visiting the cells of position -/+ cut-off (visit_ranges()). Cell numbers come
// from one function that is monotone in the coordinate, rounding included, so no pair within the cut-off can
// be missed, whatever the edges are: they are a matter of speed alone. Where the box is too large for
// `capacity` cells of the wished size, cells are enlarged.
//
// What a user supplies is a Source, copied to the kernels by value:
//   int count;                                     number of items, >= 1
//   __device__ float3 position(int i) const;       of item i
//   __device__ float radius(int i) const;          half the cut-off of item i with one of its own size
//   using Record;                                  payload of an item, a whole number of 16-byte words
//   __device__ Record record(int i) const;         of item i
//   __device__ float3 position(const Record&) const;   the same as of its item, bit by bit
//   __device__ void placed(const Grid&, int slot, const Record&) const;   told what comes to each slot
//   Record* split;                                 scratch in device memory for NeighbourGrid::records() of
//                                                  them, aligned to 32 bytes
//   float4* sorted;                                receives the result, word by word: that of number w of
//                                                  the record in slot s is sorted[w * count + s]
//
// What bounds it: memory. Records are written twice and read once; a record of 32 or 64 bytes fills whole
// sectors, whereas a sector written in part may be fetched from DRAM before it is written back (measured:
// 0.25 ms for 2M records of two separate 16-byte stores). Keep other sizes rare. What pays:
// - Tiles in the order of bins: all blocks sweep the bins at about the same time, and what they append to one
//   is contiguous, so that lines are full, and their neighbours too, when L2 writes them back. Written in the
//   order of the items, every sector would go to DRAM by itself.
// - The next tile's records are under way while one is written.
// - Loads are issued in batches, also at the end of a loop (indices are clamped there), or go to shared
//   memory without registers (cp.async). The grid is read from registers or shared memory inside loops: a
//   load of it would queue behind those of the items.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "core/module.hpp"
#include "references/common/dependent_launch.cuh"
#include "references/common/device_buffer.cuh"

namespace gpuphys::neighbour_grid {

/// Tuning. Users may pass a class of their own with the same members.
struct DefaultPolicy {
  static constexpr int bounds_threads = 512;
  static constexpr int bounds_blocks = 3 * 132;  // one wave; also bounds the last block's share
  static constexpr int split_threads = 768;
  static constexpr int split_each = 2;          // items of a thread in a tile
  static constexpr int split_blocks = 2 * 132;  // one wave
  static constexpr int split_blocks_per_sm = 2;
  static constexpr int bin_cells = 1024;  // a multiple of four
  static constexpr int bin_items = 1792;  // that fit in a bin's place, and in shared memory; at most 2^16
  static constexpr int bin_threads = 512;
  static constexpr int bin_blocks_per_sm = 3;
  static constexpr int most_bins = 8192;  // counted in shared memory; cells grow where these are not enough
  static constexpr int z_cells = 2;       // cells along z in one edge along x and y: ranges fit tighter
  static constexpr float cells_per_item = 1.5f;
};

/// The grid that the last build chose. Lives on the device.
struct Grid {
  float low[3];           ///< corner of the bounding box
  float inverse_edge[3];  ///< cells per unit length
  int cells[3];
  int total;       ///< product of `cells`
  float extent;    ///< longest side of the bounding box
  float smallest;  ///< smallest radius of all items
  float largest;   ///< and the largest
};

/// Number along `axis` of the cell that holds coordinate `x`; the outermost cells extend to infinity.
/// Monotone in x. A difference before the product, so nothing here can be contracted and all kernels agree.
__device__ __forceinline__ int cell_along(const Grid& grid, int axis, float x) {
  const float t = (x - grid.low[axis]) * grid.inverse_edge[axis];
  return static_cast<int>(fminf(fmaxf(t, 0.0f), static_cast<float>(grid.cells[axis] - 1)));
}

__device__ __forceinline__ int cell_of(const Grid& grid, float3 p) {
  return (cell_along(grid, 0, p.x) * grid.cells[1] + cell_along(grid, 1, p.y)) * grid.cells[2] +
         cell_along(grid, 2, p.z);
}

/// Columns of cells that visit_ranges() hands over at a time.
constexpr int columns_at_a_time = 3;

/// The slots [begin, end) of each; some may be empty.
struct Ranges {
  int begin[columns_at_a_time], end[columns_at_a_time];
};

/// Calls visit(Ranges) so that the ranges hold every item within `cutoff` of `p` along each axis (and
/// others), each once; no range is longer than Longest. Calls prepare() before it fetches each. `p` need not
/// be an item.
template <int Longest, class Prepare, class Visit>
__device__ __forceinline__ void visit_ranges(const Grid& grid, const int* start, float3 p, float cutoff,
                                             Prepare&& prepare, Visit&& visit) {
  const int x0 = cell_along(grid, 0, p.x - cutoff), x1 = cell_along(grid, 0, p.x + cutoff);
  const int y0 = cell_along(grid, 1, p.y - cutoff), y1 = cell_along(grid, 1, p.y + cutoff);
  const int z0 = cell_along(grid, 2, p.z - cutoff), z1 = cell_along(grid, 2, p.z + cutoff);
  // Neighbours in the order of slots mostly share a column: they all begin one column before it, so that they
  // are in the same column at any time and read the same cache lines, though some skip it.
  const int first_x = min(x0, cell_along(grid, 0, p.x) - 1), first_y = min(y0, cell_along(grid, 1, p.y) - 1);
  const int width = z1 + 1 - z0, next_y = grid.cells[2];
  for (int x = first_x; x <= x1; ++x) {
    for (int y = first_y; y <= y1; y += columns_at_a_time) {
      bool again;
      int skipped = 0;
      do {
        prepare();
        again = false;
        const int first = (x * grid.cells[1] + y) * next_y + z0;
        Ranges ranges;
#pragma unroll
        for (int c = 0; c < columns_at_a_time; ++c) {
          const bool seen = x >= x0 && y + c >= y0 && y + c <= y1;
          // Loads without a condition take fewer instructions.
          const unsigned from = seen ? static_cast<unsigned>(first + c * next_y) : 0u;
          const unsigned to = seen ? static_cast<unsigned>(first + c * next_y + width) : 0u;
          const int end = start[to];
          ranges.begin[c] = min(start[from] + skipped, end);
          ranges.end[c] = min(ranges.begin[c] + Longest, end);
          again = again || ranges.end[c] < end;
        }
        visit(ranges);
        skipped += Longest;
      } while (again);
    }
  }
}

namespace detail {

/// Extremes of a set of items.
struct Bounds {
  float low[3], high[3], smallest, largest;
};

// Blocks of find_bounds that are done. Zero when the module is loaded and between builds, for which no memory
// has to be cleared beforehand; builds of one module must not overlap (they all go to the default stream).
static __device__ unsigned bounds_finished;

/// Pointers to everything that a build works on.
struct Storage {
  Grid* grid;
  Bounds* partial;  // one a block of find_bounds
  int* start;       // first slot of each cell
  int* bin_count;   // items of each bin
  int* left_over;   // number of records without room in their bin: they follow those of all bins
  int* left_bin;    // and the bin of each
  int capacity;     // most cells a grid may have
  int bins;         // most bins
  int tile;         // items that a block splits at a time
};

/// Bins in use: those of all cells.
template <class Policy>
__device__ __forceinline__ int bins_of(const Grid& grid) {
  return (grid.total + Policy::bin_cells - 1) / Policy::bin_cells;
}

// Copy to shared memory without a register between: a loop of these has all of them under way.
__device__ __forceinline__ void copy_async(float4* to, const float4* from) {
  asm volatile(
      "cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(static_cast<unsigned>(__cvta_generic_to_shared(to))),
      "l"(from)
      : "memory");
}
// For the thread's own copies.
__device__ __forceinline__ void wait_for_copies() {
  asm volatile("cp.async.wait_all;" ::: "memory");
}

/// Sum of the threads before this one. Called by all threads of the block, with a barrier between two calls.
template <int Threads>
__device__ __forceinline__ int sum_before(int own, int* warps) {
  const int lane = static_cast<int>(threadIdx.x) % 32, warp = static_cast<int>(threadIdx.x) / 32;
  int sum = own;
#pragma unroll
  for (int offset = 1; offset < 32; offset *= 2) {
    const int below = __shfl_up_sync(0xffffffffu, sum, offset);
    if (lane >= offset) sum += below;
  }
  if (lane == 31) warps[warp] = sum;
  __syncthreads();
  int before = sum - own;
  for (int w = 0; w < Threads / 32; ++w) {
    if (w < warp) before += warps[w];
  }
  return before;
}

__device__ __forceinline__ Bounds empty_bounds() {
  const float inf = __int_as_float(0x7f800000);
  return {{inf, inf, inf}, {-inf, -inf, -inf}, inf, 0.0f};
}

__device__ __forceinline__ void include(Bounds& a, const Bounds& b) {
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    a.low[d] = fminf(a.low[d], b.low[d]);
    a.high[d] = fmaxf(a.high[d], b.high[d]);
  }
  a.smallest = fminf(a.smallest, b.smallest);
  a.largest = fmaxf(a.largest, b.largest);
}

/// Union over the block; valid in thread 0. Called by all threads, with a barrier between two calls.
template <int Threads>
__device__ __forceinline__ Bounds block_bounds(Bounds b, Bounds* warps) {
  for (int offset = 16; offset > 0; offset /= 2) {
    Bounds other;
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      other.low[d] = __shfl_down_sync(0xffffffffu, b.low[d], offset);
      other.high[d] = __shfl_down_sync(0xffffffffu, b.high[d], offset);
    }
    other.smallest = __shfl_down_sync(0xffffffffu, b.smallest, offset);
    other.largest = __shfl_down_sync(0xffffffffu, b.largest, offset);
    include(b, other);
  }
  if (threadIdx.x % 32 == 0) warps[threadIdx.x / 32] = b;
  __syncthreads();
  if (threadIdx.x == 0) {
    for (int w = 1; w < Threads / 32; ++w) include(b, warps[w]);
  }
  return b;
}

/// Edges of twice the largest radius (a fraction of it along z), enlarged until the grid fits.
template <class Policy>
__device__ inline Grid choose_grid(const Bounds& b, int capacity) {
  constexpr float most_cells = 2097152.0f;  // along one axis: exact as float with room to spare
  Grid g;
  float edge[3];
  const float wish = fmaxf(2.0f * b.largest, 1e-30f);
  for (int d = 0; d < 3; ++d) {
    g.low[d] = b.low[d];
    edge[d] = fmaxf(d == 2 ? wish / Policy::z_cells : wish, (b.high[d] - b.low[d]) / most_cells);
  }
  g.extent = fmaxf(fmaxf(b.high[0] - b.low[0], b.high[1] - b.low[1]), b.high[2] - b.low[2]);
  g.smallest = b.smallest;
  g.largest = b.largest;
  for (int attempt = 0;; ++attempt) {
    float product = 1.0f;
    for (int d = 0; d < 3; ++d) {
      g.inverse_edge[d] = attempt < 400 ? 1.0f / edge[d] : 0.0f;  // a single cell as the last resort
      const float last = floorf((b.high[d] - b.low[d]) * g.inverse_edge[d]);
      const float cells = fminf(fmaxf(last, 0.0f), most_cells) + 1.0f;
      g.cells[d] = static_cast<int>(cells);
      product *= cells;
    }
    if (product <= 0.999f * static_cast<float>(capacity) || attempt >= 400) break;
    for (int d = 0; d < 3; ++d) {
      if (g.cells[d] > 1) edge[d] *= 1.25f;
    }
  }
  g.total = g.cells[0] * g.cells[1] * g.cells[2];
  return g;
}

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::bounds_threads)
    find_bounds(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  __shared__ Bounds warps[Policy::bounds_threads / 32];
  __shared__ bool last_block;
  allow_next();
  const int first = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int c = first; c < s.bins; c += stride) s.bin_count[c] = 0;
  if (first == 0) *s.left_over = 0;

  Bounds b = empty_bounds();
  // Loads of four items in flight, also at the end, where the last item is met again.
  const std::int64_t last = source.count - 1;
  for (std::int64_t i = first; i <= last; i += 4 * static_cast<std::int64_t>(stride)) {
    float3 p[4];
    float radius[4];
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      const int item = static_cast<int>(min(i + k * static_cast<std::int64_t>(stride), last));
      p[k] = source.position(item);
      radius[k] = source.radius(item);
    }
#pragma unroll
    for (int k = 0; k < 4; ++k)
      include(b, {{p[k].x, p[k].y, p[k].z}, {p[k].x, p[k].y, p[k].z}, radius[k], radius[k]});
  }
  b = block_bounds<Policy::bounds_threads>(b, warps);
  if (threadIdx.x == 0) {
    s.partial[blockIdx.x] = b;
    __threadfence();
    last_block = atomicAdd(&bounds_finished, 1u) + 1u == gridDim.x;
  }
  __syncthreads();
  if (!last_block) return;
  __threadfence();
  b = empty_bounds();
  for (int k = static_cast<int>(threadIdx.x); k < static_cast<int>(gridDim.x); k += Policy::bounds_threads) {
    const float* const words = reinterpret_cast<const float*>(s.partial + k);
    Bounds other;
    for (int d = 0; d < 3; ++d) {
      other.low[d] = __ldcg(words + d);
      other.high[d] = __ldcg(words + 3 + d);
    }
    other.smallest = __ldcg(words + 6);
    other.largest = __ldcg(words + 7);
    include(b, other);
  }
  b = block_bounds<Policy::bounds_threads>(b, warps);
  if (threadIdx.x == 0) {
    *s.grid = choose_grid<Policy>(b, s.capacity);
    bounds_finished = 0;
  }
}

/// Shared memory of split_items: a tile's records and their places, and two numbers of each bin.
template <class Policy, class Source>
std::size_t split_bytes(int bins) {
  return (sizeof(typename Source::Record) + sizeof(int)) * Policy::split_threads * Policy::split_each +
         2 * sizeof(int) * static_cast<std::size_t>(bins);
}

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::split_threads, Policy::split_blocks_per_sm)
    split_items(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  using Record = typename Source::Record;
  constexpr int threads = Policy::split_threads, each = Policy::split_each;
  constexpr int words = static_cast<int>(sizeof(Record) / sizeof(float4));
  constexpr int at_once = 4;  // atomics of a thread that are under way
  static_assert(sizeof(Record) % sizeof(float4) == 0 && threads % 32 == 0);
  static_assert(threads * each <= 65536 && Policy::most_bins <= 65536);
  extern __shared__ float4 dynamic_shared[];
  Record* const staged = reinterpret_cast<Record*>(dynamic_shared);  // the tile's records by bins
  int* const target = reinterpret_cast<int*>(staged + threads * each);
  // Of each bin, x: its items in the tile, then where they begin among the tile's; y: those placed before.
  int2* const of_bin = reinterpret_cast<int2*>(target + threads * each);
  __shared__ int warps[threads / 32];
  __shared__ Grid grid;
  const int thread = static_cast<int>(threadIdx.x);
  allow_next();
  Record record[each];
  const auto fetch = [&](int begin) {
    const int last = min(begin + s.tile, source.count) - 1;
#pragma unroll
    for (int k = 0; k < each; ++k) record[k] = source.record(min(begin + thread + k * threads, last));
  };
  const int stride = static_cast<int>(gridDim.x) * s.tile;
  int begin = static_cast<int>(blockIdx.x) * s.tile;
  fetch(begin);
  wait_for_previous();
  if (thread == 0) grid = *s.grid;
  const int bins = bins_of<Policy>(*s.grid);
  for (;;) {
    const int items = min(s.tile, source.count - begin);
    for (int b = thread; b < bins; b += threads) of_bin[b].x = 0;
    __syncthreads();
    unsigned found[each] = {};  // bins of the thread's items, and ranks among the tile's
#pragma unroll
    for (int k = 0; k < each; ++k) {
      if (thread + k * threads < items) {
        const int bin = cell_of(grid, source.position(record[k])) / Policy::bin_cells;
        found[k] = static_cast<unsigned>(bin) | static_cast<unsigned>(atomicAdd(&of_bin[bin].x, 1)) << 16;
      }
    }
    __syncthreads();
    // A thread's bins are `threads` apart, and the tile is sorted in the order of threads.
    const auto reserve = [&](int b) { return of_bin[b].x > 0 ? atomicAdd(s.bin_count + b, of_bin[b].x) : 0; };
    int reserved[at_once], own = 0;
#pragma unroll
    for (int k = 0; k < at_once; ++k) {
      const int b = thread + k * threads;
      reserved[k] = b < bins ? reserve(b) : 0;
      own += b < bins ? of_bin[b].x : 0;
    }
#pragma unroll 1
    for (int b = thread + at_once * threads; b < bins; b += threads) {
      of_bin[b].y = reserve(b);
      own += of_bin[b].x;
    }
    int place = sum_before<threads>(own, warps);
    const auto begin_at_place = [&](int b) {
      const int here = of_bin[b].x;
      of_bin[b].x = place;
      place += here;
    };
#pragma unroll
    for (int k = 0; k < at_once; ++k) {
      const int b = thread + k * threads;
      if (b >= bins) continue;
      begin_at_place(b);
      of_bin[b].y = reserved[k];
    }
#pragma unroll 1
    for (int b = thread + at_once * threads; b < bins; b += threads) begin_at_place(b);
    __syncthreads();
#pragma unroll
    for (int k = 0; k < each; ++k) {
      if (thread + k * threads < items) {
        const int bin = static_cast<int>(found[k] & 0xffffu), rank = static_cast<int>(found[k] >> 16);
        const int2 start = of_bin[bin];
        const int to = start.x + rank, in_bin = start.y + rank;
        staged[to] = record[k];
        target[to] = bin * Policy::bin_items + in_bin;
        if (in_bin >= Policy::bin_items) {
          const int left = atomicAdd(s.left_over, 1);
          s.left_bin[left] = bin;
          target[to] = s.bins * Policy::bin_items + left;
        }
      }
    }
    __syncthreads();
    begin += stride;
    const bool more = begin < source.count;
    if (more) fetch(begin);
#pragma unroll 1  // few registers are left by what is under way
    for (int word = thread; word < items * words; word += threads)
      reinterpret_cast<float4*>(source.split + target[word / words])[word % words] = dynamic_shared[word];
    if (!more) break;
  }
}

/// Words of a bin's records in shared memory: a row for each number of word, rows in different banks.
template <class Policy>
constexpr int bin_row = Policy::bin_items / 8 * 8 + 12;

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::bin_threads, Policy::bin_blocks_per_sm)
    sort_bins(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  using Record = typename Source::Record;
  constexpr int threads = Policy::bin_threads, words = static_cast<int>(sizeof(Record) / sizeof(float4));
  constexpr int bin_cells = Policy::bin_cells, row = bin_row<Policy>;
  constexpr int share = (Policy::bin_items + threads - 1) / threads;  // most records of a thread
  static_assert(bin_cells % 4 == 0 && threads >= bin_cells / 4 && threads % 32 == 0);
  static_assert(Policy::bin_items <= 65536 && bin_cells <= 65536);
  allow_next();
  wait_for_previous();
  const Grid grid = *s.grid;
  const int thread = static_cast<int>(threadIdx.x), bin = static_cast<int>(blockIdx.x);
  const int first_cell = bin * bin_cells;
  if (first_cell >= grid.total) return;
  extern __shared__ float4 dynamic_shared[];  // the bin's records as they came
  __shared__ int4 cell_counts[bin_cells / 4];
  __shared__ unsigned short order[Policy::bin_items];  // which of them comes to each slot
  __shared__ int warps[threads / 32], sums[threads / 32];
  int* const cells = reinterpret_cast<int*>(cell_counts);
  const int count = s.bin_count[bin];
  const bool fits = count <= Policy::bin_items;
  const Record* const incoming = source.split + static_cast<std::size_t>(bin) * Policy::bin_items;
  const auto staged = [&](int k) {
    Record record;
#pragma unroll
    for (int w = 0; w < words; ++w) reinterpret_cast<float4*>(&record)[w] = dynamic_shared[w * row + k];
    return record;
  };
  const auto cell_in_bin = [&](const Record& record) {
    return cell_of(grid, source.position(record)) - first_cell;
  };
  const auto place = [&](int slot, const Record& record) {
#pragma unroll
    for (int w = 0; w < words; ++w)
      source.sorted[static_cast<std::size_t>(w) * static_cast<std::size_t>(source.count) +
                    static_cast<std::size_t>(slot)] = reinterpret_cast<const float4*>(&record)[w];
    source.placed(grid, slot, record);
  };

  // The records of a bin that does not fit.
  const auto each_crowded = [&](auto&& body) {
#pragma unroll 1
    for (int k = thread; k < Policy::bin_items; k += threads) body(incoming[k]);
    const int left = *s.left_over;
    const Record* const others = source.split + static_cast<std::size_t>(s.bins) * Policy::bin_items;
#pragma unroll 1
    for (int k = thread; k < left; k += threads) {
      if (s.left_bin[k] == bin) body(others[k]);
    }
  };

  if (fits) {
    const float4* const from = reinterpret_cast<const float4*>(incoming);
    for (int w = thread; w < count * words; w += threads)
      copy_async(dynamic_shared + w % words * row + w / words, from + w);
  }
  // Of the bins before, while the records are under way.
  int begin = 0;
  for (int b = thread; b < bin; b += threads) begin += s.bin_count[b];
  begin = __reduce_add_sync(0xffffffffu, begin);
  if (thread % 32 == 0) sums[thread / 32] = begin;
  if (thread < bin_cells / 4) cell_counts[thread] = make_int4(0, 0, 0, 0);
  wait_for_copies();
  __syncthreads();
  unsigned found[share] = {};  // cells of the thread's records, and ranks in them
  if (fits) {
    int rank[share] = {};
#pragma unroll
    for (int j = 0; j < share; ++j) {
      const int k = thread + j * threads;
      if (k < count) found[j] = static_cast<unsigned>(cell_in_bin(staged(k)));
    }
    // All under way before the first is waited for.
#pragma unroll
    for (int j = 0; j < share; ++j) {
      if (thread + j * threads < count) rank[j] = atomicAdd(cells + found[j], 1);
    }
#pragma unroll
    for (int j = 0; j < share; ++j) found[j] |= static_cast<unsigned>(rank[j]) << 16;
  } else {
    each_crowded([&](const Record& record) { atomicAdd(cells + cell_in_bin(record), 1); });
  }
  __syncthreads();

  begin = __reduce_add_sync(0xffffffffu, thread % 32 < threads / 32 ? sums[thread % 32] : 0);
  int4 counts = make_int4(0, 0, 0, 0);
  if (thread < bin_cells / 4) counts = cell_counts[thread];
  const int before = sum_before<threads>(counts.x + counts.y + counts.z + counts.w, warps);
  if (thread < bin_cells / 4) {
    const int second = before + counts.x, third = second + counts.y, fourth = third + counts.z;
    cell_counts[thread] = make_int4(before, second, third, fourth);
    // Of the last bin also cells that do not exist: the first of these holds the number of items.
    reinterpret_cast<int4*>(s.start + first_cell)[thread] =
        make_int4(begin + before, begin + second, begin + third, begin + fourth);
  }
  if (thread == 0 && first_cell + bin_cells == grid.total) s.start[grid.total] = source.count;
  __syncthreads();

  if (!fits) {
    each_crowded(
        [&](const Record& record) { place(begin + atomicAdd(cells + cell_in_bin(record), 1), record); });
    return;
  }
#pragma unroll
  for (int j = 0; j < share; ++j) {
    const int k = thread + j * threads;
    if (k < count)
      order[cells[found[j] & 0xffffu] + static_cast<int>(found[j] >> 16)] = static_cast<unsigned short>(k);
  }
  __syncthreads();
  // Warps write whole lines.
  for (int k = thread - begin % 32; k < count; k += threads) {
    if (k >= 0) place(begin + k, staged(order[k]));
  }
}

}  // namespace detail

/// Owns the grid's memory and builds it. `grid()` and `start()` are for kernels launched after build().
template <class Policy = DefaultPolicy>
class NeighbourGrid {
 public:
  /// For builds of up to `items` items of a Source.
  template <class Source>
  void allocate(std::int64_t items) {
    const double wish = static_cast<double>(Policy::cells_per_item) * static_cast<double>(items) + 4096;
    const int most = Policy::most_bins * Policy::bin_cells;
    s_.capacity = static_cast<int>(std::min(wish, static_cast<double>(most)));
    s_.bins = (s_.capacity + Policy::bin_cells - 1) / Policy::bin_cells;
    // As many tiles as blocks, or a multiple of it: one wave of equal blocks.
    const auto shares = [items](std::int64_t of) { return (items + of - 1) / of; };
    const std::int64_t rounds = shares(std::int64_t{Policy::split_blocks} * most_in_tile);
    s_.tile = static_cast<int>(
        std::min<std::int64_t>((shares(Policy::split_blocks * rounds) + 31) / 32 * 32, most_in_tile));
    bounds_blocks_ = static_cast<unsigned>(std::clamp<std::int64_t>(
        (items + Policy::bounds_threads - 1) / Policy::bounds_threads, 1, Policy::bounds_blocks));
    const auto bins = static_cast<std::size_t>(s_.bins);
    grid_ = DeviceBuffer<Grid>(1);
    partial_ = DeviceBuffer<detail::Bounds>(bounds_blocks_);
    start_ = DeviceBuffer<int>(bins * Policy::bin_cells + 1);
    bin_count_ = DeviceBuffer<int>(bins);
    left_over_ = DeviceBuffer<int>(1);
    left_bin_ = DeviceBuffer<int>(static_cast<std::size_t>(items));
    s_.grid = grid_.get();
    s_.partial = partial_.get();
    s_.start = start_.get();
    s_.bin_count = bin_count_.get();
    s_.left_over = left_over_.get();
    s_.left_bin = left_bin_.get();
    GPUPHYS_CUDA(cudaFuncSetAttribute(detail::split_items<Policy, Source>,
                                      cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(detail::split_bytes<Policy, Source>(s_.bins))));
    GPUPHYS_CUDA(cudaFuncSetAttribute(detail::sort_bins<Policy, Source>,
                                      cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(bin_bytes<Source>())));
  }

  /// Sorts the items of `source` (at least one, at most as many as allocated for).
  template <class Source>
  void build(const Source& source) {
    const int tiles = (source.count + s_.tile - 1) / s_.tile;
    detail::find_bounds<Policy><<<bounds_blocks_, Policy::bounds_threads>>>(source, s_);
    launch_dependent(detail::split_items<Policy, Source>,
                     static_cast<unsigned>(std::min(tiles, Policy::split_blocks)), Policy::split_threads,
                     detail::split_bytes<Policy, Source>(s_.bins), source, s_);
    launch_dependent(detail::sort_bins<Policy, Source>, static_cast<unsigned>(s_.bins), Policy::bin_threads,
                     bin_bytes<Source>(), source, s_);
  }

  /// That Source::split has room for.
  std::size_t records(std::int64_t items) const {
    return static_cast<std::size_t>(s_.bins) * Policy::bin_items + static_cast<std::size_t>(items);
  }

  // For kernels launched after build(): by launch_dependent(), or as usual.
  const Grid* grid() const { return s_.grid; }
  const int* start() const { return s_.start; }  ///< first slot of each cell, and the number of items

 private:
  static constexpr int most_in_tile = Policy::split_threads * Policy::split_each;

  template <class Source>
  static std::size_t bin_bytes() {
    return sizeof(typename Source::Record) * detail::bin_row<Policy>;
  }

  detail::Storage s_{};
  unsigned bounds_blocks_ = 1;
  DeviceBuffer<Grid> grid_;
  DeviceBuffer<detail::Bounds> partial_;
  DeviceBuffer<int> start_, bin_count_, left_over_, left_bin_;
};

}  // namespace gpuphys::neighbour_grid
