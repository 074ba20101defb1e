// The serial baseline of surface_tension_phase_field, validated on its own: single cells by hand, exact
// derivatives of polynomials, a plane interface at rest, the pressure of a drop and the balance of forces.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <numbers>

#include "cases/grid_lattice/drops.hpp"
#include "cases/grid_lattice/surface_tension_phase_field.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using drops::Grid;

Problem problem_of(Grid g, double beta, double kappa, const std::vector<float>& phi) {
  Problem p = make_problem(find_task("surface_tension_phase_field").contract,
                           {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  p.set_scalar("beta", beta);
  p.set_scalar("kappa", kappa);
  std::copy(phi.begin(), phi.end(), p.inputs[0].as<float>().begin());
  return p;
}

Arrays run(const Problem& p) {
  return testing::run_module(find_task("surface_tension_phase_field"), "baseline_f64", p);
}

std::size_t flat(Grid g, std::int64_t i, std::int64_t j, std::int64_t k) {
  return static_cast<std::size_t>((i * g.ny + j) * g.nz + k);
}

// Of a spike the Laplacian is -4 in the cell, 1/3 beside it and 1/6 across an edge; the gradient is 0, 1/6
// and 1/12. With beta = 0 and kappa = 1 the force beside it is -1/3 x 1/6, towards the spike positive.
TEST(SurfaceTensionPhaseFieldBaseline, ASpikeByHand) {
  const Grid g{5, 6, 7};
  std::vector<float> phi(5 * 6 * 7);
  phi[flat(g, 2, 3, 3)] = 1;
  const Arrays out = run(problem_of(g, 0, 1, phi));
  const auto f = [&](std::size_t c, std::int64_t i, std::int64_t j, std::int64_t k) {
    return out[c].value(static_cast<std::int64_t>(flat(g, i, j, k)));
  };
  EXPECT_EQ(f(0, 2, 3, 3), 0);
  EXPECT_NEAR(f(0, 1, 3, 3), -1.0 / 18, 1e-15);
  EXPECT_NEAR(f(0, 3, 3, 3), 1.0 / 18, 1e-15);
  EXPECT_NEAR(f(1, 2, 2, 3), -1.0 / 18, 1e-15);
  EXPECT_NEAR(f(2, 2, 3, 4), 1.0 / 18, 1e-15);
  EXPECT_NEAR(f(0, 1, 2, 3), -1.0 / 72, 1e-15);
  EXPECT_NEAR(f(1, 1, 2, 3), -1.0 / 72, 1e-15);
  EXPECT_EQ(f(2, 1, 2, 3), 0);
  EXPECT_NEAR(f(1, 2, 4, 2), 1.0 / 72, 1e-15);
  EXPECT_NEAR(f(2, 2, 4, 2), -1.0 / 72, 1e-15);
  EXPECT_EQ(f(0, 1, 2, 2), 0);  // corners are no neighbours
  EXPECT_EQ(f(1, 1, 2, 2), 0);
}

// The slope of the well: 4 x 2 x phi (phi - 1)(phi - 1/2) at phi = 3/4 is -3/8; the gradient is (3/4 -
// 1/4)/2.
TEST(SurfaceTensionPhaseFieldBaseline, TheDoubleWellByHand) {
  const Grid g{4, 1, 1};
  const Arrays out = run(problem_of(g, 2, 0, {0.25f, 0.75f, 0.75f, 0.25f}));
  EXPECT_NEAR(out[0].value(1), -3.0 / 8 / 4, 1e-15);
  EXPECT_NEAR(out[0].value(0), 3.0 / 8 / 4, 1e-15);
  EXPECT_NEAR(out[0].value(3), -3.0 / 8 / 4, 1e-15);
}

TEST(SurfaceTensionPhaseFieldBaseline, NeighboursWrapAlongEveryAxis) {
  for (const std::size_t axis : {0u, 1u, 2u}) {
    std::array<std::int64_t, 3> n{3, 4, 5};
    const Grid g{n[0], n[1], n[2]};
    std::vector<float> phi(60);
    std::array<std::int64_t, 3> at{1, 1, 1};
    at[axis] = 0;
    phi[flat(g, at[0], at[1], at[2])] = 1;
    const Arrays out = run(problem_of(g, 0, 1, phi));
    at[axis] = n[axis] - 1;
    EXPECT_NEAR(out[axis].value(static_cast<std::int64_t>(flat(g, at[0], at[1], at[2]))), -1.0 / 18, 1e-15);
  }
}

// phi = sin(k . x): the force with beta = 0 is |k|^2 sin cos k.
TEST(SurfaceTensionPhaseFieldBaseline, AnObliqueWaveHasItsDerivativesToSecondOrder) {
  std::array<double, 2> error;
  for (const std::int64_t n : {12, 24}) {
    const Grid g{n, n, n};
    const double k = 2 * std::numbers::pi / static_cast<double>(n);
    std::vector<float> phi;
    const auto phase = [&](std::int64_t i, std::int64_t j, std::int64_t l) {
      return k * static_cast<double>(i + 2 * j - l);
    };
    for (std::int64_t i = 0; i < n; ++i)
      for (std::int64_t j = 0; j < n; ++j)
        for (std::int64_t l = 0; l < n; ++l) phi.push_back(static_cast<float>(std::sin(phase(i, j, l))));
    const Arrays out = run(problem_of(g, 0, 1, phi));
    double worst = 0;
    for (std::int64_t i = 0; i < n; ++i)
      for (std::int64_t j = 0; j < n; ++j)
        for (std::int64_t l = 0; l < n; ++l) {
          const double expected = 6 * k * k * std::sin(phase(i, j, l)) * k * std::cos(phase(i, j, l));
          const auto cell = static_cast<std::int64_t>(flat(g, i, j, l));
          worst = std::max({worst, std::abs(out[0].value(cell) - expected),
                            std::abs(out[1].value(cell) - 2 * expected),
                            std::abs(out[2].value(cell) + expected)});
        }
    error[n == 12 ? 0 : 1] = worst / (6 * k * k * k);
  }
  EXPECT_LT(error[1], 0.2);
  EXPECT_GT(error[0], 3.0 * error[1]);
}

// The profile balances well and gradient: what force is left is of second order in 1/W.
TEST(SurfaceTensionPhaseFieldBaseline, APlaneInterfaceAtRestHasNoForceToSecondOrder) {
  std::array<double, 2> error;
  for (const double width : {6.0, 12.0}) {
    const Grid g{1, 2, 192};
    std::vector<float> phi(2 * 192);
    for (std::int64_t k = 0; k < 192; ++k) {
      phi[flat(g, 0, 0, k)] = phi[flat(g, 0, 1, k)] =
          static_cast<float>(drops::profile(48 - std::abs(static_cast<double>(k) - 95.5), width));
    }
    const double sigma = 1, beta = 12 * sigma / width, kappa = 1.5 * sigma * width;
    const auto size = [&](const Arrays& out) {
      double worst = 0;
      for (std::int64_t c = 0; c < out[2].size(); ++c) worst = std::max(worst, std::abs(out[2].value(c)));
      return worst;
    };
    error[width == 6 ? 0 : 1] =
        size(run(problem_of(g, beta, kappa, phi))) / size(run(problem_of(g, beta, 0, phi)));
  }
  EXPECT_LT(error[0], 0.25);
  EXPECT_GT(error[0], 3.3 * error[1]);
}

// In a drop with the profile of a plane, well and gradient part leave mu = -kappa (2/r) dphi/dr, so that the
// force along a radius integrates to -kappa (2/R) times the integral of (dphi/dr)^2 = -2 sigma / R.
TEST(SurfaceTensionPhaseFieldBaseline, ADropHasThePressureOfLaplace) {
  const Grid g{64, 64, 64};
  const double radius = 20, width = 6, sigma = 0.5;
  const Problem p = problem_of(g, 12 * sigma / width, 1.5 * sigma * width,
                               drops::field(g, {{{32, 32, 32}, radius}}, width));
  const Arrays out = run(p);
  double jump = 0;
  for (std::int64_t i = 32; i < 64; ++i) jump += out[0].value(static_cast<std::int64_t>(flat(g, i, 32, 32)));
  EXPECT_NEAR(-jump / (2 * sigma / radius), 1, 0.03);
}

// Laplacian and gradient commute: the gradient part of the force is the divergence of a stress, and sums to
// nothing on a periodic grid, whatever the field.
TEST(SurfaceTensionPhaseFieldBaseline, TheGradientPartSumsToNothing) {
  const Grid g{9, 10, 11};
  for (const HostArray& f : run(problem_of(g, 0, 1, drops::noise(g, 3, 0, 1)))) {
    double sum = 0, size = 0;
    for (std::int64_t c = 0; c < f.size(); ++c) {
      sum += f.value(c);
      size += std::abs(f.value(c));
    }
    EXPECT_LT(std::abs(sum), 1e-12 * size);
  }
}

TEST(Drops, AreTheLargestProfileOfTheNearestImages) {
  const Grid g{9, 11, 40};
  const std::vector<drops::Drop> all = drops::random_drops({5, 7, 2, 4}, g);
  const std::vector<float> phi = drops::field(g, all, 3);
  for (std::int64_t i = 0; i < g.nx; ++i) {
    for (std::int64_t j = 0; j < g.ny; ++j) {
      for (std::int64_t k = 0; k < g.nz; ++k) {
        double best = 0;
        for (const drops::Drop& d : all) {
          for (int a = -1; a <= 1; ++a)
            for (int b = -1; b <= 1; ++b)
              for (int c = -1; c <= 1; ++c) {
                const double r = std::hypot(static_cast<double>(i + a * g.nx) - d.centre[0],
                                            static_cast<double>(j + b * g.ny) - d.centre[1],
                                            static_cast<double>(k + c * g.nz) - d.centre[2]);
                best = std::max(best, 0.5 + 0.5 * std::tanh(2 * (d.radius - r) / 3));
              }
        }
        ASSERT_NEAR(static_cast<double>(phi[flat(g, i, j, k)]), best, 1e-7) << i << " " << j << " " << k;
      }
    }
  }
  EXPECT_EQ(drops::profile(-100, 3), 0);
  EXPECT_EQ(drops::profile(0, 3), 0.5);
}

}  // namespace
}  // namespace gpuphys
