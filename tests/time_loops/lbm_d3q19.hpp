// Time loops of lbm_d3q19: what a flow must do over many steps of the module.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <string>

#include "cases/grid_lattice/lattice_inputs.hpp"
#include "core/generators/abc_flow.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Mass, momentum and kinetic energy of the whole lattice, and the amplitude of a velocity pattern in it.
struct LatticeTotals {
  double mass = 0, energy = 0, pattern = 0;
  std::array<double, 3> momentum{};
};

inline LatticeTotals lattice_totals(const HostArray& f, const AbcFlow& pattern) {
  const lattice::VelocitySet& s = lattice::velocity_set(static_cast<int>(f.shape()[0]));
  const std::int64_t ny = f.shape()[2], nz = f.shape()[3], cells = f.size() / f.shape()[0];
  LatticeTotals total;
  double norm = 0;
  for (std::int64_t cell = 0; cell < cells; ++cell) {
    double rho = 0;
    std::array<double, 3> j{};
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      const double value = f.value(static_cast<std::int64_t>(q) * cells + cell);
      rho += value;
      for (std::size_t d = 0; d < 3; ++d) j[d] += s.c[q][d] * value;
    }
    const auto u = pattern.at(static_cast<double>(cell / (ny * nz)), static_cast<double>(cell / nz % ny),
                              static_cast<double>(cell % nz));
    total.mass += rho;
    for (std::size_t d = 0; d < 3; ++d) {
      total.momentum[d] += j[d];
      total.energy += 0.5 * j[d] * j[d] / rho;
      total.pattern += j[d] * u[d];
      norm += u[d] * u[d];
    }
  }
  total.pattern /= norm;
  return total;
}

/// The next problem of a time loop: outputs become inputs, rounded to float32 once.
inline void feed_back(const HostArray& out, Problem& p) {
  const auto f = p.inputs[0].as<float>();
  for (std::int64_t i = 0; i < out.size(); ++i)
    f[static_cast<std::size_t>(i)] = static_cast<float>(out.value(i));
}

/// 100 steps of an ABC flow on a cube, an exact solution of the Navier-Stokes equations that only decays, and
/// 200 steps from noisy populations at a viscosity of 1/300 lattice units, which must stay bounded.
inline void time_loop_lbm_d3q19(const std::string& label) {
  const Task& task = find_task("lbm_d3q19");
  const lattice::Step step{19, true, true, task.contract};
  {
    constexpr int n = 22, steps = 100;
    const AbcFlow flow = AbcFlow::periodic(0.05 / 3, 1, {n, n, n});
    Problem p = lattice::problem_from(step, {n, n, n}, [&](auto i, auto j, auto k) {
      return lattice::Macroscopic{
          1.0, flow.at(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k))};
    });
    const LatticeTotals before = lattice_totals(p.inputs[0], flow);
    ASSERT_NEAR(before.pattern, 1, 1e-6);
    for (int t = 0; t < steps; ++t) feed_back(run_module(task, label, p)[0], p);
    const LatticeTotals after = lattice_totals(p.inputs[0], flow);
    // Float32 weights sum to 1 within 2e-8, which a step multiplies by the relaxation rate; the sums of a
    // cell add their rounding.
    EXPECT_NEAR(after.mass / before.mass, 1, 1e-7 * steps);
    for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(after.momentum[d] / before.mass, 0, 1e-6) << "axis " << d;
    // |u| falls as exp(-nu k^2 t); the lattice's own error of second order in k is a few percent of the rate.
    const double k = 2 * std::numbers::pi / n, nu = (lattice::kTauPlus - 0.5) / 3;
    const double rate = -std::log(after.pattern) / steps;
    EXPECT_NEAR(rate / (nu * k * k), 1, 0.03) << "decay rate " << rate;
  }
  {
    Problem p = lattice::flow_problem(step, {18, 14, 22}, {3, 1, 0.05, 0.05, 0.05});
    p.set_scalar("tau_plus", 0.51);
    const AbcFlow flow = AbcFlow::periodic(0.05 / 3, 1, {18, 14, 22});
    const LatticeTotals before = lattice_totals(p.inputs[0], flow);
    for (int t = 0; t < 200; ++t) feed_back(run_module(task, label, p)[0], p);
    const LatticeTotals after = lattice_totals(p.inputs[0], flow);
    EXPECT_NEAR(after.mass / before.mass, 1, 1e-7 * 200);
    for (std::size_t d = 0; d < 3; ++d)
      EXPECT_NEAR((after.momentum[d] - before.momentum[d]) / before.mass, 0, 1e-6) << "axis " << d;
    // No driving: kinetic energy may only be exchanged with the sound waves that the initial density sets
    // off, whose energy c_s^2 (drho)^2 / 2 is of the same order.
    EXPECT_LT(after.energy, 2 * before.energy);
    EXPECT_TRUE(std::isfinite(after.energy));
    for (std::int64_t i = 0; i < p.inputs[0].size(); ++i) ASSERT_GT(p.inputs[0].value(i), 0) << i;
  }
}

}  // namespace gpuphys::testing
