// Every pair of a vertex and a primitive of a moving mesh whose boxes, swept over the step, overlap: each
// once. A primitive is a vertex, an edge or a triangle (Corners of 1, 2 or 3 vertices); the boxes of the
// vertices that ask are `margin` wider on each side. Which pairs matter is the user's to say.
//
// 1. pack: the scene's box; both positions of a vertex into one 32-byte sector (not for Corners = 1); and of
//    a sample of the primitives, the mean extents of what they sweep.
// 2. count: finds the cell (swept_boxes.cuh) of each vertex and of each primitive and its rank there. A scan
//    turns the counts into starts.
// 3. place: records of 32 bytes go to their places: of a vertex both positions and its number, of a
//    primitive its box in 20 bytes and its corners.
// 4. visit(), which a kernel of the user calls: warps take tiles of 32 vertices in the order of the cells,
// one
//    a lane. All lanes walk together through the rows of cells within reach, each reading the records of its
//    own range: neighbours read the same sectors. Whatever is larger than `large_over_extent` times the mean
//    stands behind the last cell and meets everything, shared out by chunks among all warps.
//
// Places among the records: those of the primitives first, then those of the vertices; both end with the
// large ones. For Corners = 1 there is one list only, and each pair of vertices is visited from both sides
// (and a vertex meets itself).
//
// What bounds it: random sectors in `count` and `place`, L1 and latency in the walk.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "references/blocks/swept_boxes.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::collision {

struct SweptPairsPolicy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int sort_threads = 128;
  static constexpr int sampled = 1000;
  static constexpr float cell_over_extent[3] = {0.7f, 0.7f, 0.7f};
  static constexpr float large_over_extent = 8.0f;
  static constexpr int large_chunk = 64;
#else
  static constexpr int sort_threads = 256;
  static constexpr int sampled = 65536;  // primitives, for the mean extents
  // Fine along x, where a range of cells is read; along y and z smaller cells mean more, shorter ranges.
  static constexpr float cell_over_extent[3] = {0.35f, 1.4f, 2.5f};
  static constexpr float large_over_extent = 4.0f;
  static constexpr int large_chunk = 512;  // records that a warp takes at a time
#endif
  static constexpr int sort_blocks_of_sm = 2048 / sort_threads;
};

/// A vertex at both times, and its number.
struct MovingVertex {
  float3 x0, x1;
  int number;
};

/// 32 bytes as they are stored.
struct SweptRecord {
  float4 first, second;
};

__device__ __forceinline__ SweptRecord load_record(const float4* records, int place) {
  const float4* r = records + 2 * static_cast<std::ptrdiff_t>(place);
  return {__ldg(r), __ldg(r + 1)};
}
__device__ __forceinline__ MovingVertex vertex_of(const SweptRecord& r) {
  return {{r.first.x, r.first.y, r.first.z}, {r.first.w, r.second.x, r.second.y}, __float_as_int(r.second.z)};
}
__device__ __forceinline__ SweptRecord record_of(const MovingVertex& v) {
  return {{v.x0.x, v.x0.y, v.x0.z, v.x1.x}, {v.x1.y, v.x1.z, __int_as_float(v.number), 0.0f}};
}

/// The box of a vertex, without an interval along the diagonal.
__device__ __forceinline__ SweptBox box_of(const MovingVertex& v) {
  return {{fminf(v.x0.x, v.x1.x), fminf(v.x0.y, v.x1.y), fminf(v.x0.z, v.x1.z)},
          {fmaxf(v.x0.x, v.x1.x), fmaxf(v.x0.y, v.x1.y), fmaxf(v.x0.z, v.x1.z)},
          0.0f,
          0.0f};
}
/// The box widened by `margin` on each side, with its interval along the diagonal.
__device__ __forceinline__ SweptBox wide_box_of(const Diagonal& diagonal, const MovingVertex& v,
                                                float margin) {
  SweptBox box = box_of(v);
  const auto along = [&](float3 x, auto add) {
    return add(diagonal.p == 0 ? x.x : x.y, diagonal.sign * (diagonal.q == 1 ? x.y : x.z));
  };
  const auto down = [](float a, float b) { return __fadd_rd(a, b); };
  const auto up = [](float a, float b) { return __fadd_ru(a, b); };
  const float margin_along = 1.5f * margin;  // more than the root of 2
  box.along_low = down(fminf(along(v.x0, down), along(v.x1, down)), -margin_along);
  box.along_high = up(fmaxf(along(v.x0, up), along(v.x1, up)), margin_along);
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    box.low[d] = down(box.low[d], -margin);
    box.high[d] = up(box.high[d], margin);
  }
  return box;
}

/// What passes between the kernels. `Corners` vertices make a primitive.
template <int Corners>
struct SweptScene {
  struct alignas(256) Head {
    SceneSums sums;
    int tiles_taken;
  };

  const float* __restrict__ x0;
  const float* __restrict__ x1;
  const std::int32_t* __restrict__ primitives;  // (m, Corners)
  Head* head;
  std::int32_t* starts;  // of the primitives' cells, then of the vertices'; each list ends with the large
  float4* vertices;      // (n, 2): packed, in their own order; none for Corners = 1
  int2* cell_and_rank;   // of the primitives, then of the vertices
  float4* records;       // (places, 2)
  int n, m;              // vertices, primitives
  int cell_capacity;
  float margin;

  static constexpr bool kTwoLists = Corners > 1;

  __device__ __forceinline__ float3 position(const float* __restrict__ x, int v) const {
    const float* p = x + 3 * static_cast<std::ptrdiff_t>(v);
    return {p[0], p[1], p[2]};
  }
  __device__ __forceinline__ MovingVertex vertex(int v) const {
    if constexpr (kTwoLists) return vertex_of(load_record(vertices, v));
    return {position(x0, v), position(x1, v), v};
  }
  /// Number `k` of the corners of primitive `e`.
  __device__ __forceinline__ int corner(int e, int k) const {
    if constexpr (!kTwoLists) return e;
    return primitives[Corners * static_cast<std::ptrdiff_t>(e) + k];
  }
  __device__ __forceinline__ std::int32_t* starts_of(bool of_vertices) const {
    return starts + (kTwoLists && of_vertices ? cell_capacity + 1 : 0);
  }
  /// The places of the list: its first, its first large one, its end.
  __device__ __forceinline__ int first(bool of_vertices) const { return kTwoLists && of_vertices ? m : 0; }
  __device__ __forceinline__ int first_large(bool of_vertices) const {
    return starts_of(of_vertices)[cell_capacity];
  }
  __device__ __forceinline__ int end(bool of_vertices) const {
    return kTwoLists ? (of_vertices ? m + n : m) : n;
  }
  __device__ __forceinline__ Grid grid() const {
    using P = SweptPairsPolicy;
    return make_grid(
        head->sums, min(m, P::sampled), cell_capacity,
        {{P::cell_over_extent[0], P::cell_over_extent[1], P::cell_over_extent[2]}, P::large_over_extent});
  }
  __device__ __forceinline__ SweptBox box(const Grid& grid, const SweptRecord& r) const {
    if constexpr (!kTwoLists) return box_of(vertex_of(r));
    return expand(
        grid.diagonal,
        {{r.first.x, r.first.y, r.first.z}, __float_as_uint(r.second.x), __float_as_uint(r.second.y)});
  }
};

/// The corners of a primitive from its record.
__device__ __forceinline__ int3 corners_of(const SweptRecord& r) {
  return {__float_as_int(r.first.w), __float_as_int(r.second.z), __float_as_int(r.second.w)};
}

// Packs the vertices, whose box is the scene's, and samples the extents of primitives.
template <int Corners>
__global__ void __launch_bounds__(SweptPairsPolicy::sort_threads)
    pack_swept(const __grid_constant__ SweptScene<Corners> s) {
  constexpr int warps = SweptPairsPolicy::sort_threads / 32;
  __shared__ unsigned codes[6];
  __shared__ float warp_extents[warps][kExtents];
  if (threadIdx.x < 6) codes[threadIdx.x] = 0;
  __syncthreads();
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  float extents[kExtents] = {};
  const int samples = min(s.m, SweptPairsPolicy::sampled), step = s.m / max(samples, 1);
  for (int k = thread; k < samples; k += stride) {
    // One of each `step`, not always the same one of them: primitives may come in a pattern.
    const int e =
        k * step + static_cast<int>(static_cast<unsigned>(k) * 2654435769u % static_cast<unsigned>(step));
    Points<2 * Corners> points;
#pragma unroll
    for (int c = 0; c < Corners; ++c) {
      points.set(2 * c, s.position(s.x0, s.corner(e, c)));
      points.set(2 * c + 1, s.position(s.x1, s.corner(e, c)));
    }
    add_extents(extents, points);
    extents[kLargest] += 2.0f * s.margin;
  }
#pragma unroll
  for (int k = 0; k < kExtents; ++k) {
    const float sum = warp_sum(extents[k]);
    if (threadIdx.x % 32 == 0) warp_extents[threadIdx.x / 32][k] = sum;
  }
  unsigned low[3] = {0, 0, 0}, high[3] = {0, 0, 0};
#pragma unroll 2
  for (int i = thread; i < s.n; i += stride) {
    const MovingVertex v{s.position(s.x0, i), s.position(s.x1, i), i};
    if constexpr (SweptScene<Corners>::kTwoLists) {
      const SweptRecord r = record_of(v);
      s.vertices[2 * static_cast<std::ptrdiff_t>(i)] = r.first;
      s.vertices[2 * static_cast<std::ptrdiff_t>(i) + 1] = r.second;
    }
    const SweptBox box = box_of(v);
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      low[d] = max(low[d], encode(-box.low[d]));
      high[d] = max(high[d], encode(box.high[d]));
    }
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    low[d] = warp_max(low[d]);
    high[d] = warp_max(high[d]);
    if (threadIdx.x % 32 == 0) {
      atomicMax(&codes[d], low[d]);
      atomicMax(&codes[3 + d], high[d]);
    }
  }
  __syncthreads();
  SceneSums& sums = s.head->sums;
  if (threadIdx.x < 3) atomicMax(&sums.low_code[threadIdx.x], codes[threadIdx.x]);
  if (threadIdx.x >= 3 && threadIdx.x < 6) atomicMax(&sums.high_code[threadIdx.x - 3], codes[threadIdx.x]);
  if (threadIdx.x >= 32 && threadIdx.x < 32 + kExtents) {
    const int k = static_cast<int>(threadIdx.x) - 32;
    float sum = 0.0f;
    for (int w = 0; w < warps; ++w) sum += warp_extents[w][k];
    if (sum > 0.0f) atomicAdd(&sums.extents[k], sum);
  }
}

// The record of a primitive (`e` < m), or of a vertex (`e` - m of Corners > 1).
template <int Corners>
__device__ __forceinline__ SweptRecord swept_record(const SweptScene<Corners>& s, const Diagonal& diagonal,
                                                    int e, float beyond) {
  if constexpr (Corners == 1) {
    return record_of(s.vertex(e));
  } else {
    if (e >= s.m) return load_record(s.vertices, e - s.m);
    Points<2 * Corners> points;
    int corners[3] = {};
#pragma unroll
    for (int c = 0; c < Corners; ++c) {
      corners[c] = s.corner(e, c);
      const MovingVertex v = s.vertex(corners[c]);
      points.set(2 * c, v.x0);
      points.set(2 * c + 1, v.x1);
    }
    const CompactBox box = compact_box(diagonal, points, beyond);
    return {{box.low[0], box.low[1], box.low[2], __int_as_float(corners[0])},
            {__uint_as_float(box.extents), __uint_as_float(box.along), __int_as_float(corners[1]),
             __int_as_float(corners[2])}};
  }
}

// Cells and ranks; and 1 for the `toi` of every vertex.
template <int Corners>
__global__ void __launch_bounds__(SweptPairsPolicy::sort_threads)
    count_swept(const __grid_constant__ SweptScene<Corners> s, float beyond, float* __restrict__ toi) {
  using Scene = SweptScene<Corners>;
  __shared__ Grid grid;
  __shared__ unsigned codes[3];
  if (threadIdx.x < 3) codes[threadIdx.x] = 0;
  if (threadIdx.x == 0) grid = s.grid();
  __syncthreads();
  unsigned reach[3] = {0, 0, 0};
  const int items = Scene::kTwoLists ? s.m + s.n : s.n;
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int e = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); e < items; e += stride) {
    const bool is_vertex = e >= s.m;
    const SweptRecord r = swept_record(s, grid.diagonal, e, beyond);
    const SweptBox box = is_vertex ? box_of(vertex_of(r)) : s.box(grid, r);
    const int cell = cell_of(grid, box, s.cell_capacity);
    s.cell_and_rank[e] = {cell, atomicAdd(s.starts_of(is_vertex) + cell, 1)};
    if (!Scene::kTwoLists || is_vertex) toi[Scene::kTwoLists ? e - s.m : e] = 1.0f;
    if (is_vertex || cell == s.cell_capacity) continue;
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const float half = fmaxf(box.high[d] - box.centre(d), box.centre(d) - box.low[d]);
      reach[d] = max(reach[d], encode(half));
    }
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    reach[d] = warp_max(reach[d]);
    if (threadIdx.x % 32 == 0) atomicMax(&codes[d], reach[d]);
  }
  __syncthreads();
  if (threadIdx.x < 3) atomicMax(&s.head->sums.reach_code[threadIdx.x], codes[threadIdx.x]);
}

// Records to their places, two threads a record, so that a sector is written whole.
template <int Corners>
__global__ void __launch_bounds__(SweptPairsPolicy::sort_threads)
    place_swept(const __grid_constant__ SweptScene<Corners> s, float beyond) {
  using Scene = SweptScene<Corners>;
  __shared__ Diagonal diagonal;
  if (threadIdx.x == 0) diagonal = thinnest_diagonal(s.head->sums);
  __syncthreads();
  const int items = Scene::kTwoLists ? s.m + s.n : s.n;
  const int first = static_cast<int>(blockIdx.x * blockDim.x), tid = static_cast<int>(threadIdx.x);
  const int e = first + tid;
  // A warp makes 32 records, then writes them in two goes of 16.
  SweptRecord r{};
  int place = 0;
  if (e < items) {
    const int2 at = s.cell_and_rank[e];
    place = s.starts_of(e >= s.m)[at.x] + at.y;
    r = swept_record(s, diagonal, e, beyond);
  }
  const int lane = tid % 32, half = lane % 2;
#pragma unroll
  for (int go = 0; go < 2; ++go) {
    const int from = 16 * go + lane / 2;
    SweptRecord other;
    const auto take = [&](float x) { return __shfl_sync(0xffffffffu, x, from); };
    other.first = {take(r.first.x), take(r.first.y), take(r.first.z), take(r.first.w)};
    other.second = {take(r.second.x), take(r.second.y), take(r.second.z), take(r.second.w)};
    const int to = __shfl_sync(0xffffffffu, place, from);
    if (first + tid - lane + from < items)
      s.records[2 * static_cast<std::ptrdiff_t>(to) + half] = half ? other.second : other.first;
  }
}

__device__ __forceinline__ bool overlap_swept(const SweptBox& p, const SweptBox& q, bool along) {
  return (p.low[0] <= q.high[0]) & (q.low[0] <= p.high[0]) & (p.low[1] <= q.high[1]) &
         (q.low[1] <= p.high[1]) & (p.low[2] <= q.high[2]) & (q.low[2] <= p.high[2]) &
         (!along | ((p.along_low <= q.along_high) & (q.along_low <= p.along_high)));
}

/// Calls meet(hit, MovingVertex, SweptRecord) for every vertex and every record of a primitive near it, in
/// all lanes of the warp together; `hit` says whether the lane has a pair, whose boxes then overlap. All
/// warps of the grid call it; `warp` counts them.
template <int Corners, class Meet>
__device__ __forceinline__ void visit_swept_pairs(const SweptScene<Corners>& s, const Grid& grid, int warp,
                                                  int warps, Meet&& meet) {
  using P = SweptPairsPolicy;
  constexpr unsigned all = 0xffffffffu;
  constexpr bool along = Corners > 1;
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const int own_first = s.first(true), own_large = s.first_large(true), own_end = s.end(true);
  const int other_large = s.first_large(false), other_end = s.end(false);
  const std::int32_t* const starts = s.starts_of(false);

  // Tiles of small vertices against small primitives. The next tile's number is on its way.
  const int tiles = (own_large - own_first + 31) / 32;
  int next = 0;
  if (lane == 0) next = atomicAdd(&s.head->tiles_taken, 1);
  for (;;) {
    const int tile = __shfl_sync(all, next, 0);
    if (tile >= tiles) break;
    if (lane == 0) next = atomicAdd(&s.head->tiles_taken, 1);
    const int i = own_first + 32 * tile + lane;
    const bool there = i < own_large;
    const MovingVertex own = vertex_of(load_record(s.records, there ? i : own_first));
    const SweptBox box = wide_box_of(grid.diagonal, own, s.margin);
    const int low_x = grid.coordinate(box.low[0] - grid.reach[0], 0);
    const int high_x = grid.coordinate(box.high[0] + grid.reach[0], 0);
    const int low_y = grid.coordinate(box.low[1] - grid.reach[1], 1);
    const int rows_y = grid.coordinate(box.high[1] + grid.reach[1], 1) - low_y + 1;
    const int low_z = grid.coordinate(box.low[2] - grid.reach[2], 2);
    const int rows_z = grid.coordinate(box.high[2] + grid.reach[2], 2) - low_z + 1;
    const int rows = there ? rows_y * rows_z : 0;
    int y = 0, z = 0;
    for (int k = 0; __any_sync(all, k < rows); ++k) {
      int begin = 0, end = 0;
      if (k < rows) {
        const int cells = grid.row(low_y + y, low_z + z);
        begin = starts[cells + low_x];
        end = starts[cells + high_x + 1];
        if (++y == rows_y) {
          y = 0;
          ++z;
        }
      }
      SweptRecord ahead{};
      if (begin < end) ahead = load_record(s.records, begin);
      while (__any_sync(all, begin < end)) {
        const SweptRecord other = ahead;
        const bool mine = begin < end;
        ++begin;
        if (begin < end) ahead = load_record(s.records, begin);
        meet(mine && overlap_swept(box, s.box(grid, other), along), own, other);
      }
    }
  }

  // Large primitives against all vertices: a tile of vertices and a chunk of primitives at a time.
  const auto share = [&](int own_items, int others, auto&& body) {
    const int chunks = (others + P::large_chunk - 1) / P::large_chunk;
    const long long items = static_cast<long long>(own_items) * chunks;
    for (long long item = warp; item < items; item += warps)
      body(static_cast<int>(item / chunks), static_cast<int>(item % chunks) * P::large_chunk);
  };
  share((own_end - own_first + 31) / 32, other_end - other_large, [&](int tile, int begin) {
    const int i = own_first + 32 * tile + lane;
    const bool there = i < own_end;
    const MovingVertex own = vertex_of(load_record(s.records, there ? i : own_first));
    const SweptBox box = wide_box_of(grid.diagonal, own, s.margin);
    const int end = min(other_large + begin + P::large_chunk, other_end);
    for (int j = other_large + begin; j < end; ++j) {
      const SweptRecord other = load_record(s.records, j);
      meet(there && overlap_swept(box, s.box(grid, other), along), own, other);
    }
  });
  // Large vertices against small primitives: one vertex and a chunk of primitives, one a lane.
  const int other_first = s.first(false);
  share(own_end - own_large, other_large - other_first, [&](int large, int begin) {
    const MovingVertex own = vertex_of(load_record(s.records, own_large + large));
    const SweptBox box = wide_box_of(grid.diagonal, own, s.margin);
    const int end = min(other_first + begin + P::large_chunk, other_large);
    for (int base = other_first + begin; base < end; base += 32) {
      const bool there = base + lane < end;
      const SweptRecord other = load_record(s.records, there ? base + lane : base);
      meet(there && overlap_swept(box, s.box(grid, other), along), own, other);
    }
  });
}

/// Pairs that wait in shared memory until there are 32 of them: a long instruction stream then runs with full
/// warps although few candidates get that far. One for each warp.
class PairQueue {
 public:
  static constexpr int kRoom = 64;

  __device__ __forceinline__ PairQueue(int4* room, int lane) : room_(room), lane_(lane) {}

  /// All lanes call it; those with `hit` bring a pair. Calls resolve(mine, pair) once 32 are there.
  template <class Resolve>
  __device__ __forceinline__ void add(bool hit, int4 pair, Resolve&& resolve) {
    const unsigned hits = __ballot_sync(0xffffffffu, hit);
    if (hits == 0) return;
    if (hit) room_[pairs_ + __popc(hits & ((1u << lane_) - 1u))] = pair;
    __syncwarp();
    pairs_ += __popc(hits);
    if (pairs_ >= 32) {
      pairs_ -= 32;
      resolve(true, room_[pairs_ + lane_]);
      __syncwarp();
    }
  }
  /// What is left at the end.
  template <class Resolve>
  __device__ __forceinline__ void finish(Resolve&& resolve) {
    if (pairs_ > 0) resolve(lane_ < pairs_, room_[lane_ < pairs_ ? lane_ : 0]);
  }

 private:
  int4* room_;
  int lane_;
  int pairs_ = 0;
};

/// Times of impact that are not negative are ordered as their bits are.
__device__ __forceinline__ void record_time(float* toi, int vertex, float t) {
  atomicMin(reinterpret_cast<int*>(toi + vertex), __float_as_int(t));
}

/// Memory and kernels of a search among up to `n` vertices and `m` primitives.
template <int Corners>
class SweptPairs {
 public:
  using Scene = SweptScene<Corners>;
  static constexpr bool kTwoLists = Scene::kTwoLists;

  SweptPairs() = default;
  SweptPairs(std::int64_t n, std::int64_t m) : n_(n), m_(kTwoLists ? m : n) {
    if (n_ > (std::int64_t{1} << 28) || m_ > (std::int64_t{1} << 28))
      throw std::runtime_error("more than 2^28 vertices or primitives: places are 32-bit numbers");
    places_ = kTwoLists ? n_ + m_ : n_;
    cells_ = (kTwoLists ? m_ / 2 : n_) + kLeastCells;
    const std::int64_t counters = (kTwoLists ? 2 : 1) * (cells_ + 1);
    counters_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(kHeadWords + counters));
    vertices_ = DeviceBuffer<float4>(kTwoLists ? 2 * static_cast<std::size_t>(n_) : 0);
    cell_and_rank_ = DeviceBuffer<int2>(static_cast<std::size_t>(places_));
    records_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(places_));
    scan_bytes_ = primitives::exclusive_sum_bytes(counters);
    scan_ = DeviceBuffer<unsigned char>(scan_bytes_);
    multiprocessors_ = static_cast<unsigned>(multiprocessors());
  }

  /// Sorts. `toi` (n) becomes 1. Boxes of primitives are wider by `beyond` times their largest extent (0 or a
  /// power of two up to 2^-16).
  Scene build(const float* x0, const float* x1, const std::int32_t* primitives, float margin, float beyond,
              float* toi) const {
    using P = SweptPairsPolicy;
    const std::int64_t counters = (kTwoLists ? 2 : 1) * (cells_ + 1);
    const Scene s{x0,
                  x1,
                  primitives,
                  reinterpret_cast<typename Scene::Head*>(counters_.get()),
                  counters_.get() + kHeadWords,
                  vertices_.get(),
                  cell_and_rank_.get(),
                  records_.get(),
                  static_cast<int>(n_),
                  static_cast<int>(m_),
                  static_cast<int>(cells_),
                  margin};
    GPUPHYS_CUDA(cudaMemsetAsync(counters_.get(), 0,
                                 sizeof(std::int32_t) * static_cast<std::size_t>(kHeadWords + counters)));
    const unsigned wave = multiprocessors_ * P::sort_blocks_of_sm;
    const auto blocks = [](std::int64_t items) {
      return static_cast<unsigned>((items + P::sort_threads - 1) / P::sort_threads);
    };
    pack_swept<Corners><<<std::min(blocks(std::max(n_, m_)), wave), P::sort_threads>>>(s);
    count_swept<Corners><<<std::min(blocks(places_), wave), P::sort_threads>>>(s, beyond, toi);
    primitives::exclusive_sum(scan_.get(), scan_bytes_, s.starts, s.starts, counters);
    place_swept<Corners><<<blocks(places_), P::sort_threads>>>(s, beyond);
    return s;
  }

  /// Blocks of `warps` warps for the kernel that visits the pairs, `resident_warps` of them on a
  /// multiprocessor.
  unsigned visit_blocks(int warps, int resident_warps) const {
    const std::int64_t wanted = (n_ + 32 * warps - 1) / (32 * warps);
    const std::int64_t resident = static_cast<std::int64_t>(multiprocessors_) * (resident_warps / warps);
    // Large primitives are shared out among warps, so a few vertices keep more of them busy than their tiles.
    return static_cast<unsigned>(std::min(std::max<std::int64_t>(wanted, 16), resident));
  }

 private:
  static constexpr std::int64_t kHeadWords = sizeof(typename Scene::Head) / sizeof(std::int32_t);

  std::int64_t n_ = 0, m_ = 0, places_ = 0, cells_ = 0;
  unsigned multiprocessors_ = 0;
  std::size_t scan_bytes_ = 0;
  DeviceBuffer<std::int32_t> counters_;
  DeviceBuffer<int2> cell_and_rank_;
  DeviceBuffer<float4> vertices_, records_;
  DeviceBuffer<unsigned char> scan_;
};

}  // namespace gpuphys::collision
