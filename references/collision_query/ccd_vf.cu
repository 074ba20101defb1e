// ccd_vf in FP32: the first time within the step at which each vertex passes through a triangle.
//
// The broad phase (references/blocks/swept_pairs.cuh) brings together vertices and triangles whose boxes
// overlap; a box of four thin sides along a diagonal keeps away half of the pairs that the axes alone leave.
// Pairs without a vertex in common wait in a queue of the warp; 32 at a time are solved: the cubic
// w . (u x v) is isolated and bisected (cubic_toi.cuh), and a crossing counts if it lies in the triangle.
//
// What bounds it: the random sectors of the sort (a triangle gathers three vertices, twice), then L1 and
// instructions of the walk and of the pairs.
#include "cases/collision_query/ccd_vf.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/swept_pairs.cuh"
#include "references/collision_query/cubic_toi.cuh"

namespace gpuphys::ccd_vf {
namespace {

using collision::Moving;
using collision::MovingVertex;

#ifdef GPUPHYS_OTHER_BLOCKS  // the broad phase has others as well
constexpr int kWarps = 2, kResidentWarps = 16;
#else
constexpr int kWarps = 4, kResidentWarps = 24;  // of a block, on a multiprocessor
#endif
constexpr float kMargin = 0x1p-20f;     // of the fractions s and r
constexpr float kBoxMargin = 0x1p-18f;  // of a triangle's box: more than what the margin above reaches

// Whether the point w = s u + r v lies in the triangle of u and v.
__device__ __forceinline__ bool inside(float3 w, float3 u, float3 v, float u_over_w, float v_over_w) {
  const collision::Fractions at = collision::fractions(w, u, v);
  const float s = u_over_w * at.s, r = v_over_w * at.r, least = -kMargin * at.nn;
  return !at.parallel && s >= least && r >= least && s + r <= (1.0f + kMargin) * at.nn;
}

// Times of the pairs of a warp: number of the vertex and the three of the triangle.
__device__ __noinline__ void resolve(const collision::SweptScene<3>& s, float* toi, bool mine, int4 pair) {
  if (mine) {
    const MovingVertex p = s.vertex(pair.x), a = s.vertex(pair.y), b = s.vertex(pair.z), c = s.vertex(pair.w);
    Moving u = collision::relative(a.x0, b.x0, a.x1, b.x1), v = collision::relative(a.x0, c.x0, a.x1, c.x1);
    Moving w = collision::relative(a.x0, p.x0, a.x1, p.x1);
    const float u_unit = collision::normalise(u), v_unit = collision::normalise(v);
    const float w_unit = collision::normalise(w), u_over_w = u_unit / w_unit, v_over_w = v_unit / w_unit;
    const float t = collision::first_crossing(collision::triple_product(w, u, v), [&](float at) {
      return inside(w.at(at), u.at(at), v.at(at), u_over_w, v_over_w);
    });
    if (t < 1.0f) collision::record_time(toi, pair.x, t);
  }
  __syncwarp();
}

__global__ void __launch_bounds__(32 * kWarps, kResidentWarps / kWarps)
    impacts(const __grid_constant__ collision::SweptScene<3> s, float* toi) {
  __shared__ collision::Grid grid;
  __shared__ int4 queues[kWarps][collision::PairQueue::kRoom];
  if (threadIdx.x == 0) grid = s.grid();
  __syncthreads();
  const int lane = static_cast<int>(threadIdx.x) % 32, warp_of_block = static_cast<int>(threadIdx.x) / 32;
  const int warp = static_cast<int>(blockIdx.x) * kWarps + warp_of_block;
  collision::PairQueue queue(queues[warp_of_block], lane);
  const auto solve = [&](bool mine, int4 pair) { resolve(s, toi, mine, pair); };
  collision::visit_swept_pairs(
      s, grid, warp, static_cast<int>(gridDim.x) * kWarps,
      [&](bool hit, const MovingVertex& own, const collision::SweptRecord& triangle) {
        const int3 c = collision::corners_of(triangle);
        const bool incident = own.number == c.x || own.number == c.y || own.number == c.z;
        queue.add(hit && !incident, {own.number, c.x, c.y, c.z}, solve);
      });
  queue.finish(solve);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    pairs_ = collision::SweptPairs<3>(in.x0.shape[0], in.tris.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto scene = pairs_.build(in.x0.data, in.x1.data, in.tris.data, 0.0f, kBoxMargin, out.toi.data);
    impacts<<<pairs_.visit_blocks(kWarps, kResidentWarps), 32 * kWarps>>>(scene, out.toi.data);
  }

 private:
  collision::SweptPairs<3> pairs_;
};

}  // namespace
}  // namespace gpuphys::ccd_vf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(ccd_vf, ccd_vf::Reference)
}
