// A hundred steps of a swinging cloth with solve_constraint_xpbd as its only solver.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "cases/position_constraint/solve_constraint_xpbd.hpp"
#include "cases/position_constraint/spring_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Steps a rolled cloth in free flight, x* = x + dt v, x' = projection of x*, v = (x' - x) / dt, and expects
/// that momentum stays, that energy does not grow, and that no spring is stretched beyond reason.
inline void time_loop_solve_constraint_xpbd(const std::string& label) {
  namespace pc = position_constraint;
  constexpr double dt = 0.1, compliance = 0.005;
  constexpr int steps = 100;
  const Task& task = find_task("solve_constraint_xpbd");

  pc::RolledCloth parameters;
  parameters.rows = 61;
  parameters.columns = 47;
  parameters.free_side = 3;
  parameters.periods = 1;
  parameters.speed = 0.5;
  pc::Cloth cloth = pc::make_rolled_cloth(parameters);
  const std::size_t n = cloth.position.size();

  Problem problem = make_problem(task.contract, {{"n", static_cast<std::int64_t>(n)},
                                                 {"m", static_cast<std::int64_t>(cloth.springs.size())}});
  problem.set_scalar("compliance", compliance);
  problem.set_scalar("dt", dt);
  problem.set_scalar("iters", 8);

  const auto momentum = [&] {
    std::array<double, 3> sum{0, 0, 0};
    for (const auto& v : cloth.velocity) {
      for (std::size_t d = 0; d < 3; ++d) sum[d] += v[d] / static_cast<double>(n);
    }
    return sum;
  };
  // Kinetic energy, J, and the largest relative change of a length.
  const auto energy_and_strain = [&] {
    double energy = 0, strain = 0;
    for (const auto& v : cloth.velocity) energy += 0.5 * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (std::size_t j = 0; j < cloth.springs.size(); ++j) {
      const auto& a = cloth.position[static_cast<std::size_t>(cloth.springs[j][0])];
      const auto& b = cloth.position[static_cast<std::size_t>(cloth.springs[j][1])];
      const double c = std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]) - cloth.rest[j];
      strain = std::max(strain, std::abs(c) / cloth.rest[j]);
    }
    return std::array<double, 2>{energy, strain};
  };

  const std::array<double, 3> momentum_before = momentum();
  const double energy_before = energy_and_strain()[0];
  for (int step = 0; step < steps; ++step) {
    pc::SpringSystem predicted{cloth.position, {}, cloth.springs, cloth.rest};
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) predicted.position[i][d] += dt * cloth.velocity[i][d];
    }
    pc::store(predicted, problem);
    const Arrays outputs = run_module(task, label, problem);
    const HostArray& moved = find(outputs, "x_new", "outputs");
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        const double x = moved.value(static_cast<std::int64_t>(3 * i + d));
        ASSERT_TRUE(std::isfinite(x)) << "step " << step << ", particle " << i;
        cloth.velocity[i][d] = (x - cloth.position[i][d]) / dt;
        cloth.position[i][d] = x;
      }
    }
    const auto [energy, strain] = energy_and_strain();
    ASSERT_LT(energy, 1.05 * energy_before) << "step " << step;
    ASSERT_LT(strain, 0.5) << "step " << step;
  }
  // Float32 positions of up to 80 m leave 4e-6 m, 4e-5 m/s a step and particle, of either sign.
  for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(momentum()[d], momentum_before[d], 1e-4);
}

}  // namespace gpuphys::testing
