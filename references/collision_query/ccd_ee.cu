// ccd_ee in FP32: the time of the first impact of every edge with another one.
//
// 1. pack: both positions of a vertex in one 32-byte sector, written by two threads; the scene's box; and of
//    a sample of the edges, the mean extents of what they sweep, along the axes and along six diagonals. With
//    them the grid is known before any pass over edges, and the diagonal along which boxes are thinnest.
// 2. count: one thread an edge; fetches the ends once, keeps the box (corner, extents and the interval along
//    that diagonal: 20 bytes) in the order of the edges, finds its cell and its rank there.
//    A scan turns the counts into the cells' starts.
// 3. place: two threads an edge; box, vertices and number of the edge go to its place as one whole sector.
// 4. impacts: resident warps take tiles of 32 places in a row, one edge a lane, until none is left. A warp
//    walks the cells within reach of its tile and reads 32 candidates at a time, one a lane, the next ones
//    while it works on these. Those that overlap the box around the tile go to shared memory, rounded to the
//    scale of that box: four lower ends in one word, four upper ones in another. 32 of them are compared with
//    the boxes of all lanes without a vote or a branch, at two subtractions and one test a box; the hits of a
//    lane are the bits of a mask. Pairs are met once, from the lower place. Those that overlap and share no
//    vertex go to a queue of the warp, from which 32 at a time are bisected. It outlives the tile, so the
//    long instruction stream runs with full warps although few candidates get that far.
//
// What bounds it: instructions of `impacts`, and random sectors from L2 in `count` and `place`. Of the
// paper's public input 9.1 M pairs of boxes overlap, 6.1 M of them of edges with a vertex in common. The
// diagonal leaves 0.6 M of the other 3.0 M, the coarse scale of the tile makes that 0.7 M; 0.39 M have an
// event (counted on the host). docs/lab/collision_query.md has the predictions stage by stage and
// what was measured.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "cases/collision_query/ccd_ee.hpp"
#include "references/blocks/swept_boxes.cuh"
#include "references/collision_query/cubic_toi.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::ccd_ee {
namespace {

using collision::CompactBox;
using collision::Cubic;
using collision::Diagonal;
using collision::Grid;
using collision::Moving;
using collision::SceneSums;
using collision::SweptBox;

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int edge_threads = 128;  // one thread an edge
  static constexpr int warps = 2;           // of a block of `impacts`
  static constexpr float cell_over_extent[3] = {0.7f, 0.7f, 0.7f};
  static constexpr int sampled_edges = 1000;
  static constexpr float large_over_extent = 8.0f;
#else
  static constexpr int edge_threads = 256;
  static constexpr int warps = 4;
  // Fine along x, where a warp reads a range of cells; along y and z smaller cells mean more, shorter ranges.
  static constexpr float cell_over_extent[3] = {0.35f, 1.4f, 2.5f};
  static constexpr int sampled_edges = 65536;  // for the mean extents
  static constexpr float large_over_extent = 4.0f;
#endif
  static constexpr int edge_blocks_of_sm = 2048 / edge_threads;
  static constexpr int large_chunk = 1024;   // candidates of a large box that a warp takes at a time
  static constexpr int resident_warps = 24;  // of `impacts` on an SM: 80 registers a thread
  static constexpr int impact_threads = 32 * warps;
};

constexpr unsigned kAllLanes = 0xffffffffu;

struct Mesh {
  const float* __restrict__ x0;
  const float* __restrict__ x1;
  const int2* __restrict__ edges;
  int n, m;  // vertices, edges
};

// The ends of an edge at both times.
struct EdgeMotion {
  float3 a0, b0, a1, b1;
};

__device__ __forceinline__ float3 position(const float* __restrict__ x, int v) {
  const float* p = x + 3 * static_cast<std::ptrdiff_t>(v);
  return {p[0], p[1], p[2]};
}

__device__ __forceinline__ EdgeMotion motion_of(const Mesh& mesh, int2 ends) {
  return {position(mesh.x0, ends.x), position(mesh.x0, ends.y), position(mesh.x1, ends.x),
          position(mesh.x1, ends.y)};
}

__device__ __forceinline__ collision::Points<4> points_of(const EdgeMotion& e) {
  return {
      {e.a0.x, e.b0.x, e.a1.x, e.b1.x}, {e.a0.y, e.b0.y, e.a1.y, e.b1.y}, {e.a0.z, e.b0.z, e.a1.z, e.b1.z}};
}
__device__ __forceinline__ CompactBox box_of(const Diagonal& diagonal, const EdgeMotion& e) {
  return collision::compact_box(diagonal, points_of(e));
}

// Sums and the number of tiles taken stand before the counts, so that one memset clears all. The alignment
// keeps that of the counts.
struct alignas(256) Head {
  SceneSums sums;
  int tiles_taken;
};

// What passes between the kernels.
struct Scratch {
  Head* head;
  std::int32_t* starts;  // per cell: the count, after the scan the first place; one more for the large
  float4* vertices;      // per vertex: two, its positions at both times; one 32-byte sector
  float4* box_of_edge;   // [2][m] halves of records, in the order of the edges
  int2* cell_and_rank;   // per edge
  float4* __restrict__ records;  // per place: two. One sector: box, vertices and number of the edge
  int cell_capacity;
  int m;  // edges
};

// The same from the packed vertices: a sector each.
__device__ __forceinline__ EdgeMotion motion_of(const Scratch& s, int2 ends) {
  const float4* a = s.vertices + 2 * static_cast<std::ptrdiff_t>(ends.x);
  const float4* b = s.vertices + 2 * static_cast<std::ptrdiff_t>(ends.y);
  const float4 p = __ldg(a), q = __ldg(a + 1), r = __ldg(b), t = __ldg(b + 1);
  return {{p.x, p.y, p.z}, {r.x, r.y, r.z}, {p.w, q.x, q.y}, {r.w, t.x, t.y}};
}

__device__ __forceinline__ int samples_of(int edges) {
  return min(edges, Policy::sampled_edges);
}

__device__ __forceinline__ collision::GridShape grid_shape() {
  return {{Policy::cell_over_extent[0], Policy::cell_over_extent[1], Policy::cell_over_extent[2]},
          Policy::large_over_extent};
}

// Packs the vertices, two threads a vertex, whose box is the scene's; and samples the extents of edges.
__global__ void __launch_bounds__(Policy::edge_threads, Policy::edge_blocks_of_sm)
    pack(Mesh mesh, Scratch s) {
  constexpr int warps = Policy::edge_threads / 32;
  __shared__ unsigned codes[6];
  __shared__ float warp_extents[warps][collision::kExtents];
  if (threadIdx.x < 6) codes[threadIdx.x] = 0;
  __syncthreads();
  unsigned low[3] = {0, 0, 0}, high[3] = {0, 0, 0};
  const auto extend = [&](int d, float x) {
    low[d] = max(low[d], collision::encode(-x));
    high[d] = max(high[d], collision::encode(x));
  };
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  float extents[collision::kExtents] = {};
  const int samples = samples_of(mesh.m), step = mesh.m / max(samples, 1);
  for (int k = thread; k < samples; k += stride) {
    // One edge of each `step`, not always the same one of them: edges may come in a pattern.
    const int e =
        k * step + static_cast<int>(static_cast<unsigned>(k) * 2654435769u % static_cast<unsigned>(step));
    collision::add_extents(extents, points_of(motion_of(mesh, mesh.edges[e])));
  }
#pragma unroll
  for (int k = 0; k < collision::kExtents; ++k) {
    const float sum = collision::warp_sum(extents[k]);
    if (threadIdx.x % 32 == 0) warp_extents[threadIdx.x / 32][k] = sum;
  }
  for (std::int64_t t = thread; t < 2 * static_cast<std::int64_t>(mesh.n); t += stride) {
    const float* p0 = mesh.x0 + 3 * (t / 2);
    const float* p1 = mesh.x1 + 3 * (t / 2);
    float4 half;
    if (t % 2 == 0) {
      half = {p0[0], p0[1], p0[2], p1[0]};
      extend(0, half.x);
      extend(1, half.y);
      extend(2, half.z);
      extend(0, half.w);
    } else {
      half = {p1[1], p1[2], 0.0f, 0.0f};
      extend(1, half.x);
      extend(2, half.y);
    }
    s.vertices[t] = half;
  }
  for (int d = 0; d < 3; ++d) {
    low[d] = collision::warp_max(low[d]);
    high[d] = collision::warp_max(high[d]);
  }
  if (threadIdx.x % 32 == 0) {
    for (int d = 0; d < 3; ++d) {
      atomicMax(&codes[d], low[d]);
      atomicMax(&codes[3 + d], high[d]);
    }
  }
  __syncthreads();
  SceneSums& sums = s.head->sums;
  if (threadIdx.x < 3) atomicMax(&sums.low_code[threadIdx.x], codes[threadIdx.x]);
  if (threadIdx.x >= 3 && threadIdx.x < 6) atomicMax(&sums.high_code[threadIdx.x - 3], codes[threadIdx.x]);
  if (threadIdx.x >= 32 && threadIdx.x < 32 + collision::kExtents) {
    const int k = static_cast<int>(threadIdx.x) - 32;
    float sum = 0.0f;
    for (int w = 0; w < warps; ++w) sum += warp_extents[w][k];
    if (sum > 0.0f) atomicAdd(&sums.extents[k], sum);
  }
}

// Boxes in the order of the edges, each one's cell and its rank there.
__global__ void __launch_bounds__(Policy::edge_threads, Policy::edge_blocks_of_sm)
    count(Mesh mesh, Scratch s, float* toi) {
  __shared__ Grid grid;
  __shared__ unsigned codes[3];
  if (threadIdx.x < 3) codes[threadIdx.x] = 0;
  if (threadIdx.x == 0)
    grid = collision::make_grid(s.head->sums, samples_of(mesh.m), s.cell_capacity, grid_shape());
  __syncthreads();
  unsigned reach[3] = {0, 0, 0};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int e = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); e < mesh.m; e += stride) {
    const int2 ends = mesh.edges[e];
    const CompactBox kept = box_of(grid.diagonal, motion_of(s, ends));
    const SweptBox box = collision::expand(grid.diagonal, kept);
    const int cell = collision::cell_of(grid, box, s.cell_capacity);
    s.cell_and_rank[e] = {cell, atomicAdd(&s.starts[cell], 1)};
    s.box_of_edge[e] = {kept.low[0], kept.low[1], kept.low[2], __int_as_float(ends.x)};
    s.box_of_edge[static_cast<std::ptrdiff_t>(s.m) + e] = {__uint_as_float(kept.extents),
                                                           __uint_as_float(kept.along),
                                                           __int_as_float(ends.y), __int_as_float(e)};
    toi[e] = 1.0f;
    if (cell == s.cell_capacity) continue;
    for (int d = 0; d < 3; ++d) {
      const float half = fmaxf(box.high[d] - box.centre(d), box.centre(d) - box.low[d]);
      reach[d] = max(reach[d], collision::encode(half));
    }
  }
  for (int d = 0; d < 3; ++d) {
    reach[d] = collision::warp_max(reach[d]);
    if (threadIdx.x % 32 == 0) atomicMax(&codes[d], reach[d]);
  }
  __syncthreads();
  if (threadIdx.x < 3) atomicMax(&s.head->sums.reach_code[threadIdx.x], codes[threadIdx.x]);
}

// Two threads an edge, which write its record to its place as one whole sector.
__global__ void __launch_bounds__(Policy::edge_threads) place(Scratch s) {
  const std::int64_t t = static_cast<std::int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  const int e = static_cast<int>(t / 2), half = static_cast<int>(t % 2);
  if (e >= s.m) return;
  const int2 at = s.cell_and_rank[e];
  const float4 part = s.box_of_edge[half * static_cast<std::ptrdiff_t>(s.m) + e];
  const int place = s.starts[at.x] + at.y;
  s.records[2 * static_cast<std::ptrdiff_t>(place) + half] = part;
}

// A pair's relative motion: u and v along the edges, w between their first ends.
struct PairMotion {
  Moving u, v, w;
};

__device__ __forceinline__ PairMotion relative(const EdgeMotion& p, const EdgeMotion& q) {
  return {collision::relative(p.a0, p.b0, p.a1, p.b1), collision::relative(q.a0, q.b0, q.a1, q.b1),
          collision::relative(p.a0, q.a0, p.a1, q.a1)};
}

// Whether the point where the lines of two coplanar edges cross lies on both of them. `u_over_w` and
// `v_over_w`: a metre in the units of u and v over one in those of w.
__device__ __forceinline__ bool meet(float3 u, float3 v, float3 w, float u_over_w, float v_over_w) {
  const collision::Fractions at = collision::fractions(w, u, v);
  const float s = u_over_w * at.s, r = v_over_w * -at.r;  // w = s u - r v
  return !at.parallel && s >= 0.0f && s <= at.nn && r >= 0.0f && r <= at.nn;
}

// What a warp keeps in shared memory: candidates, of which up to 31 wait, and the pairs to resolve.
struct Queues {
  int4 boxes[64];  // packed, with the vertices
  int2 names[64];  // place, number of the edge
  int4 vertices[64];
  int2 edges[64];
};

// Floats that are not negative are ordered as their bits are.
__device__ __forceinline__ void record(float* toi, int edge, float t) {
  atomicMin(reinterpret_cast<int*>(toi + edge), __float_as_int(t));
}

// Times of the pairs of a warp; lanes without one have `mine` unset.
__device__ __noinline__ void resolve(const Scratch& s, float* toi, bool mine, int4 vertices, int2 edges) {
  if (mine) {
    // The edge of the lower number comes first, whatever the order in a cell: rounding does not depend on it.
    const int e = edges.x, f = edges.y;
    const bool swap = f < e;
    const EdgeMotion p = motion_of(s, swap ? int2{vertices.z, vertices.w} : int2{vertices.x, vertices.y});
    const EdgeMotion q = motion_of(s, swap ? int2{vertices.x, vertices.y} : int2{vertices.z, vertices.w});
    PairMotion r = relative(p, q);
    const float u_unit = collision::normalise(r.u), v_unit = collision::normalise(r.v);
    const float w_unit = collision::normalise(r.w), u_over_w = u_unit / w_unit, v_over_w = v_unit / w_unit;
    const Cubic volume = collision::triple_product(r.w, r.u, r.v);
    const float t = collision::first_crossing(
        volume, [&](float at) { return meet(r.u.at(at), r.v.at(at), r.w.at(at), u_over_w, v_over_w); });
    if (t < 1.0f) {
      record(toi, e, t);
      record(toi, f, t);
    }
  }
  __syncwarp();
}

class Narrow {
 public:
  __device__ __forceinline__ Narrow(const Scratch& s, float* toi, Queues& queues, int lane)
      : s_(s), toi_(toi), queues_(queues), lane_(lane) {}

  // All lanes call it; those with `hit` bring a pair: two vertices of each edge, and the edges' numbers.
  __device__ __forceinline__ void add(bool hit, int4 vertices, int2 edges) {
    const unsigned hits = __ballot_sync(kAllLanes, hit);
    if (hits == 0) return;
    if (hit) {
      const int at = pairs_ + __popc(hits & ((1u << lane_) - 1u));
      queues_.vertices[at] = vertices;
      queues_.edges[at] = edges;
    }
    __syncwarp();
    pairs_ += __popc(hits);
    if (pairs_ >= 32) {
      pairs_ -= 32;
      resolve(s_, toi_, true, queues_.vertices[pairs_ + lane_], queues_.edges[pairs_ + lane_]);
    }
  }

  // What is left at the end: fewer than 32 pairs.
  __device__ __forceinline__ void finish() {
    if (pairs_ > 0) {
      const int at = lane_ < pairs_ ? lane_ : 0;
      resolve(s_, toi_, lane_ < pairs_, queues_.vertices[at], queues_.edges[at]);
    }
  }

 private:
  const Scratch& s_;
  float* toi_;
  Queues& queues_;
  int lane_;
  int pairs_ = 0;
};

// A box with the two vertices of its edge and its number.
struct Entry {
  float4 low, high;
  float2 along;
  int edge;

  __device__ __forceinline__ int a() const { return __float_as_int(low.w); }
  __device__ __forceinline__ int b() const { return __float_as_int(high.w); }
  __device__ __forceinline__ SweptBox box() const {
    return {{low.x, low.y, low.z}, {high.x, high.y, high.z}, along.x, along.y};
  }
};

struct Record {
  float4 low, rest;
};

__device__ __forceinline__ Record load_record(const Scratch& s, int place) {
  const float4* record = s.records + 2 * static_cast<std::ptrdiff_t>(place);
  return {__ldg(record), __ldg(record + 1)};
}

__device__ __forceinline__ Entry entry_of(const Record& r, const Diagonal& diagonal) {
  const SweptBox box = collision::expand(
      diagonal, {{r.low.x, r.low.y, r.low.z}, __float_as_uint(r.rest.x), __float_as_uint(r.rest.y)});
  return {r.low,
          {box.high[0], box.high[1], box.high[2], r.rest.z},
          {box.along_low, box.along_high},
          __float_as_int(r.rest.w)};
}

// No short cuts, here and below: comparisons cost less than a branch.
__device__ __forceinline__ bool overlap(const Entry& p, const Entry& q) {
  return (p.low.x <= q.high.x) & (q.low.x <= p.high.x) & (p.low.y <= q.high.y) & (q.low.y <= p.high.y) &
         (p.low.z <= q.high.z) & (q.low.z <= p.high.z) & (p.along.x <= q.along.y) & (q.along.x <= p.along.y);
}

__device__ __forceinline__ bool share_no_vertex(int a, int b, int c, int d) {
  return (a != c) & (a != d) & (b != c) & (b != d);
}

// Boxes on a coarse scale: that of the box around those of a tile, which ends where the scale does; what is
// beyond counts as at its end. A word has the lower ends along x, y, z and the diagonal, in 7, 7, 6 and 8
// bits, another the upper ones; above each is a guard bit. Lower and upper ends go through the same monotone
// function, so boxes that overlap do so on this scale too, whatever the rounding.
class Scale {
 public:
  // From the box around a tile.
  __device__ __forceinline__ explicit Scale(const Entry& all)
      : x_(all.low.x, all.high.x),
        y_(all.low.y, all.high.y),
        z_(all.low.z, all.high.z),
        along_(all.along.x, all.along.y) {}

  // The box with the vertices of its edge. Guard bits of the upper ends are set.
  __device__ __forceinline__ int4 pack(const Entry& e) const {
    const unsigned low = word(e.low.x, e.low.y, e.low.z, e.along.x);
    const unsigned high = word(e.high.x, e.high.y, e.high.z, e.along.y) + kGuards;
    return {static_cast<int>(low), static_cast<int>(high), e.a(), e.b()};
  }

  // A guard bit of the difference stays set where no lower end is above the upper one.
  __device__ __forceinline__ static bool overlap(int4 p, int4 q) {
    const auto difference = [](int high, int low) {
      return static_cast<unsigned>(high) - static_cast<unsigned>(low);
    };
    return (difference(p.y, q.x) & difference(q.y, p.x) & kGuards) == kGuards;
  }

 private:
  struct Axis {
    float factor, offset;

    __device__ __forceinline__ Axis(float low, float high) {
      factor = __fdividef(1.0f, fmaxf(high - low, 1e-30f));
      offset = -low * factor;
    }
    // 0 to 2^bits - 1, in the lower bits of a number above 2^23.
    __device__ __forceinline__ unsigned at(float x, int bits) const {
      const float top = static_cast<float>((1 << bits) - 1);
      return __float_as_uint(__saturatef(x * factor + offset) * top + 0x1p23f);
    }
  };

  __device__ __forceinline__ unsigned word(float x, float y, float z, float along) const {
    constexpr unsigned above = 0x4b000000u;  // the bits of 2^23
    return x_.at(x, 7) + (y_.at(y, 7) << 8) + (z_.at(z, 6) << 16) + (along_.at(along, 8) << 23) -
           (above + (above << 8) + (above << 16) + (above << 23));
  }

  static constexpr unsigned kGuards = 1u << 7 | 1u << 15 | 1u << 22 | 1u << 31;
  Axis x_, y_, z_, along_;
};

// `size` (at most 32) candidates from `first` on against the boxes of all lanes, which have the places i.
// Which of them each lane hits is kept in a mask, so that the comparisons run without a vote or a branch.
__device__ __forceinline__ void compare(const Queues& q, int first, int size, int4 mine, bool walks, int i,
                                        int edge, Narrow& narrow) {
  constexpr int unrolled = 8;
  unsigned hits = 0;
#pragma unroll 1
  for (int base = 0; base < size; base += unrolled) {
    unsigned some = 0;
#pragma unroll
    for (int k = 0; k < unrolled; ++k) {
      const int4 other = q.boxes[first + base + k];
      if (Scale::overlap(mine, other) & share_no_vertex(mine.z, mine.w, other.z, other.w)) some |= 1u << k;
    }
    hits |= some << base;
  }
  if (size < 32) hits &= (1u << size) - 1u;
  // Pairs are met once, from the lower place. Candidates stand in the order of their places; only the first
  // ones may come from the warp's own.
  if (__any_sync(kAllLanes, walks && q.names[first].x <= i)) {
    int lower = 0;
#pragma unroll
    for (int step = 16; step > 0; step /= 2) {
      const int at = lower + step - 1;
      if (at < size && q.names[first + at].x <= i) lower += step;
    }
    if (lower < size && q.names[first + lower].x <= i) ++lower;
    hits = lower < 32 ? hits & (0xffffffffu << lower) : 0;
  }
  if (!walks) hits = 0;
#pragma unroll 1
  while (__any_sync(kAllLanes, hits != 0)) {
    const int at = first + max(__ffs(static_cast<int>(hits)) - 1, 0);
    narrow.add(hits != 0, {mine.z, mine.w, q.boxes[at].z, q.boxes[at].w}, {edge, q.names[at].y});
    hits &= hits - 1u;
  }
  __syncwarp();
}

// The largest number among the lanes.
__device__ __forceinline__ float largest(float x) {
  return collision::decode(collision::warp_max(collision::encode(x)));
}

// The pairs of a tile, the 32 places from `first` on, those before `end`.
__device__ __forceinline__ void visit_neighbours(const Grid& grid, const Scratch& s, Queues& q,
                                                 Narrow& narrow, int first, int end, int lane) {
  const int i = first + lane;
  Entry mine{};
  int own_row = -1, own_z = 0;  // of cells
  if (i < end) {
    mine = entry_of(load_record(s, i), grid.diagonal);
    const SweptBox box = mine.box();
    own_z = grid.coordinate(box.centre(2), 2);
    own_row = own_z * grid.n[1] + grid.coordinate(box.centre(1), 1);
  }
  // Lanes whose boxes lie in the same row of cells walk together. Every vote and shuffle here is by all
  // lanes, also by those without a place.
  for (unsigned todo = __ballot_sync(kAllLanes, own_row >= 0); todo != 0;) {
    const int leader = __ffs(static_cast<int>(todo)) - 1;
    const int row = __shfl_sync(kAllLanes, own_row, leader);
    const bool walks = own_row == row;
    todo &= ~__ballot_sync(kAllLanes, walks);
    // All rows before their own hold lower places only.
    const int after = first + leader + 1;
    const int first_z = __shfl_sync(kAllLanes, own_z, leader), first_y = row - first_z * grid.n[1];
    constexpr float least = -3.402823466e38f;
    Entry all{};  // the box around theirs
    all.low.x = -largest(walks ? -mine.low.x : least);
    all.low.y = -largest(walks ? -mine.low.y : least);
    all.low.z = -largest(walks ? -mine.low.z : least);
    all.high.x = largest(walks ? mine.high.x : least);
    all.high.y = largest(walks ? mine.high.y : least);
    all.high.z = largest(walks ? mine.high.z : least);
    all.along.x = -largest(walks ? -mine.along.x : least);
    all.along.y = largest(walks ? mine.along.y : least);
    const Scale scale(all);
    const int4 packed = scale.pack(mine);
    const int low_x = grid.coordinate(all.low.x - grid.reach[0], 0);
    const int high_x = grid.coordinate(all.high.x + grid.reach[0], 0);
    const int low_y = grid.coordinate(all.low.y - grid.reach[1], 1);
    const int high_y = grid.coordinate(all.high.y + grid.reach[1], 1);
    const int high_z = grid.coordinate(all.high.z + grid.reach[2], 2);
    // The rows of cells from their own on, 32 at a time: each lane looks up one.
    const int rows_y = high_y - low_y + 1, rows = (high_z - first_z + 1) * rows_y;
    int next_row = first_y - low_y, begin = 0, stop = 0;
    unsigned filled = 0;  // lanes whose row is yet to come
    // The batch to come: 32 places from `base` on, those before `row_stop`.
    int base = 0, row_stop = 0;
    bool more = false;
    const auto next_batch = [&] {
      base += 32;
      if (base >= row_stop) {
        while (filled == 0 && next_row < rows) {
          begin = stop = 0;
          const int k = next_row + lane;
          if (k < rows) {
            const int cells = grid.row(low_y + k % rows_y, first_z + k / rows_y);
            begin = max(s.starts[cells + low_x], after);
            stop = s.starts[cells + high_x + 1];
          }
          filled = __ballot_sync(kAllLanes, begin < stop);
          next_row += 32;
        }
        more = filled != 0;
        if (!more) return;
        const int from = __ffs(static_cast<int>(filled)) - 1;
        base = __shfl_sync(kAllLanes, begin, from);
        row_stop = __shfl_sync(kAllLanes, stop, from);
        filled &= filled - 1u;
      }
    };
    Record ahead{};
    const auto load_ahead = [&] {
      if (more && base + lane < row_stop) ahead = load_record(s, base + lane);
    };
    next_batch();
    load_ahead();
    int waiting = 0;
    while (more || waiting > 0) {
      if (more) {
        // The next batch is on its way while this one is filtered and compared.
        const Record record = ahead;
        const int j = base + lane;
        const bool there = j < row_stop;
        next_batch();
        load_ahead();
        const Entry other = entry_of(record, grid.diagonal);
        const bool keep = there && overlap(all, other);
        const unsigned kept = __ballot_sync(kAllLanes, keep);
        if (keep) {
          const int at = waiting + __popc(kept & ((1u << lane) - 1u));
          q.boxes[at] = scale.pack(other);
          q.names[at] = {j, other.edge};
        }
        __syncwarp();
        waiting += __popc(kept);
      }
      if (waiting >= 32 || (!more && waiting > 0)) {
        const int size = min(waiting, 32);
        waiting -= size;
        compare(q, waiting, size, packed, walks, i, mine.edge, narrow);
      }
    }
  }
}

// Large boxes, which stand behind the others, against every box: a warp takes a box and a chunk of
// candidates.
__device__ __forceinline__ void visit_large(const Diagonal& diagonal, const Scratch& s, Narrow& narrow,
                                            int small, int warp, int warps, int lane) {
  const int chunks = (s.m + Policy::large_chunk - 1) / Policy::large_chunk;
  const long long items = static_cast<long long>(s.m - small) * chunks;
  for (long long item = warp; item < items; item += warps) {
    const int i = small + static_cast<int>(item / chunks);
    const int begin = static_cast<int>(item % chunks) * Policy::large_chunk;
    const int stop = min(begin + Policy::large_chunk, s.m);
    const Entry mine = entry_of(load_record(s, i), diagonal);
    for (int base = begin; base < stop; base += 32) {
      const int j = base + lane;
      Entry other{};
      if (j < stop) other = entry_of(load_record(s, j), diagonal);
      // Two large boxes meet once.
      const bool hit = j < stop && (j < small || j > i) && overlap(mine, other) &&
                       share_no_vertex(mine.a(), mine.b(), other.a(), other.b());
      narrow.add(hit, {mine.a(), mine.b(), other.a(), other.b()}, {mine.edge, other.edge});
    }
  }
}

__global__ void __launch_bounds__(Policy::impact_threads, Policy::resident_warps / Policy::warps)
    impacts(const __grid_constant__ Scratch s, float* toi) {
  __shared__ Grid grid;
  __shared__ Queues queues[Policy::warps];
  if (threadIdx.x == 0)
    grid = collision::make_grid(s.head->sums, samples_of(s.m), s.cell_capacity, grid_shape());
  __syncthreads();
  const int lane = static_cast<int>(threadIdx.x) % 32, warp_of_block = static_cast<int>(threadIdx.x) / 32;
  const int warp = static_cast<int>(blockIdx.x) * Policy::warps + warp_of_block;
  const int warps = static_cast<int>(gridDim.x) * Policy::warps;
  const int small = s.starts[s.cell_capacity];
  const int tiles = (small + 31) / 32;
  Narrow narrow(s, toi, queues[warp_of_block], lane);
  // The queue of pairs stays filled from tile to tile, so that few batches are partial. The next tile's
  // number is on its way while the last one is worked on.
  int next = 0;
  if (lane == 0) next = atomicAdd(&s.head->tiles_taken, 1);
  for (;;) {
    const int tile = __shfl_sync(kAllLanes, next, 0);
    if (tile >= tiles) break;
    if (lane == 0) next = atomicAdd(&s.head->tiles_taken, 1);
    visit_neighbours(grid, s, queues[warp_of_block], narrow, 32 * tile, small, lane);
  }
  visit_large(grid.diagonal, s, narrow, small, warp, warps, lane);
  narrow.finish();
}

unsigned blocks_for(std::int64_t n, int per_block) {
  return static_cast<unsigned>((n + per_block - 1) / per_block);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t m = in.edges.shape[0];
    if (m > (std::int64_t{1} << 29) || in.x0.shape[0] > (std::int64_t{1} << 30))
      throw std::runtime_error("ccd_ee: too many edges or vertices for 32-bit places");
    const std::size_t count = static_cast<std::size_t>(m);
    cells_ = m / 2 + collision::kLeastCells;
    counters_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(kHeadWords + cells_ + 1));
    vertices_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(in.x0.shape[0]));
    box_of_edge_ = DeviceBuffer<float4>(2 * count);
    cell_and_rank_ = DeviceBuffer<int2>(count);
    records_ = DeviceBuffer<float4>(2 * count);
    scan_bytes_ = primitives::exclusive_sum_bytes(cells_ + 1);
    scan_ = DeviceBuffer<unsigned char>(scan_bytes_);
    multiprocessors_ = static_cast<unsigned>(collision::multiprocessors());
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int m = static_cast<int>(in.edges.shape[0]);
    if (m == 0) return;
    const int n = static_cast<int>(in.x0.shape[0]);
    const Mesh mesh{in.x0.data, in.x1.data, reinterpret_cast<const int2*>(in.edges.data), n, m};
    const Scratch s{reinterpret_cast<Head*>(counters_.get()),
                    counters_.get() + kHeadWords,
                    vertices_.get(),
                    box_of_edge_.get(),
                    cell_and_rank_.get(),
                    records_.get(),
                    static_cast<int>(cells_),
                    m};
    GPUPHYS_CUDA(cudaMemsetAsync(counters_.get(), 0,
                                 sizeof(std::int32_t) * static_cast<std::size_t>(kHeadWords + cells_ + 1)));
    const auto at_most = [this](unsigned blocks) {
      // Beyond, a thread takes several edges.
      return std::min(blocks, multiprocessors_ * static_cast<unsigned>(Policy::edge_blocks_of_sm));
    };
    const std::int64_t halves = 2 * static_cast<std::int64_t>(m);
    pack<<<at_most(blocks_for(2 * static_cast<std::int64_t>(std::max(n, m)), Policy::edge_threads)),
           Policy::edge_threads>>>(mesh, s);
    count<<<at_most(blocks_for(m, Policy::edge_threads)), Policy::edge_threads>>>(mesh, s, out.toi.data);
    primitives::exclusive_sum(scan_.get(), scan_bytes_, s.starts, s.starts, cells_ + 1);
    place<<<blocks_for(halves, Policy::edge_threads), Policy::edge_threads>>>(s);
    // A warp takes tile after tile.
    const unsigned resident = multiprocessors_ * (Policy::resident_warps / Policy::warps);
    const unsigned blocks = std::min(blocks_for(m, 32 * Policy::warps), resident);
    impacts<<<blocks, Policy::impact_threads>>>(s, out.toi.data);
  }

 private:
  static constexpr std::int64_t kHeadWords = sizeof(Head) / sizeof(std::int32_t);

  unsigned multiprocessors_ = 0;
  std::int64_t cells_ = 0;
  std::size_t scan_bytes_ = 0;
  DeviceBuffer<std::int32_t> counters_;
  DeviceBuffer<int2> cell_and_rank_;
  DeviceBuffer<float4> vertices_, box_of_edge_, records_;
  DeviceBuffer<unsigned char> scan_;
};

}  // namespace
}  // namespace gpuphys::ccd_ee

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(ccd_ee, ccd_ee::Reference)
}
