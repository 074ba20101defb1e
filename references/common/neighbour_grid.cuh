// Neighbour search on the device: items sorted by the cells of a uniform grid, for any payload and any
// cut-off.
//
// A build is five launches, without a round trip to the host:
//   1. find_bounds   bounding box and largest radius; its last block chooses the grid. Clears the counters.
//   2. count_items   items of each cell by atomics; the value returned is the item's rank in its cell.
//   3. exclusive sum over the cells, in place: two launches (references/common/primitives.hpp).
//   4. place_items   every item's record is written at start of its cell + rank.
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
//   __device__ void placed(const Grid&, int i, int slot, const Record&) const;   told where item i goes
//   Record* records;                               device memory for `count` of them, aligned to 32 bytes
//
// Records go to random places. Neighbouring lanes write the words of one record in one instruction: a record
// of 32 or 64 bytes fills whole sectors, whereas a sector written in part is fetched from DRAM before it is
// written back (measured: 0.25 ms for 2M records of two separate 16-byte stores). Keep other sizes rare.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::neighbour_grid {

/// Tuning. Users may pass a class of their own with the same members.
struct DefaultPolicy {
  static constexpr int bounds_threads = 512;
  static constexpr int bounds_blocks = 3 * 132;  // one wave; also bounds the last block's share
  static constexpr int item_threads = 256;       // counting and placing: a thread an item
  static constexpr int z_cells = 2;  // cells along z in one edge along x and y: ranges fit tighter
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

/// Calls visit(begin, end) for ranges of slots that hold every item within `cutoff` of `p` along each axis
/// (and others). `p` need not be an item.
template <class Visit>
__device__ __forceinline__ void visit_ranges(const Grid& grid, const int* __restrict__ start, float3 p,
                                             float cutoff, Visit&& visit) {
  const int x0 = cell_along(grid, 0, p.x - cutoff), x1 = cell_along(grid, 0, p.x + cutoff);
  const int y0 = cell_along(grid, 1, p.y - cutoff), y1 = cell_along(grid, 1, p.y + cutoff);
  const int z0 = cell_along(grid, 2, p.z - cutoff), z1 = cell_along(grid, 2, p.z + cutoff);
  // Neighbours in the order of slots mostly share a column: they all begin one column before it, so that they
  // are in the same column at any time and read the same cache lines, though some skip it. Columns are
  // counted down to the last: `seen` of each axis are visited, `all` include those skipped.
  const int seen_x = x1 - x0, all_x = max(seen_x, x1 - cell_along(grid, 0, p.x) + 1);
  const int seen_y = y1 - y0, all_y = max(seen_y, y1 - cell_along(grid, 1, p.y) + 1);
  const int width = z1 + 1 - z0, next_y = grid.cells[2], next_x = (grid.cells[1] - all_y) * next_y;
  int ahead = ((x1 - all_x) * grid.cells[1] + y1 - all_y) * next_y + z0, begin = 0, end = 0;
  const auto fetch = [&](int x, int y) {
    begin = end = 0;
    if (x > seen_x || y > seen_y) return;
    begin = start[ahead];
    end = start[ahead + width];
  };
  fetch(all_x, all_y);
  for (int x = all_x; x >= 0; --x) {
    for (int y = all_y; y >= 0; --y) {
      // The next column's range is under way while this one is visited: the visit waits for memory once, not
      // twice in a row.
      const int first = begin, last = end;
      ahead += y > 0 ? next_y : next_x;
      if (y > 0 || x > 0) fetch(y > 0 ? x : x - 1, y > 0 ? y - 1 : all_y);
      visit(first, last);
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
  int* start;       // counts, then starts: `padded` entries
  int* rank;        // of each item in its cell
  int capacity;     // most cells a grid may have
  int padded;       // entries of `start`: one more, rounded up to whole vectors
};

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
  const int first = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  int4* const counts = reinterpret_cast<int4*>(s.start);
  for (int c = first; c < s.padded / 4; c += stride) counts[c] = make_int4(0, 0, 0, 0);

  Bounds b = empty_bounds();
#pragma unroll 4  // loads of four items in flight
  for (int i = first; i < source.count; i += stride) {
    const float3 p = source.position(i);
    const float radius = source.radius(i);
    include(b, {{p.x, p.y, p.z}, {p.x, p.y, p.z}, radius, radius});
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

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::item_threads)
    count_items(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= source.count) return;
  s.rank[i] = atomicAdd(s.start + cell_of(*s.grid, source.position(i)), 1);
}

template <class Policy, class Source>
__global__ void __launch_bounds__(Policy::item_threads)
    place_items(const __grid_constant__ Source source, const __grid_constant__ Storage s) {
  using Record = typename Source::Record;
  constexpr int words = static_cast<int>(sizeof(Record) / sizeof(float4));
  static_assert(sizeof(Record) % sizeof(float4) == 0 && Policy::item_threads % 32 == 0);
  __shared__ Record staged[Policy::item_threads];
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32;
  const int i = static_cast<int>(blockIdx.x) * Policy::item_threads + thread;
  int slot = -1;
  if (i < source.count) {
    slot = s.start[cell_of(*s.grid, source.position(i))] + __ldcs(s.rank + i);
    const Record record = source.record(i);
    staged[thread] = record;
    source.placed(*s.grid, i, slot, record);
  }
  __syncwarp();
  const float4* const from = reinterpret_cast<const float4*>(staged + (thread - lane));
#pragma unroll
  for (int k = 0; k < words; ++k) {
    const int word = k * 32 + lane;
    const int target = __shfl_sync(0xffffffffu, slot, word / words);
    if (target < 0) continue;
    float4* const to = reinterpret_cast<float4*>(source.records + target);
    to[word % words] = from[word];
  }
}

}  // namespace detail

/// Owns the grid's memory and builds it. `grid()` and `start()` are for kernels launched after build().
template <class Policy = DefaultPolicy>
class NeighbourGrid {
 public:
  void allocate(std::int64_t items) {
    const auto count = static_cast<std::size_t>(items);
    s_.capacity =
        static_cast<int>(static_cast<double>(Policy::cells_per_item) * static_cast<double>(items)) + 4096;
    s_.padded = s_.capacity / 4 * 4 + 4;
    scan_bytes_ = primitives::exclusive_sum_bytes(s_.padded);
    blocks_ = static_cast<unsigned>(std::clamp<std::int64_t>(
        (items + Policy::bounds_threads - 1) / Policy::bounds_threads, 1, Policy::bounds_blocks));
    grid_ = DeviceBuffer<Grid>(1);
    partial_ = DeviceBuffer<detail::Bounds>(blocks_);
    start_ = DeviceBuffer<int>(static_cast<std::size_t>(s_.padded));
    rank_ = DeviceBuffer<int>(count);
    scan_ = DeviceBuffer<std::byte>(scan_bytes_);
    s_.grid = grid_.get();
    s_.partial = partial_.get();
    s_.start = start_.get();
    s_.rank = rank_.get();
  }

  /// Sorts the items of `source` (at least one, at most as many as allocated for).
  template <class Source>
  void build(const Source& source) {
    const unsigned item_blocks =
        static_cast<unsigned>((source.count + Policy::item_threads - 1) / Policy::item_threads);
    detail::find_bounds<Policy><<<blocks_, Policy::bounds_threads>>>(source, s_);
    detail::count_items<Policy><<<item_blocks, Policy::item_threads>>>(source, s_);
    primitives::exclusive_sum(scan_.get(), scan_bytes_, s_.start, s_.start, s_.padded);
    detail::place_items<Policy><<<item_blocks, Policy::item_threads>>>(source, s_);
  }

  const Grid* grid() const { return s_.grid; }
  const int* start() const { return s_.start; }  ///< first slot of each cell, and the number of items

 private:
  detail::Storage s_{};
  unsigned blocks_ = 1;
  DeviceBuffer<Grid> grid_;
  DeviceBuffer<detail::Bounds> partial_;
  DeviceBuffer<int> start_, rank_;
  DeviceBuffer<std::byte> scan_;
  std::size_t scan_bytes_ = 0;
};

}  // namespace gpuphys::neighbour_grid
