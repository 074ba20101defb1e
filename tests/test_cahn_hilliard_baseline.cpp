// The serial baseline of cahn_hilliard, validated on its own: single cells by hand, conservation, symmetry, a
// profile at rest, diffusion and advection at their rates.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>

#include "tests/time_loops/cahn_hilliard.hpp"

namespace gpuphys {
namespace {

using drops::Grid;

HostArray run(const Problem& p) {
  return std::move(testing::run_module(find_task("cahn_hilliard"), "baseline_f64", p)[0]);
}

// One cell with phi = 2: mu = 4 beta 2 (2 - 1)(2 - 1/2) = 12 beta. tau = 1 gives the equilibrium itself.
TEST(CahnHilliardBaseline, OneCellByHand) {
  Problem p = testing::phase_at_rest({1, 1, 1}, 1, 0.5, 7, 0.25, {2});
  const double velocity = static_cast<double>(0.1f);
  p.inputs[2].as<float>()[0] = 0.1f;  // uy
  const HostArray h = run(p);
  EXPECT_NEAR(h.value(0), 2 - 2.0 / 3 * 0.25 * 6, 1e-14);
  EXPECT_NEAR(h.value(1), 0.25 * 6 / 18, 1e-14);                        // (1,0,0)
  EXPECT_NEAR(h.value(3), (0.25 * 6 + 3 * 2 * velocity) / 18, 1e-14);   // (0,1,0)
  EXPECT_NEAR(h.value(4), (0.25 * 6 - 3 * 2 * velocity) / 18, 1e-14);   // (0,-1,0)
  EXPECT_NEAR(h.value(10), (0.25 * 6 + 3 * 2 * velocity) / 36, 1e-14);  // (-1,1,0)
  EXPECT_NEAR(h.value(11), 0.25 * 6 / 36, 1e-14);                       // (1,0,1)
  EXPECT_NEAR(h.value(17), (0.25 * 6 + 3 * 2 * velocity) / 36, 1e-14);  // (0,1,-1)
}

// With tau = 2 half of the way is gone: (h + e)/2.
TEST(CahnHilliardBaseline, RelaxesByOneOverTau) {
  Problem p = testing::phase_at_rest({1, 1, 1}, 2, 0, 0, 1, {0.5f});
  p.inputs[0].as<float>()[5] = 0.25f;
  const HostArray h = run(p);
  EXPECT_NEAR(h.value(0), (0.5 + 0.75) / 2, 1e-15);
  EXPECT_NEAR(h.value(5), 0.25 / 2, 1e-15);
  EXPECT_EQ(h.value(6), 0);
}

// A spike: L = -4 in it, 1/3 beside it, 1/6 across an edge. Populations leave along their velocities and
// wrap.
TEST(CahnHilliardBaseline, ASpikeByHand) {
  const Grid g{3, 4, 5};
  std::vector<float> phi(60);
  const auto flat = [](std::int64_t i, std::int64_t j, std::int64_t k) { return (i * 4 + j) * 5 + k; };
  phi[static_cast<std::size_t>(flat(2, 3, 4))] = 1;
  const HostArray h = run(testing::phase_at_rest(g, 1, 0.7, 0.5, 1, phi));
  // mu = 2 in the spike (the well has no slope at 0 and 1), -1/6 beside it, -1/12 across an edge.
  EXPECT_NEAR(h.value(flat(2, 3, 4)), 1 - 2.0 / 3 * 2, 1e-7);
  EXPECT_NEAR(h.value(1 * 60 + flat(0, 3, 4)), 2.0 / 18, 1e-7);   // +x wraps
  EXPECT_NEAR(h.value(3 * 60 + flat(2, 0, 4)), 2.0 / 18, 1e-7);   // +y wraps
  EXPECT_NEAR(h.value(11 * 60 + flat(0, 3, 0)), 2.0 / 36, 1e-7);  // (1,0,1) wraps twice
  EXPECT_NEAR(h.value(1 * 60 + flat(2, 3, 4)), -1.0 / 6 / 18, 1e-7);
  EXPECT_NEAR(h.value(7 * 60 + flat(2, 3, 4)), -1.0 / 12 / 36, 1e-7);
  EXPECT_NEAR(h.value(flat(1, 3, 4)), 2.0 / 3 / 6, 1e-7);
}

TEST(CahnHilliardBaseline, KeepsThePhase) {
  const Problem p = find_task("cahn_hilliard").set("hard_grid_3x4x45").make();
  double before = 0, after = 0;
  for (const double c : testing::phase_field(p.inputs[0])) before += c;
  for (const double c : testing::phase_field(run(p))) after += c;
  EXPECT_NEAR(after / before, 1, 1e-13);
}

// Exchanging x and z, in grid, velocities and populations, exchanges the result: no axis is special.
TEST(CahnHilliardBaseline, ExchangingAxesExchangesTheResult) {
  const auto exchanged = [](std::size_t q) {
    const lattice::VelocitySet& s = lattice::velocity_set(19);
    const std::array<int, 3> c{s.c[q][2], s.c[q][1], s.c[q][0]};
    return static_cast<std::int64_t>(std::find(s.c.begin(), s.c.end(), c) - s.c.begin());
  };
  const Problem p = find_task("cahn_hilliard").set("hard_grid_3x4x45").make();
  Problem turned = make_problem(find_task("cahn_hilliard").contract, {{"nx", 45}, {"ny", 4}, {"nz", 3}});
  for (const Scalar& s : p.scalars) turned.set_scalar(s.name, s.value);
  const auto place = [](std::int64_t cell) { return (cell % 45 * 4 + cell / 45 % 4) * 3 + cell / 180; };
  constexpr std::int64_t cells = 3 * 4 * 45;
  for (std::int64_t cell = 0; cell < cells; ++cell) {
    for (std::size_t q = 0; q < 19; ++q) {
      turned.inputs[0].as<float>()[static_cast<std::size_t>(exchanged(q) * cells + place(cell))] =
          p.inputs[0].as<float>()[q * cells + static_cast<std::size_t>(cell)];
    }
    for (std::size_t d = 0; d < 3; ++d) {
      turned.inputs[3 - d].as<float>()[static_cast<std::size_t>(place(cell))] =
          p.inputs[1 + d].as<float>()[static_cast<std::size_t>(cell)];
    }
  }
  const HostArray a = run(p), b = run(turned);
  for (std::int64_t cell = 0; cell < cells; ++cell) {
    for (std::size_t q = 0; q < 19; ++q) {
      ASSERT_NEAR(a.value(static_cast<std::int64_t>(q) * cells + cell),
                  b.value(exchanged(q) * cells + place(cell)), 1e-13);
    }
  }
}

// A small wave about phi = 1/2 + s/2 sees the well's slope a = 4 beta (3 phi^2 - 3 phi + 1/2): it decays at
// M k^2 (a + kappa k^2), M = eta (tau - 1/2)/3.
TEST(CahnHilliardBaseline, ASmallWaveDecaysAtItsRate) {
  for (const double tau : {0.8, 1.3}) {
    const Grid g{1, 32, 1};
    const double k = 2 * std::numbers::pi / 32, beta = 0.06, kappa = 0.5, eta = 0.5, mean = 1.0;
    std::vector<float> phi;
    for (int j = 0; j < 32; ++j) phi.push_back(static_cast<float>(mean + 1e-3 * std::sin(k * j)));
    Problem p = testing::phase_at_rest(g, tau, beta, kappa, eta, phi);
    const auto amplitude = [&] {
      const std::vector<double> now = testing::phase_field(p.inputs[0]);
      double sum = 0;
      for (std::size_t j = 0; j < 32; ++j) sum += now[j] * std::sin(k * static_cast<double>(j));
      return sum / 16;
    };
    constexpr int steps = 800;
    for (int step = 0; step < 20; ++step) testing::next_step("baseline_f64", p);
    const double start = amplitude();
    for (int step = 0; step < steps; ++step) testing::next_step("baseline_f64", p);
    const double slope = 4 * beta * (3 * mean * mean - 3 * mean + 0.5),
                 rate = std::log(start / amplitude()) / steps;
    EXPECT_NEAR(rate / (eta * (tau - 0.5) / 3 * k * k * (slope + kappa * k * k)), 1, 0.03) << "tau " << tau;
  }
}

// A drop in a uniform flow moves with it.
TEST(CahnHilliardBaseline, ADropMovesWithTheFlow) {
  const Grid g{24, 20, 22};
  const std::array<double, 3> u{0.05, -0.02, 0.03};
  Problem p = testing::phase_at_rest(g, 0.8, 0.06, 0.12, 0.5, drops::field(g, {{{11, 10, 9}, 5}}, 4));
  for (std::size_t d = 0; d < 3; ++d) {
    for (float& v : p.inputs[1 + d].as<float>()) v = static_cast<float>(u[d]);
  }
  const auto centre = [&] {
    const std::vector<double> phi = testing::phase_field(p.inputs[0]);
    std::array<double, 4> sum{};
    for (std::size_t cell = 0; cell < phi.size(); ++cell) {
      sum[0] += phi[cell] * static_cast<double>(cell / (20 * 22));
      sum[1] += phi[cell] * static_cast<double>(cell / 22 % 20);
      sum[2] += phi[cell] * static_cast<double>(cell % 22);
      sum[3] += phi[cell];
    }
    return std::array<double, 3>{sum[0] / sum[3], sum[1] / sum[3], sum[2] / sum[3]};
  };
  const std::array<double, 3> before = centre();
  for (int step = 0; step < 40; ++step) testing::next_step("baseline_f64", p);
  const std::array<double, 3> after = centre();
  for (std::size_t d = 0; d < 3; ++d)
    EXPECT_NEAR((after[d] - before[d]) / (40 * u[d]), 1, 0.05) << "axis " << d;
}

TEST(CahnHilliardBaseline, TimeLoop) {
  testing::time_loop_cahn_hilliard("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
