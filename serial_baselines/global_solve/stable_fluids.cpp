// Serial baseline of stable_fluids, written from cases/global_solve/stable_fluids.md alone: advection,
// viscosity, projection. Built as FP64 truth and as FP32 variants (Real).
#include "cases/global_solve/stable_fluids.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/mac_fluid.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::stable_fluids {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::OpenFractions w{in.wx, in.wy, in.wz};
    const Real dx = static_cast<Real>(in.dx), dt = static_cast<Real>(in.dt), tol = static_cast<Real>(in.tol);

    serial::FaceStorage<Real> advected(w);
    const serial::MacField<Real> velocity{in.ux, in.uy, in.uz};
    serial::fill_faces<Real>(advected.field(), [&](int c, const serial::Point<Real>& face) {
      return velocity.component(c, serial::midpoint_departure(velocity, face, dt / dx));
    });
    serial::close_faces(w, advected.field());

    const serial::FaceField<Real> u{out.ux, out.uy, out.uz};
    serial::apply_viscosity<Real>(w, static_cast<Real>(in.nu) * dt / (dx * dx), tol, advected.samples(), u);
    serial::project(w, tol, u);
  }
};

}  // namespace gpuphys::stable_fluids

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(stable_fluids, stable_fluids::Baseline)
}
