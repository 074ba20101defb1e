// Time loop of mc_r: a vortex in a closed box, whatever module does the steps.
#pragma once

#include <numbers>
#include <string>

#include "tests/mac_fluid.hpp"

namespace gpuphys::testing {

/// One vortex that fills a closed box of 16 x 16 x 3 cells, a steady flow of an inviscid fluid.
inline Problem closed_vortex(const std::string& task, std::vector<std::pair<std::string, double>> scalars) {
  const mac_fluid::Extents n{16, 16, 3};
  Problem p = fluid_at_rest(task, n, mac_fluid::all_open(), scalars);
  const double pi = std::numbers::pi;
  mac_fluid::set_velocity(p, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t) {
    const auto x = static_cast<double>(i), y = static_cast<double>(j);
    if (axis == 0) return std::sin(pi * x / 16) * std::cos(pi * (y + 0.5) / 16);
    if (axis == 1) return -std::cos(pi * (x + 0.5) / 16) * std::sin(pi * y / 16);
    return 0.0;
  });
  return p;
}

/// Share of the kinetic energy that is left after 100 steps; it must not grow.
inline double energy_left(const std::string& task, const std::string& label, Problem p) {
  double first = 0, energy = 0;
  for (int step = 0; step < 100; ++step) {
    const Arrays out = run_module(find_task(task), label, p);
    energy = kinetic_energy(p, out);
    if (step == 0) first = energy;
    EXPECT_LE(energy, first * (1 + 1e-3)) << task << ", step " << step;
    feed_velocity(out, p);
  }
  return energy / first;
}

inline void time_loop_mc_r(const std::string& label) {
  const double left =
      energy_left("mc_r", label, closed_vortex("mc_r", {{"dx", 1}, {"dt", 1}, {"tol", 1e-5}}));
  EXPECT_GT(left, 0.9);
}

}  // namespace gpuphys::testing
