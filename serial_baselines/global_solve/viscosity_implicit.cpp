// Serial baseline of viscosity_implicit, written from cases/global_solve/viscosity_implicit.md alone. Built
// as FP64 truth and as FP32 variants (Real).
#include "cases/global_solve/viscosity_implicit.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/mac_fluid.hpp"

namespace gpuphys::viscosity_implicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const Real dx = static_cast<Real>(in.dx);
    const Real alpha = static_cast<Real>(in.nu) * static_cast<Real>(in.dt) / (dx * dx);
    serial::apply_viscosity<Real>({in.wx, in.wy, in.wz}, alpha, static_cast<Real>(in.tol),
                                  std::array{in.ux, in.uy, in.uz}, {out.ux, out.uy, out.uz});
  }
};

}  // namespace gpuphys::viscosity_implicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(viscosity_implicit, viscosity_implicit::Baseline)
}
