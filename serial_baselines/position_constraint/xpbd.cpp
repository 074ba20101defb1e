// Serial baseline of xpbd, written from cases/position_constraint/xpbd.md alone: the contacts once, then one
// spring and one contact at a time. Built as FP64 truth and as FP32 variants (Real).
//
// Positions are held as the input plus a displacement, so that the FP32 builds keep their digits; for FP64
// that is harmless.
#include "cases/position_constraint/xpbd.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/contact_list.hpp"

namespace gpuphys::xpbd {

template <class Real>
class Baseline {
  using Vector = std::array<Real, 3>;

 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x.shape[0], m = in.rest.shape[0];
    const Real dt = static_cast<Real>(in.dt);

    // Prediction; pinned particles stay.
    serial::Vectors<Real> now(static_cast<std::size_t>(n), {Real(0), Real(0), Real(0)});
    serial::Vectors<double> rough(static_cast<std::size_t>(n));
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        Real& moved = now[static_cast<std::size_t>(i)][d];
        if (in.inv_mass(i) > 0) moved = dt * static_cast<Real>(in.v(i, d));
        rough[static_cast<std::size_t>(i)][d] = static_cast<double>(in.x(i, d)) + static_cast<double>(moved);
      }
    }
    const auto pairs =
        serial::pairs_within(rough, static_cast<Real>(in.search_radius),
                             [&](std::int32_t i, std::int32_t j) { return apart(in, now, i, j); });

    std::vector<std::int64_t> valence(static_cast<std::size_t>(n), 0);
    for (std::int64_t s = 0; s < m; ++s) {
      if (in.springs(s, 0) == in.springs(s, 1)) continue;
      for (int end = 0; end < 2; ++end) ++valence[static_cast<std::size_t>(in.springs(s, end))];
    }
    const Real spring_alpha = static_cast<Real>(in.spring_compliance) / (dt * dt);
    const serial::ContactLaw<Real> law{static_cast<Real>(in.thickness),
                                       static_cast<Real>(in.contact_compliance) / (dt * dt),
                                       static_cast<Real>(in.relaxation)};
    std::vector<Real> of_spring(static_cast<std::size_t>(m), Real(0)), of_contact(pairs.size(), Real(0));
    for (std::int32_t k = 0; k < in.iters; ++k) {
      serial::Vectors<Real> next = now;
      const auto add = [&](std::int32_t i, std::int32_t j, const Vector& move) {
        for (std::size_t c = 0; c < 3; ++c) {
          next[static_cast<std::size_t>(i)][c] += static_cast<Real>(in.inv_mass(i)) * move[c];
          next[static_cast<std::size_t>(j)][c] -= static_cast<Real>(in.inv_mass(j)) * move[c];
        }
      };
      for (std::int64_t s = 0; s < m; ++s) {
        const std::int32_t a = in.springs(s, 0), b = in.springs(s, 1);
        if (a == b) continue;
        const std::int64_t shared =
            std::max(valence[static_cast<std::size_t>(a)], valence[static_cast<std::size_t>(b)]);
        add(a, b,
            pull(apart(in, now, a, b), static_cast<Real>(in.rest(s)), spring_alpha, inv_mass_sum(in, a, b),
                 static_cast<Real>(shared), of_spring[static_cast<std::size_t>(s)]));
      }
      for (std::size_t p = 0; p < pairs.size(); ++p) {
        const auto [i, j] = pairs[p];
        add(i, j, law.advance(apart(in, now, i, j), inv_mass_sum(in, i, j), of_contact[p]));
      }
      now = next;
    }
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        const Real moved = now[static_cast<std::size_t>(i)][d];
        out.x_new(i, d) = static_cast<Real>(in.x(i, d)) + moved;
        out.v_new(i, d) = moved / dt;
      }
    }
  }

 private:
  static Real inv_mass_sum(const Inputs& in, std::int32_t i, std::int32_t j) {
    return static_cast<Real>(in.inv_mass(i)) + static_cast<Real>(in.inv_mass(j));
  }

  // Particle i seen from j.
  static Vector apart(const Inputs& in, const serial::Vectors<Real>& moved, std::int32_t i, std::int32_t j) {
    Vector d;
    for (std::size_t c = 0; c < 3; ++c) {
      d[c] = (static_cast<Real>(in.x(i, c)) - static_cast<Real>(in.x(j, c))) +
             (moved[static_cast<std::size_t>(i)][c] - moved[static_cast<std::size_t>(j)][c]);
    }
    return d;
  }

  // By what a spring moves its first end for w = 1 (the second one by the opposite); advances its multiplier.
  static Vector pull(const Vector& d, Real rest, Real alpha, Real inv_mass_sum, Real valence,
                     Real& multiplier) {
    const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    if (length == 0 || inv_mass_sum == 0) return {0, 0, 0};
    const Real step = -(length - rest + alpha * multiplier) / (inv_mass_sum + alpha) / valence;
    multiplier += step;
    return {step * (d[0] / length), step * (d[1] / length), step * (d[2] / length)};
  }
};

}  // namespace gpuphys::xpbd

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(xpbd, xpbd::Baseline)
}
