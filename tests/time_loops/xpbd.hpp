// Cloth hung up by its corners, and cloth that falls on a sphere, with xpbd as the solver and ccd_vf as the
// witness.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Steps a sheet of side x side particles under gravity: the caller's forces change the velocities before
/// each step, `after` may correct positions and velocities behind it. Expects finite positions, no spring
/// longer than `stretch` times its rest length, and no vertex that passes through a triangle of the sheet,
/// which ccd_vf counts. Returns the final positions.
inline std::vector<float> step_cloth(
    const std::string& label, std::int64_t side, int steps,
    const std::function<bool(std::int64_t, std::int64_t)>& pinned, double height, double stretch,
    const std::function<void(std::span<float> x, std::span<float> v)>& after) {
  constexpr double dt = 1.0 / 64, gravity = 9.8;
  const Task &task = find_task("xpbd"), &query = find_task("ccd_vf");
  const std::vector<std::array<std::int32_t, 2>> springs = position_constraint::sheet_springs(side, side);
  const std::int64_t n = side * side, squares = (side - 1) * (side - 1);
  Problem p = make_problem(task.contract, {{"n", n}, {"m", static_cast<std::int64_t>(springs.size())}});
  Problem passing = make_problem(query.contract, {{"n", n}, {"m", 2 * squares}});
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), w = p.inputs[2].as<float>();
  for (std::int64_t i = 0; i < n; ++i) {
    const auto at = static_cast<std::size_t>(3 * i);
    x[at] = static_cast<float>(i / side) - 0.5f * static_cast<float>(side - 1);
    x[at + 1] = static_cast<float>(i % side) - 0.5f * static_cast<float>(side - 1);
    // Not quite flat, so that folds have somewhere to begin.
    x[at + 2] = static_cast<float>(height) + 0.01f * static_cast<float>((7 * i) % 13);
    w[static_cast<std::size_t>(i)] = pinned(i / side, i % side) ? 0.0f : 1.0f;
  }
  for (std::size_t j = 0; j < springs.size(); ++j) {
    const auto [a, b] = springs[j];
    p.inputs[3].as<std::int32_t>()[2 * j] = a;
    p.inputs[3].as<std::int32_t>()[2 * j + 1] = b;
    p.inputs[4].as<float>()[j] = static_cast<float>(
        std::hypot(static_cast<double>(b / side - a / side), static_cast<double>(b % side - a % side)));
  }
  std::size_t corner = 0;
  for (std::int64_t a = 0; a + 1 < side; ++a) {
    for (std::int64_t b = 0; b + 1 < side; ++b) {
      const auto at = [&](std::int64_t da, std::int64_t db) {
        return static_cast<std::int32_t>((a + da) * side + b + db);
      };
      for (const std::int32_t c : {at(0, 0), at(1, 0), at(1, 1), at(0, 0), at(1, 1), at(0, 1)})
        passing.inputs[2].as<std::int32_t>()[corner++] = c;
    }
  }
  p.set_scalar("dt", dt);
  p.set_scalar("spring_compliance", 1e-6);
  p.set_scalar("contact_compliance", 0);
  p.set_scalar("thickness", 0.8);
  p.set_scalar("search_radius", 0.95);
  p.set_scalar("relaxation", 0.25);
  p.set_scalar("iters", 40);
  double longest = 0;
  for (int step = 0; step < steps; ++step) {
    for (std::size_t i = 0; i < w.size(); ++i) {
      if (w[i] > 0) v[3 * i + 2] -= static_cast<float>(dt * gravity);
    }
    std::copy(x.begin(), x.end(), passing.inputs[0].as<float>().begin());
    const Arrays out = run_module(task, label, p);
    for (std::size_t i = 0; i < x.size(); ++i) {
      x[i] = static_cast<float>(out[0].value(static_cast<std::int64_t>(i)));
      v[i] = static_cast<float>(out[1].value(static_cast<std::int64_t>(i)));
    }
    after(x, v);
    for (const float c : x) {
      if (!std::isfinite(c)) {
        ADD_FAILURE() << "not finite at step " << step;
        return {};
      }
    }
    for (std::size_t j = 0; j < springs.size(); ++j) {
      const auto a = static_cast<std::size_t>(3 * springs[j][0]),
                 b = static_cast<std::size_t>(3 * springs[j][1]);
      const double length = std::hypot(x[a] - x[b], x[a + 1] - x[b + 1], x[a + 2] - x[b + 2]);
      longest = std::max(longest, length / static_cast<double>(p.inputs[4].as<float>()[j]));
    }
    std::copy(x.begin(), x.end(), passing.inputs[1].as<float>().begin());
    const Arrays impacts = run_module(query, label, passing);
    std::int64_t passed = 0;
    for (std::int64_t i = 0; i < n; ++i) passed += impacts[0].value(i) < 1;
    EXPECT_EQ(passed, 0) << "vertices pass through the sheet at step " << step;
    if (passed > 0) return {};
  }
  EXPECT_LT(longest, stretch);
  return {x.begin(), x.end()};
}

/// Both scenes, 300 steps each.
inline void time_loop_xpbd(const std::string& label) {
  constexpr std::int64_t side = 20;
  const std::vector<float> hung = step_cloth(
      label, side, 300, [](std::int64_t a, std::int64_t b) { return a == 0 && (b == 0 || b == side - 1); }, 0,
      1.5,
      [](std::span<float>, std::span<float> v) {
        for (float& c : v) c *= 0.97f;  // air
      });
  if (!hung.empty()) {
    // Pinned corners stay; the opposite side has come to hang far below them.
    EXPECT_EQ(hung[2], 0.0f);
    EXPECT_LT(hung[static_cast<std::size_t>(3 * (side * side - 1) + 2)], -10.0f);
  }
  constexpr float radius = 5;
  const std::vector<float> draped = step_cloth(
      label, side, 300, [](std::int64_t, std::int64_t) { return false; }, radius + 0.5, 1.5,
      [](std::span<float> x, std::span<float> v) {
        // The sphere about the origin, fixed and rough: what has got into it comes back to its surface and
        // sticks.
        for (std::size_t i = 0; i < x.size(); i += 3) {
          const float r = std::hypot(x[i], x[i + 1], x[i + 2]);
          if (r >= radius || r == 0) continue;
          for (std::size_t d = i; d < i + 3; ++d) {
            x[d] *= radius / r;
            v[d] = 0;
          }
        }
      });
  if (!draped.empty()) {
    // Its middle lies on the sphere, its border hangs over.
    const auto middle = static_cast<std::size_t>(3 * (side / 2 * side + side / 2));
    EXPECT_NEAR(std::hypot(draped[middle], draped[middle + 1], draped[middle + 2]), radius, 0.2);
    EXPECT_LT(draped[2], 0.0f);
  }
}

}  // namespace gpuphys::testing
