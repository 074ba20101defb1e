// ccd_vv in FP32: the first time within the step at which each vertex comes within d of another one.
//
// The broad phase (references/blocks/swept_pairs.cuh) sorts the vertices, both positions and the number in
// one 32-byte sector, into the cells of a grid; one lane a vertex, neighbours in space side by side, then
// reads the records of the cells within reach. Each pair is met from both sides: each finds its own minimum,
// and both find the same bits, since p and q only change their signs.
//
// What bounds it: moving the vertices. Of 188 MB read and 31 MB written at least, bounds, count and place
// read the positions once each and write 32 bytes a vertex to random places, about 1.0 GB in all; the walk
// reads 251 MB and some six records a vertex out of L1. Boxes sort out all but one pair in a few, so that the
// quadratic equation is solved rarely.
#include "cases/collision_query/ccd_vv.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/swept_pairs.cuh"
#include "references/collision_query/cubic_toi.cuh"

namespace gpuphys::ccd_vv {
namespace {

using collision::MovingVertex;
using collision::operator-;

#ifdef GPUPHYS_OTHER_BLOCKS  // the broad phase has others as well
constexpr int kWarps = 2, kResidentWarps = 16;
#else
constexpr int kWarps = 4, kResidentWarps = 32;  // of a block, on a multiprocessor
#endif

// 1 if the two never come within d.
__device__ __forceinline__ float first_contact(const MovingVertex& i, const MovingVertex& j, float d) {
  // Seen from i: first differences, then their change.
  const float3 start = j.x0 - i.x0;
  const float3 motion = (j.x1 - i.x1) - start;
  // Powers of two bring position and motion to size 1, each by its own, so that nothing leaves float32.
  const float unit = collision::to_unit(fmaxf(collision::largest_coordinate(start), d));
  const float unit_q = collision::to_unit(collision::largest_coordinate(motion));
  const float3 p = {unit * start.x, unit * start.y, unit * start.z};
  const float3 q = {unit_q * motion.x, unit_q * motion.y, unit_q * motion.z};
  const float r = unit * d, pp = collision::dot(p, p), rr = r * r;
  if (pp <= rr) return 0.0f;
  const float b = collision::dot(p, q);
  if (!(b < 0.0f)) return 1.0f;
  const float qq = collision::dot(q, q), closest = -b / qq;
  const float3 m = {p.x + closest * q.x, p.y + closest * q.y, p.z + closest * q.z};
  const float mm = collision::dot(m, m);
  if (mm > rr) return 1.0f;
  // The smaller root of |p + t q| = r, in a form without cancellation.
  const float length = sqrtf(pp);
  const float t = (length - r) * (length + r) / (sqrtf(qq * (rr - mm)) - b) * (unit_q / unit);
  return fminf(t, 1.0f);
}

__global__ void __launch_bounds__(32 * kWarps, kResidentWarps / kWarps)
    contacts(const __grid_constant__ collision::SweptScene<1> s, float* toi) {
  __shared__ collision::Grid grid;
  if (threadIdx.x == 0) grid = s.grid();
  __syncthreads();
  const int warp = static_cast<int>(blockIdx.x) * kWarps + static_cast<int>(threadIdx.x) / 32;
  const auto meet = [&](bool hit, const MovingVertex& own, const collision::SweptRecord& record) {
    if (!hit) return;
    const MovingVertex other = collision::vertex_of(record);
    if (other.number == own.number) return;
    const float t = first_contact(own, other, s.margin);
    if (t < 1.0f) collision::record_time(toi, own.number, t);
  };
  collision::visit_swept_pairs(s, grid, warp, static_cast<int>(gridDim.x) * kWarps, meet);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    pairs_ = collision::SweptPairs<1>(in.x0.shape[0], 0);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto scene = pairs_.build(in.x0.data, in.x1.data, nullptr, in.d, 0.0f, out.toi.data);
    contacts<<<pairs_.visit_blocks(kWarps, kResidentWarps), 32 * kWarps>>>(scene, out.toi.data);
  }

 private:
  collision::SweptPairs<1> pairs_;
};

}  // namespace
}  // namespace gpuphys::ccd_vv

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(ccd_vv, ccd_vv::Reference)
}
