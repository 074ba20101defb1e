// Newton's method for the implicit elastic steps of the serial baselines: truncated conjugate gradients, and
// a line search on the energy that a step minimises.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "serial_baselines/global_solve/projective_dynamics.hpp"

namespace gpuphys::serial {

/// Minimises |u - dt v|^2_M / 2 + dt^2 E(x + u) from u = dt v until the gradient, at float32 positions, is
/// `tol` of what it was. `Elastic` has, at the displacement u: energy(u) (infinite where it is not defined),
/// gradient(u), and, after linearise(u), times(p) and diagonal() of the Hessian.
template <class Real, class Inputs, class Elastic>
Vectors<Real> newton(const Inputs& in, Elastic& elastic) {
  const auto n = static_cast<std::size_t>(in.mass.shape[0]);
  const Real dt = in.dt;
  Vectors<Real> target(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      target[i][c] = dt * static_cast<Real>(in.v(static_cast<std::int64_t>(i), c));
  }
  const auto mass = [&](std::size_t i) { return static_cast<Real>(in.mass(static_cast<std::int64_t>(i))); };
  // What x_new can hold.
  const auto rounded = [&](Vectors<Real> u) {
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        const Real x = static_cast<Real>(in.x(static_cast<std::int64_t>(i), c));
        u[i][c] = static_cast<Real>(static_cast<float>(x + u[i][c])) - x;
      }
    }
    return u;
  };
  const auto energy = [&](const Vectors<Real>& u) {
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        const double off = static_cast<double>(u[i][c] - target[i][c]);
        sum += 0.5 * static_cast<double>(mass(i)) * off * off;
      }
    }
    return sum + static_cast<double>(dt) * static_cast<double>(dt) * elastic.energy(u);
  };
  const auto gradient = [&](const Vectors<Real>& u) {
    Vectors<Real> g = elastic.gradient(u);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) g[i][c] = mass(i) * (u[i][c] - target[i][c]) + dt * dt * g[i][c];
    }
    return g;
  };
  const auto norm = [](const Vectors<Real>& a) { return std::sqrt(GlobalMatrix<Real>::dot(a, a)); };

  Vectors<Real> u = rounded(target), g = gradient(target);
  const Real first = norm(g), goal = static_cast<Real>(in.tol) * first;
  if (first == 0) return target;
  g = gradient(u);
  double now = energy(u);
  for (int iteration = 0; norm(g) > Real(0.99) * goal; ++iteration) {
    if (iteration == 100) throw std::runtime_error("Newton's method did not converge in 100 iterations");
    elastic.linearise(u);
    // Conjugate gradients for (M + dt^2 K) step = -g, up to a direction of negative curvature.
    const auto product = [&](const Vectors<Real>& p) {
      Vectors<Real> q = elastic.times(p);
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c) q[i][c] = mass(i) * p[i][c] + dt * dt * q[i][c];
      }
      return q;
    };
    const Vectors<Real> diagonal = elastic.diagonal();
    const auto scaled = [&](const Vectors<Real>& r) {
      Vectors<Real> z(n);
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c)
          z[i][c] = r[i][c] / (mass(i) + dt * dt * std::max(diagonal[i][c], Real(0)));
      }
      return z;
    };
    Vectors<Real> step(n, {0, 0, 0}), r(n), z, p;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) r[i][c] = -g[i][c];
    }
    z = p = scaled(r);
    Real rz = GlobalMatrix<Real>::dot(r, z);
    const Real stop = std::max(Real(0.01) * norm(g), Real(0.2) * goal);
    for (int k = 0; k < 10000 && norm(r) > stop; ++k) {
      const Vectors<Real> q = product(p);
      const Real curvature = GlobalMatrix<Real>::dot(p, q);
      if (!(curvature > 0)) {
        if (k == 0) step = p;
        break;
      }
      const Real alpha = rz / curvature;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c) {
          step[i][c] += alpha * p[i][c];
          r[i][c] -= alpha * q[i][c];
        }
      }
      z = scaled(r);
      const Real earlier = rz;
      rz = GlobalMatrix<Real>::dot(r, z);
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c) p[i][c] = z[i][c] + rz / earlier * p[i][c];
      }
    }
    // Half the step again and again until the energy falls, to rounding.
    Real length = 1;
    for (;; length /= 2) {
      if (length < Real(1e-6)) throw std::runtime_error("Newton's line search found no lower energy");
      Vectors<Real> there = u;
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c) there[i][c] += length * step[i][c];
      }
      there = rounded(there);
      const double lower = energy(there);
      if (!(lower <= now + 1e-6 * std::abs(now))) continue;
      u = there;
      now = lower;
      break;
    }
    g = gradient(u);
  }
  return u;
}

/// x_new = x + u rounded to float32, and v_new = (x_new - x) / dt of that.
template <class Real, class Inputs, class Outputs>
void write_step(const Inputs& in, const Vectors<Real>& u, const Outputs& out) {
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const Real x = static_cast<Real>(in.x(i, c));
      const Real moved = static_cast<Real>(static_cast<float>(x + u[static_cast<std::size_t>(i)][c]));
      out.x_new(i, c) = moved;
      out.v_new(i, c) = (moved - x) / static_cast<Real>(in.dt);
    }
  }
}

}  // namespace gpuphys::serial
