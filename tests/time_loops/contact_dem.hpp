// A granular gas stepped with the contact forces of a module: what must hold for any correct one.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <numeric>
#include <string>
#include <vector>

#include "cases/local_interaction/contact_dem.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Kinetic and elastic energy, momentum and angular momentum of grains of density 1 kg/m^3.
struct GrainTotals {
  double kinetic = 0, elastic = 0;
  std::array<double, 3> momentum{}, angular{};
  double momentum_scale = 0, angular_scale = 0;  ///< sums of the sizes of the terms
};

inline double grain_mass(double radius) {
  return 4.0 / 3.0 * std::numbers::pi * radius * radius * radius;
}

inline GrainTotals grain_totals(const Problem& p) {
  const auto in = bind_inputs<contact_dem::Inputs>(p);
  const std::int64_t n = in.radius.shape[0];
  GrainTotals t;
  double largest = 0;
  const auto length = [](const std::array<double, 3>& a) { return std::hypot(a[0], a[1], a[2]); };
  for (std::int64_t i = 0; i < n; ++i) {
    const double m = grain_mass(in.radius(i));
    std::array<double, 3> x, v;
    for (std::size_t c = 0; c < 3; ++c) {
      x[c] = in.x(i, c);
      v[c] = in.v(i, c);
    }
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t d = (c + 1) % 3, e = (c + 2) % 3;
      t.kinetic += 0.5 * m * v[c] * v[c];
      t.momentum[c] += m * v[c];
      t.angular[c] += m * (x[d] * v[e] - x[e] * v[d]);
    }
    t.momentum_scale += m * length(v);
    t.angular_scale += m * length(x) * length(v);
    largest = std::max(largest, static_cast<double>(in.radius(i)));
  }
  // Contacts by a sweep along x. Elastic energy: the force kn sqrt(r*) overlap^1.5, integrated.
  std::vector<std::int64_t> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), std::int64_t{0});
  std::sort(order.begin(), order.end(), [&](auto a, auto b) { return in.x(a, 0) < in.x(b, 0); });
  for (std::size_t a = 0; a < order.size(); ++a) {
    for (std::size_t b = a + 1; b < order.size(); ++b) {
      const std::int64_t i = order[a], j = order[b];
      std::array<double, 3> d;
      for (std::size_t c = 0; c < 3; ++c) {
        d[c] = static_cast<double>(in.x(i, c)) - static_cast<double>(in.x(j, c));
      }
      if (-d[0] > 2 * largest) break;
      const double ri = in.radius(i), rj = in.radius(j), overlap = ri + rj - length(d);
      if (overlap > 0) {
        t.elastic +=
            0.4 * static_cast<double>(in.kn) * std::sqrt(ri * rj / (ri + rj)) * std::pow(overlap, 2.5);
      }
    }
  }
  return t;
}

/// 100 steps of symplectic Euler: momentum and angular momentum are conserved to rounding, energy only falls.
inline void time_loop_contact_dem(const std::string& label) {
  constexpr int steps = 100;
  constexpr double dt = 0.005;  // a fiftieth of the duration of a contact
  const Task& task = find_task("contact_dem");
  Problem p = task.set("public_smoke").make();
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), radius = p.inputs[2].as<float>();
  const GrainTotals before = grain_totals(p);
  double earlier = before.kinetic + before.elastic;
  for (int step = 1; step <= steps; ++step) {
    const Arrays out = run_module(task, label, p);
    for (std::size_t a = 0; a < x.size(); ++a) {
      const double force = out[0].value(static_cast<std::int64_t>(a));
      ASSERT_TRUE(std::isfinite(force)) << "step " << step;
      v[a] = static_cast<float>(static_cast<double>(v[a]) + dt * force / grain_mass(radius[a / 3]));
      x[a] = static_cast<float>(static_cast<double>(x[a]) + dt * static_cast<double>(v[a]));
    }
    if (step % 10 != 0) continue;
    const GrainTotals now = grain_totals(p);
    const double energy = now.kinetic + now.elastic;
    EXPECT_LE(energy, earlier * (1 + 1e-3)) << "step " << step;
    earlier = energy;
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(now.momentum[c], before.momentum[c], 1e-6 * before.momentum_scale) << "step " << step;
      EXPECT_NEAR(now.angular[c], before.angular[c], 1e-6 * before.angular_scale) << "step " << step;
    }
  }
  // The overlapping packing pushes itself apart: its elastic energy becomes motion, less what damping takes.
  const GrainTotals after = grain_totals(p);
  EXPECT_LT(after.elastic, 0.5 * before.elastic);
  EXPECT_GT(after.kinetic, before.kinetic);
  EXPECT_LT(after.kinetic + after.elastic, 0.95 * (before.kinetic + before.elastic));
}

}  // namespace gpuphys::testing
