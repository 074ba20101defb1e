// Serial baseline of solve_constraint_xpbd, written from cases/position_constraint/solve_constraint_xpbd.md
// alone: one spring at a time, in input order. Built as FP64 truth and as FP32 variants (Real).
//
// Positions are held as the input plus a displacement, so that the FP32 builds keep their digits; for FP64
// that is harmless.
#include "cases/position_constraint/solve_constraint_xpbd.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/contract/module.hpp"

namespace gpuphys::solve_constraint_xpbd {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x.shape[0];
    const std::int64_t m = in.rest.shape[0];
    const Real dt = static_cast<Real>(in.dt);
    const Real alpha = static_cast<Real>(in.compliance) / (dt * dt);

    std::vector<std::int64_t> valence(static_cast<std::size_t>(n), 0);
    for (std::int64_t j = 0; j < m; ++j) {
      const std::int32_t a = in.springs(j, 0), b = in.springs(j, 1);
      if (a == b) continue;
      ++valence[static_cast<std::size_t>(a)];
      ++valence[static_cast<std::size_t>(b)];
    }

    std::vector<Real> lambda(static_cast<std::size_t>(m), Real(0));
    std::vector<std::array<Real, 3>> now(static_cast<std::size_t>(n), {Real(0), Real(0), Real(0)});
    std::vector<std::array<Real, 3>> next = now;
    for (std::int32_t k = 0; k < in.iters; ++k) {
      next = now;
      for (std::int64_t j = 0; j < m; ++j) project(in, j, alpha, valence, now, next, lambda);
      std::swap(now, next);
    }

    for (std::int64_t i = 0; i < n; ++i) {
      for (int d = 0; d < 3; ++d) {
        const Real moved = now[static_cast<std::size_t>(i)][static_cast<std::size_t>(d)];
        out.x_new(i, d) = static_cast<Real>(in.x(i, d)) + moved;
      }
    }
  }

 private:
  // Adds to `next` what spring j does to its two ends at the displacements `now`.
  static void project(const Inputs& in, std::int64_t j, Real alpha, const std::vector<std::int64_t>& valence,
                      const std::vector<std::array<Real, 3>>& now, std::vector<std::array<Real, 3>>& next,
                      std::vector<Real>& lambda) {
    const std::int32_t a = in.springs(j, 0), b = in.springs(j, 1);
    const auto ia = static_cast<std::size_t>(a), ib = static_cast<std::size_t>(b);
    if (a == b) return;
    const Real wa = static_cast<Real>(in.inv_mass(a)), wb = static_cast<Real>(in.inv_mass(b));
    if (wa + wb == 0) return;

    std::array<Real, 3> d;
    for (std::size_t c = 0; c < 3; ++c) {
      d[c] = (static_cast<Real>(in.x(a, c)) - static_cast<Real>(in.x(b, c))) + (now[ia][c] - now[ib][c]);
    }
    const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    if (length == 0) return;

    const Real violation = length - static_cast<Real>(in.rest(j));
    Real& multiplier = lambda[static_cast<std::size_t>(j)];
    const Real full_step = -(violation + alpha * multiplier) / (wa + wb + alpha);
    const Real step = full_step / static_cast<Real>(std::max(valence[ia], valence[ib]));
    multiplier += step;
    for (std::size_t c = 0; c < 3; ++c) {
      const Real normal = d[c] / length;
      next[ia][c] += wa * step * normal;
      next[ib][c] -= wb * step * normal;
    }
  }
};

}  // namespace gpuphys::solve_constraint_xpbd

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(solve_constraint_xpbd, solve_constraint_xpbd::Baseline)
}
