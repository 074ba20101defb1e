// Serial baseline of poisson_neumann, from its specification (cases/global_solve/poisson_neumann.md).
//
// Which x is meant when A is only nearly singular (float32 diagonals leave row sums of one rounding): the one
// with zero mean whose residual is constant over the active cells, that is A restricted to the vectors
// without mean.
#include "cases/global_solve/poisson_neumann.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/seven_point_system.hpp"

namespace gpuphys::poisson_neumann {
namespace {

namespace base = seven_point_baseline;

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    base::solve_on_active_cells(in, out, base::NullSpace::constants);

    // The representative with zero mean over the active cells.
    const auto each = [&](auto&& body) {
      for (std::int64_t c = 0; c < out.x.size(); ++c) {
        if (in.is_dof.data[c]) body(out.x.data[c]);
      }
    };
    base::Vector<Real> x;
    each([&](Real v) { x.push_back(v); });
    const Real mean = base::mean_of(x);
    each([&](Real& v) { v -= mean; });
  }
};

}  // namespace

GPUPHYS_BASELINE_MODULE(poisson_neumann, Baseline)

}  // namespace gpuphys::poisson_neumann
