// A column of fluid that collapses in a box, stepped by a module: what must hold for any correct one.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>

#include "cases/position_constraint/fluid_inputs.hpp"
#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// 100 steps of 0.1 s from a column 12 m high: it spreads over the floor, densities stay near the rest
/// density, energy is lost.
inline void time_loop_pbf(const std::string& label) {
  constexpr int steps = 100;
  constexpr double gravity = 1, rest = 1.009775;
  constexpr std::array<double, 3> box{20, 6, 1e9};  // metres; the column stands at x = 0
  const Task& task = find_task("pbf");
  Problem p = fluid::problem_of(
      task.contract, fluid::block({.lattice = {8, 7, 12}, .seed = 7, .corner = {0, 0, 0}, .jitter = 0.1}));
  for (const auto& [name, value] :
       std::initializer_list<std::pair<const char*, double>>{{"h", 2},
                                                             {"rho0", rest},
                                                             {"eps", 0.5},
                                                             {"k_corr", 0.01},
                                                             {"dq", 0.3},
                                                             {"iters", 5},
                                                             {"dt", 0.1},
                                                             {"gz", -gravity},
                                                             {"c_visc", 0.05},
                                                             {"vort_eps", 0.01}}) {
    p.set_scalar(name, value);
  }
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>();
  const std::size_t n = x.size() / 3;
  const auto mean_height = [&] {
    double height = 0;
    for (std::size_t i = 0; i < n; ++i) height += static_cast<double>(x[3 * i + 2]);
    return height / static_cast<double>(n);
  };
  const auto kinetic = [&] {
    double energy = 0;
    for (const float a : v) energy += 0.5 * static_cast<double>(a) * static_cast<double>(a);
    return energy / static_cast<double>(n);
  };
  const double height_before = mean_height();
  for (int step = 1; step <= steps; ++step) {
    const Arrays out = run_module(task, label, p);
    for (std::size_t k = 0; k < x.size(); ++k) {
      const double at = out[0].value(static_cast<std::int64_t>(k));
      const double speed = out[1].value(static_cast<std::int64_t>(k));
      ASSERT_TRUE(std::isfinite(at) && std::isfinite(speed)) << "step " << step;
      // Walls, a little uneven, so that particles do not meet in a point.
      const double uneven = 0.05 * uniform01(8, 0, k);
      const double inside = std::clamp(at, uneven, box[k % 3] - uneven);
      x[k] = static_cast<float>(inside);
      v[k] = inside == at ? static_cast<float>(speed) : 0.0f;
      EXPECT_LT(std::abs(speed), 2 * std::sqrt(2 * gravity * 12)) << "step " << step;
    }
    if (step % 20 != 0) continue;
    double densest = 0;
    for (std::size_t i = 0; i < n; ++i) {
      double rho = 0;
      for (std::size_t j = 0; j < n; ++j) {
        double square = 0;
        for (std::size_t c = 0; c < 3; ++c) {
          const double d = static_cast<double>(x[3 * i + c]) - static_cast<double>(x[3 * j + c]);
          square += d * d;
        }
        if (square < 4) rho += 315 / (64 * std::numbers::pi * 8) * std::pow(1 - square / 4, 3);
      }
      densest = std::max(densest, rho);
    }
    EXPECT_LT(densest, 2 * rest) << "step " << step;
    EXPECT_LT(kinetic() + gravity * mean_height(), gravity * height_before * 1.02) << "step " << step;
  }
  double reached = 0;
  for (std::size_t i = 0; i < n; ++i) reached = std::max(reached, static_cast<double>(x[3 * i]));
  EXPECT_GT(reached, 15);                          // from 7: the column has run along the floor
  EXPECT_LT(mean_height(), 0.55 * height_before);  // and is lower
}

}  // namespace gpuphys::testing
