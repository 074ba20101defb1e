// ccd_ve in FP32: the first time within the step at which each vertex comes within d of an edge's inside.
//
// The broad phase (references/blocks/swept_pairs.cuh) brings together vertices and edges whose boxes overlap,
// those of the vertices wider by d. Pairs without a vertex in common wait in a queue of the warp; 32 at a
// time are solved. g(t) = |w x u|^2 - d^2 |u|^2 is a polynomial of degree four. Where it turns, its
// coefficients say (the zeros of a cubic, cubic_toi.cuh); its sign is taken from the vectors themselves,
// whose cross product keeps its digits where the sum of five terms would lose them.
//
// What bounds it: at this size everything is in L2; launches, the random sectors of the sort, and the
// instructions of the pairs (about 30 x 25 for a piece that is bisected).
#include "cases/collision_query/ccd_ve.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/swept_pairs.cuh"
#include "references/collision_query/cubic_toi.cuh"

namespace gpuphys::ccd_ve {
namespace {

using collision::Cubic;
using collision::Moving;
using collision::MovingVertex;

#ifdef GPUPHYS_OTHER_BLOCKS  // the broad phase has others as well
constexpr int kWarps = 2, kResidentWarps = 16;
#else
constexpr int kWarps = 4, kResidentWarps = 24;  // of a block, on a multiprocessor
#endif

// A vertex and an edge: w from the edge's first end to the vertex, u along the edge. w and d are in one unit,
// u in another.
struct Pair {
  Moving w, u;
  float d, w_over_u, least_square;

  // Whether the vertex is within d of the edge's line.
  __device__ __forceinline__ bool near_line(float t) const {
    const float3 along = u.at(t), c = collision::cross(w.at(t), along);
    return collision::dot(c, c) <= d * d * collision::dot(along, along);
  }
  // Whether it is beside the edge, between its ends.
  __device__ __forceinline__ bool beside(float t) const {
    const float3 along = u.at(t);
    const float uu = collision::dot(along, along), wu = collision::dot(w.at(t), along);
    return uu > least_square && wu >= 0.0f && wu <= w_over_u * uu;
  }
};

__device__ __forceinline__ Pair pair_of(const MovingVertex& p, const MovingVertex& a, const MovingVertex& b,
                                        float d) {
  Pair pair;
  pair.w = collision::relative(a.x0, p.x0, a.x1, p.x1);
  pair.u = collision::relative(a.x0, b.x0, a.x1, b.x1);
  const float u_unit = collision::normalise(pair.u), w_unit = collision::normalise(pair.w, d);
  pair.d = w_unit * d;
  pair.w_over_u = w_unit / u_unit;
  const float3 end = pair.u.at(1.0f);
  pair.least_square = 0x1p-40f * fmaxf(collision::dot(pair.u.start, pair.u.start), collision::dot(end, end));
  return pair;
}

// The derivative of g.
__device__ __forceinline__ Cubic slope(const Pair& p) {
  const float3 c0 = collision::cross(p.w.start, p.u.start), c2 = collision::cross(p.w.change, p.u.change);
  const float3 m = collision::cross(p.w.start, p.u.change), n = collision::cross(p.w.change, p.u.start);
  const float3 c1 = {m.x + n.x, m.y + n.y, m.z + n.z};
  const float dd = p.d * p.d;
  Cubic f;
  f.c0 = 2.0f * (collision::dot(c0, c1) - dd * collision::dot(p.u.start, p.u.change));
  f.c1 = 2.0f * (collision::dot(c1, c1) + 2.0f * collision::dot(c0, c2) -
                 dd * collision::dot(p.u.change, p.u.change));
  f.c2 = 6.0f * collision::dot(c1, c2);
  f.c3 = 4.0f * collision::dot(c2, c2);
  return collision::normalised(f);
}

// 1 if there is none.
__device__ __forceinline__ float first_contact(const Pair& p) {
  if (p.near_line(0.0f) && p.beside(0.0f)) return 0.0f;
  // g is monotone between 0, up to three turns, and 1; pieces behind the last turn are empty.
  float turn[3] = {1.0f, 1.0f, 1.0f};
  collision::first_crossing(slope(p), [&](float t) {
    turn[2] = turn[1] < 1.0f ? t : 1.0f;
    turn[1] = turn[1] < 1.0f ? turn[1] : turn[0] < 1.0f ? t : 1.0f;
    turn[0] = turn[0] < 1.0f ? turn[0] : t;
    return false;
  });
  float low = 0.0f;
  bool near_low = p.near_line(0.0f);
#pragma unroll 1
  for (int piece = 0; piece < 4; ++piece) {
    const float high = piece == 0 ? turn[0] : piece == 1 ? turn[1] : piece == 2 ? turn[2] : 1.0f;
    const bool near_high = p.near_line(high);
    if (!near_low && near_high) {
      const float t = collision::bisect([&](float at) { return !p.near_line(at); }, low, high);
      if (p.beside(t)) return t;
    }
    low = high;
    near_low = near_high;
  }
  return 1.0f;
}

// Times of the pairs of a warp: number of the vertex and the two of the edge.
__device__ __noinline__ void resolve(const collision::SweptScene<2>& s, float* toi, bool mine, int4 pair) {
  if (mine) {
    const float t = first_contact(pair_of(s.vertex(pair.x), s.vertex(pair.y), s.vertex(pair.z), s.margin));
    if (t < 1.0f) collision::record_time(toi, pair.x, t);
  }
  __syncwarp();
}

__global__ void __launch_bounds__(32 * kWarps, kResidentWarps / kWarps)
    contacts(const __grid_constant__ collision::SweptScene<2> s, float* toi) {
  __shared__ collision::Grid grid;
  __shared__ int4 queues[kWarps][collision::PairQueue::kRoom];
  if (threadIdx.x == 0) grid = s.grid();
  __syncthreads();
  const int lane = static_cast<int>(threadIdx.x) % 32, warp_of_block = static_cast<int>(threadIdx.x) / 32;
  const int warp = static_cast<int>(blockIdx.x) * kWarps + warp_of_block;
  collision::PairQueue queue(queues[warp_of_block], lane);
  const auto solve = [&](bool mine, int4 pair) { resolve(s, toi, mine, pair); };
  collision::visit_swept_pairs(s, grid, warp, static_cast<int>(gridDim.x) * kWarps,
                               [&](bool hit, const MovingVertex& own, const collision::SweptRecord& edge) {
                                 const int3 ends = collision::corners_of(edge);
                                 queue.add(hit && own.number != ends.x && own.number != ends.y,
                                           {own.number, ends.x, ends.y, 0}, solve);
                               });
  queue.finish(solve);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    pairs_ = collision::SweptPairs<2>(in.x0.shape[0], in.edges.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto scene = pairs_.build(in.x0.data, in.x1.data, in.edges.data, in.d, 0.0f, out.toi.data);
    contacts<<<pairs_.visit_blocks(kWarps, kResidentWarps), 32 * kWarps>>>(scene, out.toi.data);
  }

 private:
  collision::SweptPairs<2> pairs_;
};

}  // namespace
}  // namespace gpuphys::ccd_ve

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(ccd_ve, ccd_ve::Reference)
}
