// Time loop of cahn_hilliard: a square drop becomes round, whatever module does the steps.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "cases/grid_lattice/cahn_hilliard.hpp"
#include "cases/grid_lattice/drops.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// A problem without velocity whose populations are all at rest.
inline Problem phase_at_rest(drops::Grid g, double tau, double beta, double kappa, double eta,
                             const std::vector<float>& phi) {
  Problem p = make_problem(find_task("cahn_hilliard").contract, {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  p.set_scalar("tau", tau);
  p.set_scalar("beta", beta);
  p.set_scalar("kappa", kappa);
  p.set_scalar("eta", eta);
  std::copy(phi.begin(), phi.end(), p.inputs[0].as<float>().begin());
  return p;
}

/// The phase field: the sum of the populations of every cell.
inline std::vector<double> phase_field(const HostArray& h) {
  const std::int64_t cells = h.size() / 19;
  std::vector<double> phi(static_cast<std::size_t>(cells));
  for (std::int64_t i = 0; i < h.size(); ++i) phi[static_cast<std::size_t>(i % cells)] += h.value(i);
  return phi;
}

inline void next_step(const std::string& label, Problem& p) {
  const Arrays out = run_module(find_task("cahn_hilliard"), label, p);
  const auto h = p.inputs[0].as<float>();
  for (std::size_t i = 0; i < h.size(); ++i)
    h[i] = static_cast<float>(out[0].value(static_cast<std::int64_t>(i)));
}

/// 1,000 steps of a square drop, uniform along z.
inline void time_loop_cahn_hilliard(const std::string& label) {
  constexpr std::int64_t n = 24;
  const drops::Grid g{n, n + 2, 2};
  constexpr double width = 3, sigma = 0.04, beta = 12 * sigma / width, kappa = 1.5 * sigma * width, half = 6;
  const auto at = [&](std::int64_t i, std::int64_t j) {
    return static_cast<std::size_t>((i * g.ny + j) * g.nz);
  };
  std::vector<float> start;
  for (std::int64_t cell = 0; cell < g.nx * g.ny * g.nz; ++cell) {
    const double x = std::abs(static_cast<double>(cell / (g.ny * g.nz)) - 11),
                 y = std::abs(static_cast<double>(cell / g.nz % g.ny) - 11);
    start.push_back(static_cast<float>(drops::profile(half - std::max(x, y), width)));
  }
  Problem p = phase_at_rest(g, 0.8, beta, kappa, 1, start);
  const auto energy = [&](const std::vector<double>& phi) {
    double sum = 0;
    for (std::int64_t i = 0; i < g.nx; ++i) {
      for (std::int64_t j = 0; j < g.ny; ++j) {
        const double c = phi[at(i, j)], x = phi[at((i + 1) % g.nx, j)] - c,
                     y = phi[at(i, (j + 1) % g.ny)] - c;
        sum += beta * c * c * (1 - c) * (1 - c) + kappa / 2 * (x * x + y * y);
      }
    }
    return sum;
  };
  // Where phi falls below 1/2 along an axis, and along a diagonal, from the centre.
  const auto reach = [&](const std::vector<double>& phi, std::int64_t di, std::int64_t dj) {
    std::int64_t r = 0;
    while (phi[at(11 + (r + 1) * di, 11 + (r + 1) * dj)] > 0.5) ++r;
    const double above = phi[at(11 + r * di, 11 + r * dj)],
                 below = phi[at(11 + (r + 1) * di, 11 + (r + 1) * dj)];
    return (static_cast<double>(r) + (above - 0.5) / (above - below)) * std::hypot(di, dj);
  };
  std::vector<double> phi = phase_field(p.inputs[0]);
  double mass = 0, earlier = energy(phi);
  for (const double c : phi) mass += c;
  EXPECT_GT(reach(phi, 1, 1) / reach(phi, 1, 0), 1.25);
  for (int step = 1; step <= 1000; ++step) {
    next_step(label, p);
    if (step % 50 != 0) continue;
    phi = phase_field(p.inputs[0]);
    double now = 0;
    for (const double c : phi) {
      ASSERT_TRUE(std::isfinite(c)) << "step " << step;
      ASSERT_LT(std::abs(c - 0.5), 0.6) << "step " << step;
      now += c;
    }
    // Every step rounds populations and weights by 2^-24 of phi.
    EXPECT_NEAR(now / mass, 1, 3e-8 * step) << "step " << step;
    const double e = energy(phi);
    EXPECT_LE(e, earlier * (1 + 1e-5)) << "step " << step;
    earlier = e;
  }
  EXPECT_NEAR(reach(phi, 1, 1) / reach(phi, 1, 0), 1, 0.02);
  // Across the box's own lines of symmetry nothing distinguishes directions.
  EXPECT_NEAR(reach(phi, 1, 0), reach(phi, -1, 0), 0.05);
  EXPECT_NEAR(reach(phi, 1, 0), reach(phi, 0, 1), 0.05);
  EXPECT_NEAR(reach(phi, 1, 1), reach(phi, -1, 1), 0.05);
}

}  // namespace gpuphys::testing
