// Serial baseline of poisson_dirichlet, from its specification (cases/global_solve/poisson_dirichlet.md): the
// faces at which x is held at zero are in a_diag, so the equations of the active cells are all there is.
#include "cases/global_solve/poisson_dirichlet.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/seven_point_system.hpp"

namespace gpuphys::poisson_dirichlet {
namespace {

namespace base = seven_point_baseline;

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    base::solve_on_active_cells(in, out, base::NullSpace::nothing);
  }
};

}  // namespace

GPUPHYS_BASELINE_MODULE(poisson_dirichlet, Baseline)

}  // namespace gpuphys::poisson_dirichlet
