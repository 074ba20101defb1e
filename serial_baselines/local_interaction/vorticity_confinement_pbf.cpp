// Serial baseline of vorticity_confinement_pbf, written from
// cases/local_interaction/vorticity_confinement_pbf.md and cases/position_constraint/fluid.md alone. Built as
// FP64 truth and as FP32 variants (Real).
#include "cases/local_interaction/vorticity_confinement_pbf.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/fluid.hpp"

namespace gpuphys::vorticity_confinement_pbf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::Fluid<Real> fluid(in.x, in.h);
    const serial::Field<Real> v = fluid.template gather<Real>(in.v);
    const auto change = serial::confinement(fluid, fluid.neighbours(), v, static_cast<Real>(in.epsilon),
                                            static_cast<Real>(in.dt));
    fluid.scatter(out.v_new, v, change);
  }
};

}  // namespace gpuphys::vorticity_confinement_pbf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(vorticity_confinement_pbf, vorticity_confinement_pbf::Baseline)
}
