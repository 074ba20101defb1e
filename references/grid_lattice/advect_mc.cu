//
#include "cases/grid_lattice/advect_mc.hpp"
#include "references/common/device_buffer.cuh"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_mc {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
using Policy = mac::March<32, 2, 3, 8>;
#else
using Policy = mac::March<32, 4, 4, 8>;
#endif

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
  const float* __restrict__ input[3];
  const float* __restrict__ predicted[3];
  const float2* __restrict__ bounds[3];
  float* __restrict__ u[3];

  template <class Face>
  __device__ __forceinline__ float update(const Face& face) const {
    constexpr int c = Face::component;
    const int at = face.offset();
    const float returned = face.own_of(predicted[c] + at, forward.departure(face)).value();
    const float2 limits = __ldg(bounds[c] + at);
    const float corrected = __ldg(predicted[c] + at) + 0.5f * (__ldg(input[c] + at) - returned);
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
                              {in.ux.data, in.uy.data, in.uz.data},
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
