// Serial baseline of viscosity_pbf, written from cases/local_interaction/viscosity_pbf.md and
// cases/position_constraint/fluid.md alone. Built as FP64 truth and as FP32 variants (Real).
#include "cases/local_interaction/viscosity_pbf.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/fluid.hpp"

namespace gpuphys::viscosity_pbf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::Fluid<Real> fluid(in.x, in.h);
    const serial::Field<Real> v = fluid.template gather<Real>(in.v);
    const auto change = serial::viscosity(fluid, fluid.neighbours(), v, static_cast<Real>(in.c));
    fluid.scatter(out.v_new, v, change);
  }
};

}  // namespace gpuphys::viscosity_pbf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(viscosity_pbf, viscosity_pbf::Baseline)
}
