// The checks of the implicit elastic steps that are judged by their residual rather than by comparison.
#pragma once

#include <functional>
#include <vector>

#include "core/judge/checks.hpp"

namespace gpuphys::newton {

/// Gradient, energy and their FP64 arithmetic are the task's: elastic force terms at positions z (3 n
/// numbers).
struct Elastic {
  std::function<void(const Problem&, const std::vector<double>& z, std::vector<double>& gradient)>
      add_gradient;
  std::function<double(const Problem&, const std::vector<double>& z)> energy;  ///< infinite where not defined
};

/// |g(x_new)| / |g(y)|, divided by (tol + slack) / (1e-3 + slack), so that 1e-3 + slack is the tolerance for
/// any tol. With g(y) = 0, |g(x_new)|.
Check residual_check(const Elastic&, double slack);
/// The largest entry of g(x_new) over the rms of g(y), times 1e-3 / tol.
Check local_residual_check(const Elastic&, double tolerance, const std::string& why);
/// The energy of the step at x_new over that at y, 0 where it is not above: a minimum, not any stationary
/// point.
Check energy_check(const Elastic&);
/// Relative L2 error of v_new against (x_new - x) / dt, both as returned.
Check velocity_check(double tolerance);
/// The same, the largest error in units in the last place of v_new.
Check velocity_units_check();
/// Positions of particles without elements in `elements`, in units in the last place off x + dt v.
Check free_particles_check(const std::string& elements);

}  // namespace gpuphys::newton
