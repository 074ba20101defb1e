// Serial baseline of solve_constraint_pbf, written from cases/position_constraint/solve_constraint_pbf.md and
// fluid.md alone. Built as FP64 truth and as FP32 variants (Real).
#include "cases/position_constraint/solve_constraint_pbf.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/fluid.hpp"

namespace gpuphys::solve_constraint_pbf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    serial::Fluid<Real> fluid(in.x, in.h);
    serial::solve_constraint<Real>(fluid, {in.rho0, in.eps, in.k_corr, in.dq, in.iters});
    fluid.scatter(out.x_new, fluid.start(), fluid.shift);
  }
};

}  // namespace gpuphys::solve_constraint_pbf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(solve_constraint_pbf, solve_constraint_pbf::Baseline)
}
