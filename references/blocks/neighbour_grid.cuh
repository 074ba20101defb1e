// Neighbour search on the device: items sorted by the cells of a uniform grid, for any payload and any
// cut-off.
//
// In short, for points that meet others within `reach`:
//
//     neighbour_grid::NeighbourGrid<> grid;                      // a member of the solver
//     grid.allocate<neighbour_grid::Points>(n);                  // in allocate()
//     split = DeviceBuffer<float4>(grid.records(n));
//     sorted = DeviceBuffer<float4>(n);
//     grid.build(neighbour_grid::Points{x, reach, split.get(), sorted.get(), n});          // in compute()
//     kernel<<<...>>>(grid.grid(), grid.start(), sorted.get(), ...);
//
// and in the kernel, where sorted[slot] is (x, y, z, index in the input as bits):
//
//     visit_columns(grid, start, position, reach, [&](int begin, int end) {    // slots [begin, end)
//       for (int slot = begin; slot < end; ++slot) ...                         // those within reach, and
//       others
//     });
//
// A build sorts in two levels and is three launches, each prepared during the one before
// (dependent_launch.cuh), without a round trip to the host:
//   1. find_bounds   bounding box and largest radius; its last block chooses the grid.
//   2. split_items   every bin, a range of `bin_cells` cells, has room for `bin_items` records. A block takes
//                    its items in tiles: it counts a tile by bins in shared memory, reserves the next places
//                    in each (one atomic per bin and tile, neighbouring bins by neighbouring lanes), and
//                    writes the records there, straight from registers. What finds no room goes to a common
//                    list.
//   3. sort_bins     a block per bin: counts the bin's cells, writes their starts, and its records in order.
//                    All in shared memory, and each record is ranked once; a bin with more than
//                    `bin_items` goes through global memory instead, and looks for the rest in the list.
// Cells are contiguous along z, so that the cells [z0, z1] of one column are one range of slots:
// [start[row + z0], start[row + z1 + 1]).
//
// Neighbours are searched by visiting the cells of position -/+ cut-off: visit_columns(), or visit_ranges()
// where three columns at a time pay. Cell numbers come from one function that is monotone in the coordinate,
// rounding included, so no pair within the cut-off can be missed, whatever the edges are: they are a matter
// of speed alone. Where the box is too large for `capacity` cells of the wished size, cells are enlarged.
//
// What a user supplies is a Source, copied to the kernels by value (Points is one):
//   int count;                                     number of items, >= 1
//   __device__ const float* positions() const;     x, y and z of item 0, of item 1, ...; aligned to 16 bytes,
//                                                  as is what prefetch() copies
//   __device__ const float* radii() const;         half the cut-off of each with one of its own size, aligned
//                                                  likewise; or, if it is the same for all:
//   __device__ float radius() const;
//   using Record;                                  payload of an item: 16 or 32 bytes, aligned to as many
//   static constexpr int chunk_floats;             of shared memory for 32 items, a multiple of four
//   __device__ void prefetch(float* chunk, int first, int end) const;
//                                                  by a whole warp: has copy_async() bring the items from
//                                                  `first`, a multiple of 32, there, as far as `end`
//   __device__ Record record(const float* chunk, int i) const;
//                                                  of item i, the lane's own of the chunk; from `end` on
//                                                  anything
//   __device__ float3 position(const Record&) const;   the same as of its item, bit by bit
//   __device__ void placed(const Grid&, int slot, const Record&) const;   told what comes to each slot
//   Record* split;                                 scratch in device memory for NeighbourGrid::records() of
//                                                  them
//   float4* sorted;                                receives the result, word by word: that of number w of
//                                                  the record in slot s is sorted[w * count + s]
//
// What bounds it: DRAM in find_bounds (52 %), L2 in the others (68 and 69 %). Records are written twice and
// read once; one of 32 bytes fills a sector, whereas a sector written in part may be fetched from DRAM before
// it is written back (measured: 0.25 ms for 2M records of two separate 16-byte stores). What pays:
// - Items are read by 16 bytes, and to be split they come to shared memory past the registers (cp.async): the
//   next tile's are under way while one is counted and written.
// - Large tiles: fewer reservations. Shared memory has room for them because it holds no records: these are
//   not put in the order of bins before they are written. All blocks append to the same places of the bins at
//   about the same time, and L2 makes lines of that in whatever order it comes.
// - Two lanes write a record: a request consists of whole sectors.
// - The bounds of all blocks meet in eight numbers by atomics, so that the last block reads one line.
// - Loads are issued in batches, also at the end of a loop (indices are clamped there), and before the first
//   is waited for. The grid is read from registers or shared memory inside loops: a load of it would queue
//   behind those of the items.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/common/block_sum.cuh"
#include "references/common/dependent_launch.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/machine.cuh"

namespace gpuphys::neighbour_grid {

/// Tuning. Users may pass a class of their own with the same members.
struct DefaultPolicy {
  static constexpr int bounds_threads = 512;
  static constexpr int bounds_blocks_per_sm = 3;  // one wave
  static constexpr int split_threads = 768;
  static constexpr int split_each = 3;           // items of a thread in a tile
  static constexpr int split_blocks_per_sm = 2;  // one wave
  static constexpr int bin_cells = 1024;         // a multiple of four
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
__host__ __device__ __forceinline__ int cell_along(const Grid& grid, int axis, float x) {
  const float t = (x - grid.low[axis]) * grid.inverse_edge[axis];
  return static_cast<int>(fminf(fmaxf(t, 0.0f), static_cast<float>(grid.cells[axis] - 1)));
}

__host__ __device__ __forceinline__ int cell_of(const Grid& grid, float3 p) {
  return (cell_along(grid, 0, p.x) * grid.cells[1] + cell_along(grid, 1, p.y)) * grid.cells[2] +
         cell_along(grid, 2, p.z);
}

/// Columns of cells that visit_ranges() hands over at a time.
constexpr int kColumns = 3;

/// The slots [begin, end) of each; some may be empty.
struct Ranges {
  int begin[kColumns], end[kColumns];
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
    for (int y = first_y; y <= y1; y += kColumns) {
      bool again;
      int skipped = 0;
      do {
        prepare();
        again = false;
        const int first = (x * grid.cells[1] + y) * next_y + z0;
        Ranges ranges;
#pragma unroll
        for (int c = 0; c < kColumns; ++c) {
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

/// Calls visit(begin, end) for ranges of slots that hold every item within `cutoff` of `p` along each axis
/// (and others), each once; ranges may be empty. `p` need not be an item.
template <class Visit>
__device__ __forceinline__ void visit_columns(const Grid& grid, const int* start, float3 p, float cutoff,
                                              Visit&& visit) {
  const int x0 = cell_along(grid, 0, p.x - cutoff), x1 = cell_along(grid, 0, p.x + cutoff);
  const int y0 = cell_along(grid, 1, p.y - cutoff), y1 = cell_along(grid, 1, p.y + cutoff);
  const int z0 = cell_along(grid, 2, p.z - cutoff), z1 = cell_along(grid, 2, p.z + cutoff);
  for (int x = x0; x <= x1; ++x) {
    for (int y = y0; y <= y1; ++y) {
      const int row = (x * grid.cells[1] + y) * grid.cells[2];
      visit(start[row + z0], start[row + z1 + 1]);
    }
  }
}

/// The Source of points without a payload that all have the same reach: two meet within it. A record is the
/// position and, as bits, the index in the input.
struct Points {
  using Record = float4;
  const float* __restrict__ x;  // (count, 3), aligned to 16 bytes
  float reach;
  float4* __restrict__ split;
  float4* __restrict__ sorted;
  int count;

  __device__ __forceinline__ const float* positions() const { return x; }
  __device__ __forceinline__ float radius() const { return 0.5f * reach; }
  static constexpr int chunk_floats = 3 * 32;
  __device__ __forceinline__ void prefetch(float* chunk, int first, int end) const {
    const unsigned piece = threadIdx.x % 32, word = 3u * static_cast<unsigned>(first) + 4u * piece;
    const unsigned last = 3u * static_cast<unsigned>(end);
    const unsigned bytes = word < last ? min(4u * (last - word), 16u) : 0u;
    if (piece < chunk_floats / 4) copy_async(chunk + 4u * piece, x + (bytes > 0u ? word : 0u), bytes);
  }
  __device__ __forceinline__ float4 record(const float* chunk, int i) const {
    const float* const own = chunk + 3u * (threadIdx.x % 32);
    return make_float4(own[0], own[1], own[2], __int_as_float(i));
  }
  __device__ __forceinline__ float3 position(const float4& record) const {
    return {record.x, record.y, record.z};
  }
  __device__ __forceinline__ void placed(const Grid&, int, const float4&) const {}
};

namespace detail {

/// Extremes of a set of items.
struct Bounds {
  float low[3], high[3], smallest, largest;
};

// Words of 16 bytes in a record.
template <class Source>
constexpr int record_words = static_cast<int>(sizeof(typename Source::Record) / sizeof(float4));

// Whether items have radii of their own.
template <class Source>
concept HasRadii = requires(const Source& s) {
  s.radii();
};

// What the blocks of find_bounds share. As initialised when the module is loaded and between builds, for
// which no memory has to be set beforehand; builds of one module must not overlap (they all go to the default
// stream).
constexpr int no_key = 0x7fffffff;
static __device__ int bounds_keys[8] = {no_key, no_key, no_key, no_key, no_key, no_key, no_key, no_key};
static __device__ unsigned bounds_finished;  // blocks that are done

/// Pointers to everything that a build works on.
struct Storage {
  Grid* grid;
  int* start;      // first slot of each cell
  int* bin_count;  // items of each bin
  int* left_over;  // number of records without room in their bin: they follow those of all bins
  int* left_bin;   // and the bin of each
  int capacity;    // most cells a grid may have
  int bins;        // most bins
  int tile;        // items that a block splits at a time
};

/// Bins in use: those of all cells.
template <class Policy>
__device__ __forceinline__ int bins_of(const Grid& grid) {
  return (grid.total + Policy::bin_cells - 1) / Policy::bin_cells;
}

__device__ __forceinline__ Bounds empty_bounds() {
  const float inf = __int_as_float(0x7f800000);
  return {{inf, inf, inf}, {-inf, -inf, -inf}, inf, 0.0f};
}

// Integers in the order of the floats that have these bits; its own inverse.
__device__ __forceinline__ int ordered(int bits) {
  return bits ^ (bits >> 31 & 0x7fffffff);
}

/// Edges of twice the largest radius (a fraction of it along z), enlarged until the grid fits.
template <class Policy>
__host__ __device__ inline Grid choose_grid(const Bounds& b, int capacity) {
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
  constexpr int keys = Policy::bounds_threads / 32 * 8;
  static_assert(Policy::bounds_threads % 32 == 0);
  __shared__ int warp_keys[keys];
  allow_next();
  const int first = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int c = first; c < s.bins; c += stride) s.bin_count[c] = 0;
  if (first == 0) *s.left_over = 0;

  // By 16 bytes: number j of these holds coordinates j, j + 1, j + 2 and j of the three, modulo 3. A thread
  // meets one j modulo 3 only, so that it need not tell them apart before the end.
  Bounds b = empty_bounds();
  const float4* const positions = reinterpret_cast<const float4*>(source.positions());
  [[maybe_unused]] const float4* radii = nullptr;
  if constexpr (HasRadii<Source>) radii = reinterpret_cast<const float4*>(source.radii());
  const unsigned quads = static_cast<unsigned>(source.count) / 4u, threes = 3u * quads;
  const unsigned ufirst = static_cast<unsigned>(first), step = static_cast<unsigned>(stride) / 3u * 3u;
  if (ufirst < step) {
    for (unsigned round = 0; ufirst + 3u * round * step < threes; ++round) {
      float4 p[3];
#pragma unroll
      for (unsigned c = 0; c < 3; ++c) {
        const unsigned j = ufirst + (3u * round + c) * step;
        p[c] = positions[j < threes ? j : ufirst];
      }
      const unsigned j = ufirst + round * step;
      float4 r{};
      if constexpr (HasRadii<Source>) r = radii[j < quads ? j : 0u];
#pragma unroll
      for (int c = 0; c < 3; ++c) {
        b.low[0] = fminf(fminf(b.low[0], p[c].x), p[c].w);
        b.low[1] = fminf(b.low[1], p[c].y);
        b.low[2] = fminf(b.low[2], p[c].z);
        b.high[0] = fmaxf(fmaxf(b.high[0], p[c].x), p[c].w);
        b.high[1] = fmaxf(b.high[1], p[c].y);
        b.high[2] = fmaxf(b.high[2], p[c].z);
      }
      if constexpr (HasRadii<Source>) {
        b.smallest = fminf(fminf(fminf(b.smallest, r.x), fminf(r.y, r.z)), r.w);
        b.largest = fmaxf(fmaxf(fmaxf(b.largest, r.x), fmaxf(r.y, r.z)), r.w);
      }
    }
  }
  // Coordinate d is number d - first, modulo 3.
  const Bounds turned = b;
  const int phase = first % 3;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const int second = (d + 2) % 3, third = (d + 1) % 3;
    b.low[d] = phase == 0 ? turned.low[d] : phase == 1 ? turned.low[second] : turned.low[third];
    b.high[d] = phase == 0 ? turned.high[d] : phase == 1 ? turned.high[second] : turned.high[third];
  }
  // The last items do not fill 16 bytes.
  const unsigned rest = 4u * quads + ufirst;
  if (rest < static_cast<unsigned>(source.count)) {
#pragma unroll
    for (unsigned d = 0; d < 3; ++d) {
      const float x = source.positions()[3u * rest + d];
      b.low[d] = fminf(b.low[d], x);
      b.high[d] = fmaxf(b.high[d], x);
    }
    if constexpr (HasRadii<Source>) {
      const float radius = source.radii()[rest];
      b.smallest = fminf(b.smallest, radius);
      b.largest = fmaxf(b.largest, radius);
    }
  }
  if constexpr (!HasRadii<Source>) b.smallest = b.largest = source.radius();

  // Of the warp, of the block, of all: keys of the eight numbers, whose least one is the extreme.
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32;
  const float extremes[8] = {b.low[0],  b.low[1],  b.low[2],  b.smallest,
                             b.high[0], b.high[1], b.high[2], b.largest};
  int key = no_key;
#pragma unroll
  for (int w = 0; w < 8; ++w) {
    const int own = ordered(__float_as_int(extremes[w]));
    const int least = __reduce_min_sync(0xffffffffu, w < 4 ? own : ~own);
    if (lane == w) key = least;
  }
  if (lane < 8) warp_keys[thread / 32 * 8 + lane] = key;
  __syncthreads();
  if (thread >= 32) return;
  key = no_key;
#pragma unroll
  for (int k = 0; k < keys; k += 32) {
    if (k + lane < keys) key = min(key, warp_keys[k + lane]);
  }
  key = min(key, __shfl_xor_sync(0xffffffffu, key, 8));
  key = min(key, __shfl_xor_sync(0xffffffffu, key, 16));
  if (lane < 8) atomicMin(bounds_keys + lane, key);
  __syncwarp();
  fence_device();
  unsigned done = 0;
  if (lane == 0) done = atomicAdd(&bounds_finished, 1u) + 1u;
  if (__shfl_sync(0xffffffffu, done, 0) != gridDim.x) return;
  fence_device();
  __syncwarp();
  key = lane < 8 ? __ldcg(bounds_keys + lane) : 0;
  if (lane >= 4) key = ~key;
  const float extreme = __int_as_float(ordered(key));
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    b.low[d] = __shfl_sync(0xffffffffu, extreme, d);
    b.high[d] = __shfl_sync(0xffffffffu, extreme, 4 + d);
  }
  b.smallest = __shfl_sync(0xffffffffu, extreme, 3);
  b.largest = __shfl_sync(0xffffffffu, extreme, 7);
  if (lane < 8) bounds_keys[lane] = no_key;
  if (lane == 0) {
    *s.grid = choose_grid<Policy>(b, s.capacity);
    bounds_finished = 0;
  }
}

/// Shared memory of split_items: what a tile's items are made of, and two numbers of each bin.
template <class Policy, class Source>
std::size_t split_bytes(int bins) {
  return sizeof(float) * Source::chunk_floats * (Policy::split_threads / 32 * Policy::split_each) +
         2 * sizeof(int) * static_cast<std::size_t>(bins);
}

// A pair of lanes writes first the even one's record, then the odd one's, each lane a word of it: whole
// sectors. A lane without a target (-1) lends a hand.
template <class Record>
__device__ __forceinline__ void write_by_pairs(Record* split, int target, const Record& record) {
  const float4* const word = reinterpret_cast<const float4*>(&record);
  const bool odd = threadIdx.x % 2 != 0;
  const auto choose = [&](const float4& if_odd, const float4& if_even) {
    return make_float4(odd ? if_odd.x : if_even.x, odd ? if_odd.y : if_even.y, odd ? if_odd.z : if_even.z,
                       odd ? if_odd.w : if_even.w);
  };
  const float4 kept = choose(word[1], word[0]), given = choose(word[0], word[1]);
  const float4 taken =
      make_float4(__shfl_xor_sync(0xffffffffu, given.x, 1), __shfl_xor_sync(0xffffffffu, given.y, 1),
                  __shfl_xor_sync(0xffffffffu, given.z, 1), __shfl_xor_sync(0xffffffffu, given.w, 1));
  const int other = __shfl_xor_sync(0xffffffffu, target, 1);
  const int even_target = odd ? other : target, odd_target = odd ? target : other;
  if (even_target >= 0) reinterpret_cast<float4*>(split + even_target)[odd] = choose(taken, kept);
  if (odd_target >= 0) reinterpret_cast<float4*>(split + odd_target)[odd] = choose(kept, taken);
}

// A warp fetches the chunks of its own items, and makes records of them at the beginning of a tile; then the
// next tile's may come. So no barrier belongs to them.
template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::split_threads, Policy::split_blocks_per_sm)
    split_items(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  using Record = typename Source::Record;
  constexpr int threads = Policy::split_threads, each = Policy::split_each;
  constexpr int chunk_floats = Source::chunk_floats;
  constexpr int at_once = 4;  // atomics of a thread that are under way
  constexpr int words = record_words<Source>;
  static_assert(words == 1 || words == 2);
  static_assert(sizeof(Record) == words * sizeof(float4) && alignof(Record) == sizeof(Record));
  static_assert(chunk_floats % 4 == 0 && threads % 32 == 0);
  static_assert(threads * each <= 65536 && Policy::most_bins <= 65536);
  extern __shared__ float4 dynamic_shared[];
  float* const chunks = reinterpret_cast<float*>(dynamic_shared);
  // Of each bin: its items in the tile, then those placed before. And of the next tile.
  int* of_bin = reinterpret_cast<int*>(chunks + threads / 32 * each * chunk_floats);
  int* of_bin_next = of_bin + s.bins;
  __shared__ Grid grid;
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32, warp_first = thread - lane;
  float* const own_chunks = chunks + warp_first / 32 * each * chunk_floats;
  allow_next();
  const auto fetch = [&](int begin) {
#pragma unroll
    for (int k = 0; k < each; ++k)
      source.prefetch(own_chunks + k * chunk_floats, begin + warp_first + k * threads,
                      min(begin + s.tile, source.count));
  };
  const int stride = static_cast<int>(gridDim.x) * s.tile;
  int begin = static_cast<int>(blockIdx.x) * s.tile;
  fetch(begin);
  wait_for_previous();
  if (thread == 0) grid = *s.grid;
  const int bins = bins_of<Policy>(*s.grid);
  for (int b = thread; b < bins; b += threads) of_bin[b] = 0;
  __syncthreads();
  for (;;) {
    const int items = min(s.tile, source.count - begin);
    Record record[each];
    wait_for_copies();
    __syncwarp();  // and for the other lanes'
#pragma unroll
    for (int k = 0; k < each; ++k)
      record[k] = source.record(own_chunks + k * chunk_floats, begin + thread + k * threads);
    __syncwarp();
    const int next = begin + stride;
    if (next < source.count) fetch(next);
    unsigned found[each] = {};  // bins of the thread's items, and ranks among the tile's
#pragma unroll
    for (int k = 0; k < each; ++k) {
      if (thread + k * threads < items) {
        const int bin = cell_of(grid, source.position(record[k])) / Policy::bin_cells;
        found[k] = static_cast<unsigned>(bin) | static_cast<unsigned>(atomicAdd(of_bin + bin, 1)) << 16;
      }
    }
    __syncthreads();
#pragma unroll 1
    for (int from = thread; from < bins; from += at_once * threads) {
      int placed[at_once];
#pragma unroll
      for (int k = 0; k < at_once; ++k) {
        const int b = from + k * threads;
        const int here = b < bins ? of_bin[b] : 0;
        placed[k] = here > 0 ? atomicAdd(s.bin_count + b, here) : 0;
      }
#pragma unroll
      for (int k = 0; k < at_once; ++k) {
        const int b = from + k * threads;
        if (b < bins) of_bin_next[b] = 0;
      }
#pragma unroll
      for (int k = 0; k < at_once; ++k) {
        const int b = from + k * threads;
        if (b < bins) of_bin[b] = placed[k];
      }
    }
    __syncthreads();
#pragma unroll
    for (int k = 0; k < each; ++k) {
      int target = -1;
      if (thread + k * threads < items) {
        const int bin = static_cast<int>(found[k] & 0xffffu);
        const int in_bin = of_bin[bin] + static_cast<int>(found[k] >> 16);
        target = bin * Policy::bin_items + in_bin;
        if (in_bin >= Policy::bin_items) {
          const int left = atomicAdd(s.left_over, 1);
          s.left_bin[left] = bin;
          target = s.bins * Policy::bin_items + left;
        }
      }
      if constexpr (words == 1) {
        if (target >= 0) source.split[target] = record[k];
      } else {
        write_by_pairs(source.split, target, record[k]);
      }
    }
    begin = next;
    if (begin >= source.count) break;
    // Set to zero two barriers ago; read for the last time before the next barrier.
    int* const of_next_but_one = of_bin;
    of_bin = of_bin_next;
    of_bin_next = of_next_but_one;
  }
}

/// Words of a bin's records in shared memory: a row for each number of word, rows in different banks.
template <class Policy>
constexpr int bin_row = Policy::bin_items / 8 * 8 + 12;

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::bin_threads, Policy::bin_blocks_per_sm)
    sort_bins(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  using Record = typename Source::Record;
  constexpr int threads = Policy::bin_threads, words = record_words<Source>;
  constexpr int bin_cells = Policy::bin_cells, row = bin_row<Policy>;
  constexpr int share = (Policy::bin_items + threads - 1) / threads;  // most records of a thread
  static_assert(bin_cells % 4 == 0 && threads >= bin_cells / 4 && threads % 32 == 0);
  static_assert(Policy::bin_items <= 65536 && bin_cells <= 65536);
  allow_next();
  const int thread = static_cast<int>(threadIdx.x), bin = static_cast<int>(blockIdx.x);
  wait_for_previous();
  // The records wait for `count` alone, and what else is needed is under way before them. (Bins that are not
  // in use hold nothing, so that the grid need not be known.)
  const int count = s.bin_count[bin];
  constexpr int sums_at_once = 5;  // all, in the paper's size
  int counts_before[sums_at_once];
#pragma unroll
  for (int k = 0; k < sums_at_once; ++k) {
    const int b = thread + k * threads;
    counts_before[k] = b < bin ? s.bin_count[b] : 0;
  }
  const Grid grid = *s.grid;
  const int first_cell = bin * bin_cells;
  extern __shared__ float4 dynamic_shared[];  // the bin's records as they came
  __shared__ int4 cell_counts[bin_cells / 4];
  __shared__ unsigned short order[Policy::bin_items];  // which of them comes to each slot
  __shared__ int warps[threads / 32], sums[threads / 32];
  int* const cells = reinterpret_cast<int*>(cell_counts);
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
  if (first_cell >= grid.total) return;
  // Of the bins before, while the records are under way.
  int begin = 0;
#pragma unroll
  for (int k = 0; k < sums_at_once; ++k) begin += counts_before[k];
#pragma unroll 1
  for (int b = thread + sums_at_once * threads; b < bin; b += threads) begin += s.bin_count[b];
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
  /// Items that a block splits at a time, at most.
  static constexpr int kMostInTile = Policy::split_threads * Policy::split_each;

  /// For builds of up to `items` items of a Source.
  template <class Source>
  void allocate(std::int64_t items) {
    const double wish = static_cast<double>(Policy::cells_per_item) * static_cast<double>(items) + 4096;
    const int processors = multiprocessors();
    split_blocks_ = Policy::split_blocks_per_sm * processors;
    // split_items counts all bins in what shared memory its chunks leave.
    const std::size_t shared = static_cast<std::size_t>(most_shared_bytes()) - 256;
    const std::size_t chunks = detail::split_bytes<Policy, Source>(0);
    if (shared < chunks + 2 * sizeof(int) || shared < bin_bytes<Source>())
      throw std::runtime_error("neighbour grid: the tiles do not fit in this device's shared memory");
    const int most_bins =
        static_cast<int>(std::min<std::size_t>(Policy::most_bins, (shared - chunks) / (2 * sizeof(int))));
    const double most = static_cast<double>(most_bins) * Policy::bin_cells;
    s_.capacity = static_cast<int>(std::min(wish, most));
    s_.bins = (s_.capacity + Policy::bin_cells - 1) / Policy::bin_cells;
    // As many tiles as blocks, or a multiple of it: one wave of equal blocks.
    const auto shares = [items](std::int64_t of) { return (items + of - 1) / of; };
    const std::int64_t rounds = shares(std::int64_t{split_blocks_} * kMostInTile);
    s_.tile = static_cast<int>(
        std::min<std::int64_t>((shares(split_blocks_ * rounds) + 31) / 32 * 32, kMostInTile));
    bounds_blocks_ = static_cast<unsigned>(std::clamp<std::int64_t>(
        shares(Policy::bounds_threads), 1, std::int64_t{Policy::bounds_blocks_per_sm} * processors));
    const auto bins = static_cast<std::size_t>(s_.bins);
    grid_ = DeviceBuffer<Grid>(1);
    start_ = DeviceBuffer<int>(bins * Policy::bin_cells + 1);
    bin_count_ = DeviceBuffer<int>(bins);
    left_over_ = DeviceBuffer<int>(1);
    left_bin_ = DeviceBuffer<int>(static_cast<std::size_t>(items));
    s_.grid = grid_.get();
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
                     static_cast<unsigned>(std::min(tiles, split_blocks_)), Policy::split_threads,
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
  template <class Source>
  static std::size_t bin_bytes() {
    return sizeof(typename Source::Record) * detail::bin_row<Policy>;
  }

  detail::Storage s_{};
  unsigned bounds_blocks_ = 1;
  int split_blocks_ = 1;
  DeviceBuffer<Grid> grid_;
  DeviceBuffer<int> start_, bin_count_, left_over_, left_bin_;
};

}  // namespace gpuphys::neighbour_grid
