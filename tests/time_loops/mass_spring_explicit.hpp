// A lattice of springs stepped by a module: what must hold for any correct one.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "cases/local_interaction/mass_spring_explicit.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

struct SpringTotals {
  double kinetic = 0, elastic = 0;
  std::array<double, 3> momentum{}, angular{};
  double momentum_scale = 0, angular_scale = 0;  ///< sums of the sizes of the terms
};

inline SpringTotals spring_totals(const Problem& p) {
  const auto in = bind_inputs<mass_spring_explicit::Inputs>(p);
  SpringTotals t;
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    std::array<double, 3> x, v;
    for (std::size_t c = 0; c < 3; ++c) {
      x[c] = in.x(i, c);
      v[c] = in.v(i, c);
    }
    const double m = in.mass(i);
    for (std::size_t c = 0; c < 3; ++c) {
      const std::size_t d = (c + 1) % 3, e = (c + 2) % 3;
      t.kinetic += 0.5 * m * v[c] * v[c];
      t.momentum[c] += m * v[c];
      t.angular[c] += m * (x[d] * v[e] - x[e] * v[d]);
    }
    t.momentum_scale += m * std::hypot(v[0], v[1], v[2]);
    t.angular_scale += m * std::hypot(x[0], x[1], x[2]) * std::hypot(v[0], v[1], v[2]);
  }
  for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
    std::array<double, 3> d;
    for (std::size_t c = 0; c < 3; ++c) {
      d[c] = static_cast<double>(in.x(in.springs(j, 0), c)) - static_cast<double>(in.x(in.springs(j, 1), c));
    }
    const double stretch = std::hypot(d[0], d[1], d[2]) - static_cast<double>(in.rest(j));
    t.elastic += 0.5 * static_cast<double>(in.k) * stretch * stretch;
  }
  return t;
}

/// Makes the outputs of a step the inputs of the next. False when one is not finite.
inline bool advance(const Task& task, const std::string& label, Problem& p) {
  const Arrays out = run_module(task, label, p);
  for (HostArray& a : p.inputs) {
    if (a.name() != "x" && a.name() != "v") continue;
    const HostArray& next = find(out, a.name() + "_new", "outputs");
    for (std::int64_t i = 0; i < a.size(); ++i) {
      a.as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(next.value(i));
      if (!std::isfinite(next.value(i))) return false;
    }
  }
  return true;
}

/// 100 steps: momentum and angular momentum stay, energy stays within what symplectic Euler lets it swing.
inline void time_loop_mass_spring_explicit(const std::string& label) {
  const Task& task = find_task("mass_spring_explicit");
  Problem p = task.set("public_smoke").make();
  const SpringTotals before = spring_totals(p);
  double swing = 0;
  for (int step = 1; step <= 100; ++step) {
    ASSERT_TRUE(advance(task, label, p)) << "step " << step;
    if (step % 10 != 0) continue;
    const SpringTotals now = spring_totals(p);
    swing = std::max(swing, std::abs(now.elastic - before.elastic));
    EXPECT_NEAR(now.kinetic + now.elastic, before.kinetic + before.elastic,
                0.03 * (before.kinetic + before.elastic))
        << "step " << step;
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(now.momentum[c], before.momentum[c], 1e-6 * before.momentum_scale) << "step " << step;
      EXPECT_NEAR(now.angular[c], before.angular[c], 1e-6 * before.angular_scale) << "step " << step;
    }
  }
  EXPECT_GT(swing, 0.1 * before.elastic);  // springs and motion exchange energy
}

}  // namespace gpuphys::testing
