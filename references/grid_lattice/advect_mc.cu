// advect_mc: MacCormack self-advection of a MAC-grid velocity, midpoint (RK2) back-tracing, limited, FP32.
//
// Two marches over the faces. The first carries every component along (that is advect_rk2) and keeps, beside
// this prediction, the smallest and the largest of the eight samples around the departure point. The second
// carries the prediction back in time's other direction; half of what it misses of the input corrects the
// prediction, within those bounds.
//
// Mapping: the march of mac_advection.cuh twice, a thread a column of cells along x.
//
// What bounds it: the gathers of two midpoint traces, 107 loads and 706 instructions a cell in the first
// march, 114 and 746 in the second, against 107 and 631 of advect_rk2: 1.336 ms in the suite. What pays:
// the bounds are stored, 8 bytes a face, instead of being found again by a second back-trace, which would be
// another 96 gathers a cell; DRAM moves 202 MB in and 606 out, then 808 in and 202 out (0.43 ms), behind
// them.
#include "cases/grid_lattice/advect_mc.hpp"
#include "references/common/device_buffer.cuh"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_mc {
namespace {

using Policy = mac::TiledMarch<4>;  // another tile under GPUPHYS_OTHER_BLOCKS

// First march: every component carried along, with the bounds of its correction.
struct Predictor {
  mac::MidpointTrace back;
  float* __restrict__ predicted[3];
  float2* __restrict__ bounds[3];

  struct Prediction {
    float value, low, high;
  };
  template <class Face>
  __device__ __forceinline__ Prediction update(const Face& face) const {
    const mac::Stencil s = face.own(back.departure(face));
    return {s.value(), s.smallest(), s.largest()};
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, const Prediction& p) const {
    predicted[Face::component][face.offset()] = p.value;
    bounds[Face::component][face.offset()] = {p.low, p.high};
  }
};

// Second march: the prediction carried forward again; half of what that misses of the input corrects it.
struct Corrector {
  mac::MidpointTrace forward;
  const float* __restrict__ predicted[3];
  const float2* __restrict__ bounds[3];
  float* __restrict__ u[3];

  template <class Face>
  __device__ __forceinline__ float update(const Face& face) const {
    constexpr int c = Face::component;
    const int at = face.offset();
    const float returned = face.own_of(predicted[c] + at, forward.departure(face)).value();
    const float2 limits = __ldg(bounds[c] + at);
    const float corrected = __ldg(predicted[c] + at) + 0.5f * (__ldg(face.cell.at[c]) - returned);
    return fminf(fmaxf(corrected, limits.x), limits.y);
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, float value) const {
    u[Face::component][face.offset()] = value;
  }
};

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    mac::require_supported(in.ux, in.uy, in.uz);
    for (int c = 0; c < 3; ++c) {
      const View<const float, 3>& u = c == 0 ? in.ux : c == 1 ? in.uy : in.uz;
      predicted_[c] = DeviceBuffer<float>(static_cast<std::size_t>(u.size()));
      bounds_[c] = DeviceBuffer<float2>(static_cast<std::size_t>(u.size()));
    }
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const mac::Velocity v = mac::make_velocity(in.ux, in.uy, in.uz);
    const float step = in.dt / in.dx;
    const Predictor predictor{mac::MidpointTrace{-step},
                              {predicted_[0].get(), predicted_[1].get(), predicted_[2].get()},
                              {bounds_[0].get(), bounds_[1].get(), bounds_[2].get()}};
    mac::launch_march<Policy>(v, predictor);
    const Corrector corrector{mac::MidpointTrace{step},
                              {predicted_[0].get(), predicted_[1].get(), predicted_[2].get()},
                              {bounds_[0].get(), bounds_[1].get(), bounds_[2].get()},
                              {out.ux.data, out.uy.data, out.uz.data}};
    mac::launch_march<Policy>(v, corrector);
  }

 private:
  DeviceBuffer<float> predicted_[3];
  DeviceBuffer<float2> bounds_[3];
};

}  // namespace
}  // namespace gpuphys::advect_mc

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_mc, advect_mc::Reference)
}
