// ccd_ee in FP32: the time of the first impact of every edge with another one.
//
// 1. pack: both positions of a vertex in one 32-byte sector, written by two threads; the scene's box, and the
//    mean extent of a sample of the edges' swept boxes. With them the grid is known before any pass over
//    edges.
// 2. count: one thread an edge; fetches the ends once, keeps the box in the order of the edges, finds its
//    cell and its rank there.
//    A scan turns the counts into the cells' starts.
// 3. place: two threads an edge; its box with the two vertices goes to its place as one whole sector.
// 4. impacts: a warp takes tiles of 32 places in a row. It walks the cells within reach of them, reads 32
//    candidates at a time, one a lane, and keeps in shared memory those that overlap the box around the tile.
//    32 of these are compared with the boxes of all lanes, without a vote or a branch; the hits of a lane are
//    the bits of a mask. Pairs are met once, from the lower place. Those whose boxes overlap and that share
//    no vertex go to a queue of the warp and are examined 32 at a time: a cubic whose Bernstein coefficients
//    have one sign is dropped, the rest goes to a second queue, from which 32 at a time are bisected. Both
//    outlive the tile. So the long instruction streams run with full warps although few candidates get that
//    far.
//
// What bounds it: instructions of `impacts`, and random sectors from L2 in `count` and `place`. Of the
// paper's public input 9.1 M pairs of boxes overlap, 6.1 M of them of edges with a vertex in common; 3.0 M
// are examined, 1.3 M have a cubic that may change its sign, 0.39 M events are found (counted on the host).
// references/collision_query/NOTES.md has the predictions stage by stage and what was measured.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "cases/collision_query/ccd_ee.hpp"
#include "references/collision_query/cubic_toi.cuh"
#include "references/collision_query/swept_broad_phase.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::ccd_ee {
namespace {

using collision::Cubic;
using collision::Grid;
using collision::Moving;
using collision::SceneSums;
using collision::SweptBox;
using collision::operator-;

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
  static constexpr float cell_over_extent[3] = {0.5f, 1.4f, 2.0f};
  static constexpr int sampled_edges = 65536;  // for the mean extent
  static constexpr float large_over_extent = 4.0f;
#endif
  static constexpr int edge_blocks = 132 * 8;  // at most, each thread then takes several edges
  static constexpr int large_chunk = 1024;     // candidates of a large box that a warp takes at a time
#ifdef GPUPHYS_CCD_EE_RESIDENT_WARPS
  static constexpr int resident_warps = GPUPHYS_CCD_EE_RESIDENT_WARPS;
#else
  static constexpr int resident_warps = 24;  // of `impacts` on an SM: 80 registers a thread
#endif
  static constexpr int impact_threads = 32 * warps;
  // Of 32 places, that a warp takes on average: more leave fewer partial batches, fewer fill the SMs evenly.
  static constexpr int tiles_of_warp = 4;
  static constexpr int resident_blocks = 132 * resident_warps / warps;
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

__device__ __forceinline__ SweptBox box_of(const EdgeMotion& e) {
  return collision::box_of(e.a0, e.b0, e.a1, e.b1);
}

// What passes between the kernels.
struct Scratch {
  SceneSums* sums;
  std::int32_t* starts;        // per cell: the count, after the scan the first place; one more for the large
  float4* vertices;            // per vertex: two, its positions at both times; one 32-byte sector
  float4* box_of_edge;         // [2][m] lower corners and first vertices, upper corners and second ones
  int2* cell_and_rank;         // per edge
  std::int32_t* order;         // per place: the edge
  float4* __restrict__ boxes;  // per place: two, lower and upper corner with the two vertices
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
__global__ void __launch_bounds__(Policy::edge_threads) pack(Mesh mesh, Scratch s) {
  __shared__ unsigned codes[6];
  __shared__ float extents;
  if (threadIdx.x < 6) codes[threadIdx.x] = 0;
  if (threadIdx.x == 0) extents = 0.0f;
  __syncthreads();
  unsigned low[3] = {0, 0, 0}, high[3] = {0, 0, 0};
  const auto extend = [&](int d, float x) {
    low[d] = max(low[d], collision::encode(-x));
    high[d] = max(high[d], collision::encode(x));
  };
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  float extent = 0.0f;
  const int samples = samples_of(mesh.m), step = mesh.m / max(samples, 1);
  for (int k = thread; k < samples; k += stride) {
    // One edge of each `step`, not always the same one of them: edges may come in a pattern.
    const int e =
        k * step + static_cast<int>(static_cast<unsigned>(k) * 2654435769u % static_cast<unsigned>(step));
    extent += box_of(motion_of(mesh, mesh.edges[e])).extent();
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
  extent = collision::warp_sum(extent);
  for (int d = 0; d < 3; ++d) {
    low[d] = collision::warp_max(low[d]);
    high[d] = collision::warp_max(high[d]);
  }
  if (threadIdx.x % 32 == 0) {
    for (int d = 0; d < 3; ++d) {
      atomicMax(&codes[d], low[d]);
      atomicMax(&codes[3 + d], high[d]);
    }
    atomicAdd(&extents, extent);
  }
  __syncthreads();
  if (threadIdx.x < 3) atomicMax(&s.sums->low_code[threadIdx.x], codes[threadIdx.x]);
  if (threadIdx.x >= 3 && threadIdx.x < 6) atomicMax(&s.sums->high_code[threadIdx.x - 3], codes[threadIdx.x]);
  if (threadIdx.x == 6 && extents > 0.0f) atomicAdd(&s.sums->extent_sum, extents);
}

// Boxes in the order of the edges, each one's cell and its rank there.
__global__ void __launch_bounds__(Policy::edge_threads) count(Mesh mesh, Scratch s, float* toi) {
  __shared__ Grid grid;
  __shared__ unsigned codes[3];
  if (threadIdx.x < 3) codes[threadIdx.x] = 0;
  if (threadIdx.x == 0)
    grid = collision::make_grid(*s.sums, samples_of(mesh.m), s.cell_capacity, grid_shape());
  __syncthreads();
  unsigned reach[3] = {0, 0, 0};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int e = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); e < mesh.m; e += stride) {
    const int2 ends = mesh.edges[e];
    const SweptBox box = box_of(motion_of(s, ends));
    const int cell = collision::cell_of(grid, box, s.cell_capacity);
    s.cell_and_rank[e] = {cell, atomicAdd(&s.starts[cell], 1)};
    s.box_of_edge[e] = {box.low[0], box.low[1], box.low[2], __int_as_float(ends.x)};
    s.box_of_edge[static_cast<std::ptrdiff_t>(s.m) + e] = {box.high[0], box.high[1], box.high[2],
                                                           __int_as_float(ends.y)};
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
  if (threadIdx.x < 3) atomicMax(&s.sums->reach_code[threadIdx.x], codes[threadIdx.x]);
}

// Two threads an edge, which write its box to its place as one whole sector.
__global__ void __launch_bounds__(Policy::edge_threads) place(Scratch s) {
  const std::int64_t t = static_cast<std::int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  const int e = static_cast<int>(t / 2), half = static_cast<int>(t % 2);
  if (e >= s.m) return;
  const int2 at = s.cell_and_rank[e];
  const float4 corner = s.box_of_edge[half * static_cast<std::ptrdiff_t>(s.m) + e];
  const int place = s.starts[at.x] + at.y;
  s.boxes[2 * static_cast<std::ptrdiff_t>(place) + half] = corner;
  if (half == 0) s.order[place] = e;
}

__device__ __forceinline__ EdgeMotion load_motion(const Scratch& s, int place) {
  const float4* b = s.boxes + 2 * static_cast<std::ptrdiff_t>(place);
  return motion_of(s, {__float_as_int(__ldg(&b[0].w)), __float_as_int(__ldg(&b[1].w))});
}

// A pair's relative motion: u and v along the edges, w between their first ends.
struct PairMotion {
  Moving u, v, w;
};

__device__ __forceinline__ PairMotion relative(const EdgeMotion& p, const EdgeMotion& q) {
  const auto moving = [](float3 from0, float3 to0, float3 from1, float3 to1) {
    const float3 start = to0 - from0;
    return Moving{start, (to1 - from1) - start};
  };
  return {moving(p.a0, p.b0, p.a1, p.b1), moving(q.a0, q.b0, q.a1, q.b1), moving(p.a0, q.a0, p.a1, q.a1)};
}

// Whether the point where the lines of two coplanar edges cross lies on both of them.
__device__ __forceinline__ bool meet(float3 u, float3 v, float3 w) {
  const float3 n = collision::cross(u, v);
  const float nn = collision::dot(n, n);
  const float s = collision::dot(collision::cross(w, v), n);  // times nn
  const float r = collision::dot(collision::cross(w, u), n);
  const bool crossing = nn > 1e-12f * (collision::dot(u, u) * collision::dot(v, v));
  return crossing && s >= 0.0f && s <= nn && r >= 0.0f && r <= nn;
}

// What a warp keeps in shared memory: candidates, read 32 at a time, and two queues of pairs, those to
// examine and those to bisect.
struct Queues {
  float4 low[64], high[64];  // candidates
  int place[64];
  int2 overlapping[128];
  int2 crossing[64];
};

// Adds the pairs of the lanes in `hits` to a queue of `count`.
__device__ __forceinline__ int append(int2* queue, int count, unsigned hits, int2 pair, int lane) {
  if (hits >> lane & 1u) queue[count + __popc(hits & ((1u << lane) - 1u))] = pair;
  __syncwarp();
  return count + __popc(hits);
}

__device__ __forceinline__ int2 take(const int2* queue, int first, int lane) {
  const int2 pair = queue[first + lane];
  __syncwarp();
  return pair;
}

// Floats that are not negative are ordered as their bits are.
__device__ __forceinline__ void record(float* toi, int edge, float t) {
  atomicMin(reinterpret_cast<int*>(toi + edge), __float_as_int(t));
}

// Times of the pairs of a warp; lanes without one have `mine` unset.
__device__ __noinline__ void resolve(const Scratch& s, float* toi, bool mine, int2 pair) {
  if (mine) {
    // The edge of the lower number comes first, whatever the order in a cell: rounding does not depend on it.
    const int e = s.order[pair.x], f = s.order[pair.y];
    const bool swap = f < e;
    const EdgeMotion p = load_motion(s, swap ? pair.y : pair.x), q = load_motion(s, swap ? pair.x : pair.y);
    const PairMotion r = relative(p, q);
    const Cubic volume = collision::triple_product(r.w, r.u, r.v);
    const float t =
        collision::first_crossing(volume, [&](float at) { return meet(r.u.at(at), r.v.at(at), r.w.at(at)); });
    if (t < 1.0f) {
      record(toi, e, t);
      record(toi, f, t);
    }
  }
  __syncwarp();
}

// Queues those of a warp's pairs that may be coplanar at some time; returns how many the second queue holds
// then.
__device__ __noinline__ int examine(const Scratch& s, float* toi, int2* crossing_queue, int crossings,
                                    int lane, bool mine, int2 pair) {
  bool crossing = false;
  if (mine) {
    const PairMotion r = relative(load_motion(s, pair.x), load_motion(s, pair.y));
    crossing = !collision::keeps_its_sign(collision::triple_product(r.w, r.u, r.v));
  }
  crossings = append(crossing_queue, crossings, __ballot_sync(kAllLanes, crossing), pair, lane);
  if (crossings >= 32) {
    crossings -= 32;
    resolve(s, toi, true, take(crossing_queue, crossings, lane));
  }
  return crossings;
}

class Narrow {
 public:
  __device__ __forceinline__ Narrow(const Scratch& s, float* toi, Queues& queues, int lane)
      : s_(s), toi_(toi), queues_(queues), lane_(lane) {}

  // All lanes call it; those with `hit` bring the pair of places (i, j).
  __device__ __forceinline__ void add(bool hit, int i, int j) {
    const unsigned hits = __ballot_sync(kAllLanes, hit);
    if (hits == 0) return;
    overlaps_ = append(queues_.overlapping, overlaps_, hits, {i, j}, lane_);
    examine_full_batches();
  }

  // All lanes call it: a bit of `hits` stands for the pair of place i with the candidate of that number from
  // `first` on. Up to three pairs a lane go to the queue at a time, which has room for them beside the 31
  // that may be left.
  __device__ __forceinline__ void add_all(unsigned hits, int i, int first) {
    const unsigned lanes_before = (1u << lane_) - 1u;
#pragma unroll 1
    while (__any_sync(kAllLanes, hits != 0)) {
      const int mine = min(__popc(hits), 3);
      const unsigned ones = __ballot_sync(kAllLanes, (mine & 1) != 0);
      const unsigned twos = __ballot_sync(kAllLanes, (mine & 2) != 0);
      const int at = overlaps_ + __popc(ones & lanes_before) + 2 * __popc(twos & lanes_before);
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        if (k < mine) {
          queues_.overlapping[at + k] = {i, queues_.place[first + __ffs(static_cast<int>(hits)) - 1]};
          hits &= hits - 1u;
        }
      }
      __syncwarp();
      overlaps_ += __popc(ones) + 2 * __popc(twos);
      examine_full_batches();
    }
  }

  // What is left at the end: fewer than 32 pairs in each queue.
  __device__ __forceinline__ void finish() {
    if (overlaps_ > 0) {
      const bool mine = lane_ < overlaps_;
      const int2 pair = queues_.overlapping[mine ? lane_ : 0];
      crossings_ = examine(s_, toi_, queues_.crossing, crossings_, lane_, mine, pair);
    }
    if (crossings_ > 0) {
      const bool mine = lane_ < crossings_;
      resolve(s_, toi_, mine, queues_.crossing[mine ? lane_ : 0]);
    }
  }

 private:
  __device__ __forceinline__ void examine_full_batches() {
#pragma unroll 1
    while (overlaps_ >= 32) {
      overlaps_ -= 32;
      crossings_ = examine(s_, toi_, queues_.crossing, crossings_, lane_, true,
                           take(queues_.overlapping, overlaps_, lane_));
    }
  }

  const Scratch& s_;
  float* toi_;
  Queues& queues_;
  int lane_;
  int overlaps_ = 0, crossings_ = 0;
};

// A box with the two vertices of its edge.
struct Entry {
  float4 low, high;
};

__device__ __forceinline__ Entry load_entry(const Scratch& s, int place) {
  const float4* b = s.boxes + 2 * static_cast<std::ptrdiff_t>(place);
  return {__ldg(b), __ldg(b + 1)};
}

__device__ __forceinline__ bool overlap(const Entry& p, const Entry& q) {
  return (p.low.x <= q.high.x) & (q.low.x <= p.high.x) & (p.low.y <= q.high.y) & (q.low.y <= p.high.y) &
         (p.low.z <= q.high.z) & (q.low.z <= p.high.z);
}

// Boxes overlap and their edges share no vertex. No short cuts: ten comparisons cost less than a branch.
__device__ __forceinline__ bool is_candidate(const Entry& p, const Entry& q) {
  const int a = __float_as_int(p.low.w), b = __float_as_int(p.high.w);
  const int c = __float_as_int(q.low.w), d = __float_as_int(q.high.w);
  return overlap(p, q) & (a != c) & (a != d) & (b != c) & (b != d);
}

// `size` (at most 32) candidates from `first` on against the boxes of all lanes. Which of them each lane hits
// is kept in a mask, so that the comparisons run without a vote or a branch.
__device__ __forceinline__ void compare(const Queues& q, int first, int size, const Entry& mine, bool walks,
                                        int i, Narrow& narrow) {
  constexpr int unrolled = 8;
  unsigned hits = 0;
#pragma unroll 1
  for (int base = 0; base < size; base += unrolled) {
    unsigned some = 0;
#pragma unroll
    for (int k = 0; k < unrolled; ++k) {
      const int at = first + base + k;
      if (is_candidate(mine, {q.low[at], q.high[at]})) some |= 1u << k;
    }
    hits |= some << base;
  }
  if (size < 32) hits &= (1u << size) - 1u;
  // Pairs are met once, from the lower place. Candidates stand in the order of their places; only the first
  // ones may come from the warp's own.
  if (__any_sync(kAllLanes, walks && q.place[first] <= i)) {
    int lower = 0;
#pragma unroll
    for (int step = 16; step > 0; step /= 2) {
      const int at = lower + step - 1;
      if (at < size && q.place[first + at] <= i) lower += step;
    }
    if (lower < size && q.place[first + lower] <= i) ++lower;
    hits = lower < 32 ? hits & (0xffffffffu << lower) : 0;
  }
  narrow.add_all(walks ? hits : 0u, i, first);
  __syncwarp();
}

// The largest number among the lanes that have `takes` set, the smallest number there is if none has.
__device__ __forceinline__ float largest(float x, bool takes) {
  return collision::decode(collision::warp_max(takes ? collision::encode(x) : 0x00800000u));
}

// The pairs of 32 places in a row, `i` of this lane (at or beyond `end`: none).
__device__ __forceinline__ void visit_neighbours(const Grid& grid, const Scratch& s, Queues& q,
                                                 Narrow& narrow, int i, int end, int lane) {
  Entry mine{};
  int own_y = 0, own_z = 0;
  const bool present = i < end;
  if (present) {
    mine = load_entry(s, i);
    const SweptBox box{{mine.low.x, mine.low.y, mine.low.z}, {mine.high.x, mine.high.y, mine.high.z}};
    own_y = grid.coordinate(box.centre(1), 1);
    own_z = grid.coordinate(box.centre(2), 2);
  }
  const int own_row = grid.row(own_y, own_z);
  // Lanes whose boxes lie in the same row of cells walk together. Every vote and shuffle here is by all
  // lanes, also by those without a place.
  for (unsigned todo = __ballot_sync(kAllLanes, present); todo != 0;) {
    const int leader = __ffs(static_cast<int>(todo)) - 1;
    const int leading_row = __shfl_sync(kAllLanes, own_row, leader);
    const bool walks = present && own_row == leading_row;
    todo &= ~__ballot_sync(kAllLanes, walks);
    // All rows before their own hold lower places only.
    const int first_z = __shfl_sync(kAllLanes, own_z, leader);
    const int first_y = __shfl_sync(kAllLanes, own_y, leader);
    const int after = __shfl_sync(kAllLanes, i, leader) + 1;
    Entry all{};  // the box around theirs
    all.low.x = -largest(-mine.low.x, walks);
    all.low.y = -largest(-mine.low.y, walks);
    all.low.z = -largest(-mine.low.z, walks);
    all.high.x = largest(mine.high.x, walks);
    all.high.y = largest(mine.high.y, walks);
    all.high.z = largest(mine.high.z, walks);
    const int low_x = grid.coordinate(all.low.x - grid.reach[0], 0);
    const int high_x = grid.coordinate(all.high.x + grid.reach[0], 0);
    const int low_y = grid.coordinate(all.low.y - grid.reach[1], 1);
    const int high_y = grid.coordinate(all.high.y + grid.reach[1], 1);
    const int high_z = grid.coordinate(all.high.z + grid.reach[2], 2);
    int waiting = 0;
    // The rows of cells from their own on, 32 at a time: each lane looks up one.
    const int rows_y = high_y - low_y + 1, rows = (high_z - first_z + 1) * rows_y;
    for (int first_row = first_y - low_y; first_row < rows; first_row += 32) {
      int begin = 0, stop = 0;
      const int k = first_row + lane;
      if (k < rows) {
        const int row = grid.row(low_y + k % rows_y, first_z + k / rows_y);
        begin = max(s.starts[row + low_x], after);
        stop = s.starts[row + high_x + 1];
      }
      for (unsigned filled = __ballot_sync(kAllLanes, begin < stop); filled != 0; filled &= filled - 1u) {
        const int from = __ffs(static_cast<int>(filled)) - 1;
        const int row_stop = __shfl_sync(kAllLanes, stop, from);
        for (int base = __shfl_sync(kAllLanes, begin, from); base < row_stop; base += 32) {
          const int j = base + lane;
          Entry other{};
          if (j < row_stop) other = load_entry(s, j);
          const bool keep = j < row_stop && overlap(all, other);
          const unsigned kept = __ballot_sync(kAllLanes, keep);
          if (keep) {
            const int at = waiting + __popc(kept & ((1u << lane) - 1u));
            q.low[at] = other.low;
            q.high[at] = other.high;
            q.place[at] = j;
          }
          __syncwarp();
          waiting += __popc(kept);
          if (waiting >= 32) {
            waiting -= 32;
            compare(q, waiting, 32, mine, walks, i, narrow);
          }
        }
      }
    }
    if (waiting > 0) compare(q, 0, waiting, mine, walks, i, narrow);
  }
}

// Large boxes, which stand behind the others, against every box: a warp takes a box and a chunk of
// candidates.
__device__ __forceinline__ void visit_large(const Scratch& s, Narrow& narrow, int small, int warp, int warps,
                                            int lane) {
  const int chunks = (s.m + Policy::large_chunk - 1) / Policy::large_chunk;
  const long long items = static_cast<long long>(s.m - small) * chunks;
  for (long long item = warp; item < items; item += warps) {
    const int i = small + static_cast<int>(item / chunks);
    const int begin = static_cast<int>(item % chunks) * Policy::large_chunk;
    const int stop = min(begin + Policy::large_chunk, s.m);
    const Entry mine = load_entry(s, i);
    for (int base = begin; base < stop; base += 32) {
      const int j = base + lane;
      // Two large boxes meet once.
      const bool hit = j < stop && (j < small || j > i) && is_candidate(mine, load_entry(s, j));
      narrow.add(hit, i, j);
    }
  }
}

__global__ void __launch_bounds__(Policy::impact_threads, Policy::resident_warps / Policy::warps)
    impacts(const __grid_constant__ Scratch s, float* toi, int tiles_of_block) {
  __shared__ Grid grid;
  __shared__ Queues queues[Policy::warps];
  __shared__ int taken;
  if (threadIdx.x == 0) {
    grid = collision::make_grid(*s.sums, samples_of(s.m), s.cell_capacity, grid_shape());
    taken = 0;
  }
  __syncthreads();
  const int lane = static_cast<int>(threadIdx.x) % 32, warp_of_block = static_cast<int>(threadIdx.x) / 32;
  const int warp = static_cast<int>(blockIdx.x) * Policy::warps + warp_of_block;
  const int warps = static_cast<int>(gridDim.x) * Policy::warps;
  const int small = s.starts[s.cell_capacity];
  Narrow narrow(s, toi, queues[warp_of_block], lane);
  // Its queues stay filled from tile to tile, so that few batches are partial.
  for (;;) {
    int tile = 0;
    if (lane == 0) tile = atomicAdd(&taken, 1);
    tile = __shfl_sync(kAllLanes, tile, 0);
    const std::int64_t first = 32 * (static_cast<std::int64_t>(blockIdx.x) * tiles_of_block + tile);
    if (tile >= tiles_of_block || first >= small) break;
    visit_neighbours(grid, s, queues[warp_of_block], narrow, static_cast<int>(first) + lane, small, lane);
  }
  visit_large(s, narrow, small, warp, warps, lane);
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
    cells_ = m + collision::kLeastCells;
    // The sums stand before the counts, so that one memset clears both.
    counters_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(kSumsWords + cells_ + 1));
    vertices_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(in.x0.shape[0]));
    box_of_edge_ = DeviceBuffer<float4>(2 * count);
    cell_and_rank_ = DeviceBuffer<int2>(count);
    order_ = DeviceBuffer<std::int32_t>(count);
    boxes_ = DeviceBuffer<float4>(2 * count);
    scan_bytes_ = primitives::exclusive_sum_bytes(cells_ + 1);
    scan_ = DeviceBuffer<unsigned char>(scan_bytes_);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int m = static_cast<int>(in.edges.shape[0]);
    if (m == 0) return;
    const int n = static_cast<int>(in.x0.shape[0]);
    const Mesh mesh{in.x0.data, in.x1.data, reinterpret_cast<const int2*>(in.edges.data), n, m};
    const Scratch s{reinterpret_cast<SceneSums*>(counters_.get()),
                    counters_.get() + kSumsWords,
                    vertices_.get(),
                    box_of_edge_.get(),
                    cell_and_rank_.get(),
                    order_.get(),
                    boxes_.get(),
                    static_cast<int>(cells_),
                    m};
    GPUPHYS_CUDA(cudaMemsetAsync(counters_.get(), 0,
                                 sizeof(std::int32_t) * static_cast<std::size_t>(kSumsWords + cells_ + 1)));
    const auto at_most = [](unsigned blocks) {
      return std::min(blocks, static_cast<unsigned>(Policy::edge_blocks));
    };
    const std::int64_t halves = 2 * static_cast<std::int64_t>(m);
    pack<<<at_most(blocks_for(2 * static_cast<std::int64_t>(std::max(n, m)), Policy::edge_threads)),
           Policy::edge_threads>>>(mesh, s);
    count<<<at_most(blocks_for(m, Policy::edge_threads)), Policy::edge_threads>>>(mesh, s, out.toi.data);
    primitives::exclusive_sum(scan_.get(), scan_bytes_, s.starts, s.starts, cells_ + 1);
    place<<<blocks_for(halves, Policy::edge_threads), Policy::edge_threads>>>(s);
    const std::int64_t tiles = (static_cast<std::int64_t>(m) + 31) / 32;
    const int tiles_of_block =
        Policy::warps * static_cast<int>(std::clamp<std::int64_t>(
                            tiles / (2 * Policy::warps * Policy::resident_blocks), 1, Policy::tiles_of_warp));
    impacts<<<blocks_for(tiles, tiles_of_block), Policy::impact_threads>>>(s, out.toi.data, tiles_of_block);
  }

 private:
  static constexpr std::int64_t kSumsWords = 64;  // keeps the counts aligned to 256 bytes
  static_assert(sizeof(SceneSums) <= 4 * kSumsWords);

  std::int64_t cells_ = 0;
  std::size_t scan_bytes_ = 0;
  DeviceBuffer<std::int32_t> counters_, order_;
  DeviceBuffer<int2> cell_and_rank_;
  DeviceBuffer<float4> vertices_, box_of_edge_, boxes_;
  DeviceBuffer<unsigned char> scan_;
};

}  // namespace
}  // namespace gpuphys::ccd_ee

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(ccd_ee, ccd_ee::Reference)
}
