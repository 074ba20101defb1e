// A granular gas stepped with the contact forces of a module: what must hold for any correct one.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <string>

#include "cases/local_interaction/contact_dem.hpp"
#include "tests/grain_energy.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Kinetic and elastic energy, momentum and angular momentum of grains of density 1 kg/m^3.
struct GrainTotals {
  double kinetic = 0, elastic = 0;
  std::array<double, 3> momentum{}, angular{};
  double momentum_scale = 0, angular_scale = 0;  ///< sums of the sizes of the terms
};

inline GrainTotals grain_totals(const Problem& p) {
  const auto in = bind_inputs<contact_dem::Inputs>(p);
  const std::int64_t n = in.radius.shape[0];
  GrainTotals t;
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
  }
  t.elastic = elastic_energy(in.x, in.radius, in.kn);
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
