// A granular gas stepped by dem: what must hold for any correct module.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <string>

#include "cases/local_interaction/dem.hpp"
#include "tests/grain_energy.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Energies, momentum and angular momentum (about the origin, spins included) of a state of dem.
struct DemTotals {
  double moving = 0, turning = 0, elastic = 0;
  std::array<double, 3> momentum{}, angular{};
  double momentum_scale = 0, angular_scale = 0;  ///< sums of the sizes of the terms
  double energy() const { return moving + turning + elastic; }
};

inline DemTotals dem_totals(const Problem& p) {
  const auto in = bind_inputs<dem::Inputs>(p);
  DemTotals t;
  for (std::int64_t i = 0; i < in.radius.shape[0]; ++i) {
    const double r = in.radius(i), m = grain_mass(r, in.rho), inertia = 0.4 * m * r * r;
    std::array<double, 3> x, v, omega;
    for (std::size_t c = 0; c < 3; ++c) x[c] = in.x(i, c), v[c] = in.v(i, c), omega[c] = in.omega(i, c);
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t d = (c + 1) % 3, e = (c + 2) % 3;
      t.moving += 0.5 * m * v[c] * v[c];
      t.turning += 0.5 * inertia * omega[c] * omega[c];
      t.momentum[c] += m * v[c];
      t.angular[c] += m * (x[d] * v[e] - x[e] * v[d]) + inertia * omega[c];
    }
    t.momentum_scale += m * std::hypot(v[0], v[1], v[2]);
    t.angular_scale += m * std::hypot(x[0], x[1], x[2]) * std::hypot(v[0], v[1], v[2]) +
                       inertia * std::hypot(omega[0], omega[1], omega[2]);
  }
  t.elastic = elastic_energy(in.x, in.radius, in.kn);
  return t;
}

/// 100 steps: momentum and angular momentum are conserved to rounding, energy only falls, and falls further
/// than without friction.
inline void time_loop_dem(const std::string& label) {
  constexpr int steps = 100;
  const Task& task = find_task("dem");
  Problem p = task.set("public_smoke").make();
  p.set_scalar("dt", 0.005);  // a fiftieth of the duration of a contact
  const DemTotals before = dem_totals(p);
  double earlier = before.energy();
  for (int step = 1; step <= steps; ++step) {
    const Arrays out = run_module(task, label, p);
    for (std::size_t a = 0; a < 3; ++a) {
      const auto state = p.inputs[a].as<float>();
      for (std::size_t k = 0; k < state.size(); ++k) {
        state[k] = static_cast<float>(out[a].value(static_cast<std::int64_t>(k)));
        ASSERT_TRUE(std::isfinite(state[k])) << "step " << step;
      }
    }
    if (step % 10 != 0) continue;
    const DemTotals now = dem_totals(p);
    EXPECT_LE(now.energy(), earlier * (1 + 1e-3)) << "step " << step;
    earlier = now.energy();
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(now.momentum[c], before.momentum[c], 1e-6 * before.momentum_scale) << "step " << step;
      EXPECT_NEAR(now.angular[c], before.angular[c], 1e-6 * before.angular_scale) << "step " << step;
    }
  }
  // The overlapping packing pushes itself apart: its elastic energy becomes motion, less what damping and
  // friction take.
  const DemTotals after = dem_totals(p);
  EXPECT_LT(after.elastic, 0.5 * before.elastic);
  EXPECT_GT(after.moving, before.moving);
  EXPECT_LT(after.energy(), 0.95 * before.energy());
}

}  // namespace gpuphys::testing
