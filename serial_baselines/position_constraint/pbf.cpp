// Serial baseline of pbf, written from cases/position_constraint/pbf.md and the pages it names alone. Built
// as FP64 truth and as FP32 variants (Real).
#include "cases/position_constraint/pbf.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/fluid.hpp"

namespace gpuphys::pbf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    serial::Fluid<Real> fluid(in.x, in.h);
    const Real dt = in.dt;
    const serial::Vec<Real> gravity{in.gx, in.gy, in.gz};
    serial::Field<Real> v = fluid.template gather<Real>(in.v);
    for (std::size_t i = 0; i < v.size(); ++i) {
      serial::add(v[i], dt, gravity);
      serial::add(fluid.shift[i], dt, v[i]);
    }
    serial::solve_constraint<Real>(fluid, {in.rho0, in.eps, in.k_corr, in.dq, in.iters});
    fluid.scatter(out.x_new, fluid.start(), fluid.shift);

    for (std::size_t i = 0; i < v.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) v[i][c] = fluid.shift[i][c] / dt;
    }
    const serial::NeighbourLists lists = fluid.neighbours();
    const auto confined = serial::confinement(fluid, lists, v, static_cast<Real>(in.vort_eps), dt);
    for (std::size_t i = 0; i < v.size(); ++i) serial::add(v[i], Real(1), confined[i]);
    fluid.scatter(out.v_new, v, serial::viscosity(fluid, lists, v, static_cast<Real>(in.c_visc)));
  }
};

}  // namespace gpuphys::pbf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(pbf, pbf::Baseline)
}
