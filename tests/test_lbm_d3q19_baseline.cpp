// The serial baseline of lbm_d3q19, validated on its own: by hand, by conservation, by symmetry and by the
// viscosity that its flows have.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "cases/grid_lattice/lattice_inputs.hpp"
#include "core/random.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/lbm_d3q19.hpp"

namespace gpuphys {
namespace {

using lattice::Grid;
using lattice::Macroscopic;
using testing::run_module;

const Task& task() {
  return find_task("lbm_d3q19");
}

lattice::Step step() {
  return {19, true, true, task().contract};
}

Problem at_rest(Grid grid) {
  return lattice::problem_from(step(), grid, [](auto, auto, auto) { return Macroscopic{1.0, {0, 0, 0}}; });
}

std::int64_t flat(const HostArray& f, std::int64_t q, std::int64_t i, std::int64_t j, std::int64_t k) {
  return ((q * f.shape()[1] + i) * f.shape()[2] + j) * f.shape()[3] + k;
}

TEST(LatticeVelocitySet, MomentsAreThoseOfAnIsotropicLattice) {
  for (const int size : {19, 27}) {
    const lattice::VelocitySet& s = lattice::velocity_set(size);
    ASSERT_EQ(s.c.size(), static_cast<std::size_t>(size));
    double mass = 0, second[3][3] = {}, fourth_xxxx = 0, fourth_xxyy = 0;
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      const auto& c = s.c[q];
      mass += s.w[q];
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) second[a][b] += s.w[q] * c[a] * c[b];
      }
      fourth_xxxx += s.w[q] * c[0] * c[0] * c[0] * c[0];
      fourth_xxyy += s.w[q] * c[0] * c[0] * c[1] * c[1];
      if (q % 2 == 1) {
        for (std::size_t d = 0; d < 3; ++d) EXPECT_EQ(c[d], -s.c[q + 1][d]) << "opposites are neighbours";
      }
      for (std::size_t p = 0; p < q; ++p) EXPECT_NE(s.c[p], c) << "velocities differ";
    }
    EXPECT_NEAR(mass, 1, 1e-15);
    EXPECT_NEAR(fourth_xxxx, 1.0 / 3, 1e-15);
    EXPECT_NEAR(fourth_xxyy, 1.0 / 9, 1e-15);
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) EXPECT_NEAR(second[a][b], a == b ? 1.0 / 3 : 0, 1e-15);
    }
  }
}

TEST(LbmD3Q19Baseline, OneCellByHand) {
  // A single cell with f = w except 1/18 more in direction +x: rho = 19/18, u = (1/19, 0, 0).
  // With tau+ = 1 and magic 1/4, tau- = 1 too, and the result is the equilibrium itself.
  Problem p = at_rest({1, 1, 1});
  p.set_scalar("tau_plus", 1.0);
  p.set_scalar("magic", 0.25);
  const auto f = p.inputs[0].as<float>();
  f[1] = 2.0f / 18;
  const Arrays out = run_module(task(), "baseline_f64", p);
  const double rho = 19.0 / 18, u = 1.0 / 19;
  EXPECT_NEAR(out[0].value(0), rho / 3 * (1 - 1.5 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(1), rho / 18 * (1 + 3 * u + 3 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(2), rho / 18 * (1 - 3 * u + 3 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(3), rho / 18 * (1 - 1.5 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(7), rho / 36 * (1 + 3 * u + 3 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(10), rho / 36 * (1 - 3 * u + 3 * u * u), 1e-7);
  EXPECT_NEAR(out[0].value(15), rho / 36 * (1 - 1.5 * u * u), 1e-7);
}

TEST(LbmD3Q19Baseline, EvenAndOddPartsHaveTheirOwnRelaxation) {
  // Populations of the xy edges disturbed so that density and momentum stay: their even part by (+,+,-,-),
  // then their odd part by cancelling pairs. The equilibrium stays too, so the disturbance shrinks by its own
  // factor.
  const double tau_plus = static_cast<double>(0.6f), tau_minus = 0.5 + 0.1875 / (tau_plus - 0.5);
  const float e = 0x1p-9f;
  {
    Problem p = at_rest({1, 1, 1});
    const auto f = p.inputs[0].as<float>();
    for (const int q : {7, 8}) f[static_cast<std::size_t>(q)] += e;
    for (const int q : {9, 10}) f[static_cast<std::size_t>(q)] -= e;
    const Arrays out = run_module(task(), "baseline_f64", p);
    EXPECT_NEAR(out[0].value(7) - 1.0 / 36, e * (1 - 1 / tau_plus), 1e-8);
    EXPECT_NEAR(out[0].value(9) - 1.0 / 36, -e * (1 - 1 / tau_plus), 1e-8);
  }
  {
    // Momentum of +e in (1,1,0), -e in (-1,-1,0) is (2e, 2e, 0); taken back by -2e in +x and +y with opposite
    // signs in -x and -y of the same size, half each.
    Problem p = at_rest({1, 1, 1});
    const auto f = p.inputs[0].as<float>();
    f[7] += e;
    f[8] -= e;
    for (const int q : {1, 3}) f[static_cast<std::size_t>(q)] -= e;
    for (const int q : {2, 4}) f[static_cast<std::size_t>(q)] += e;
    const Arrays out = run_module(task(), "baseline_f64", p);
    EXPECT_NEAR(out[0].value(7) - 1.0 / 36, e * (1 - 1 / tau_minus), 1e-8);
    EXPECT_NEAR(out[0].value(8) - 1.0 / 36, -e * (1 - 1 / tau_minus), 1e-8);
    EXPECT_NEAR(out[0].value(1) - 1.0 / 18, -e * (1 - 1 / tau_minus), 1e-8);
  }
}

TEST(LbmD3Q19Baseline, EveryPopulationMovesByItsVelocityAndWraps) {
  // Cells with slightly different densities at rest are equilibria that collision keeps: populations only
  // move.
  const Grid g{3, 4, 5};
  const Problem p = lattice::problem_from(step(), g, [&](auto i, auto j, auto k) {
    return Macroscopic{1.0 + 0.01 * static_cast<double>((i * g.ny + j) * g.nz + k), {0, 0, 0}};
  });
  const Arrays out = run_module(task(), "baseline_f64", p);
  const lattice::VelocitySet& s = lattice::velocity_set(19);
  for (std::size_t q = 0; q < 19; ++q) {
    for (std::int64_t i = 0; i < g.nx; ++i) {
      for (std::int64_t j = 0; j < g.ny; ++j) {
        for (std::int64_t k = 0; k < g.nz; ++k) {
          const auto a = (i + s.c[q][0] + g.nx) % g.nx, b = (j + s.c[q][1] + g.ny) % g.ny,
                     c = (k + s.c[q][2] + g.nz) % g.nz;
          const auto direction = static_cast<std::int64_t>(q);
          ASSERT_NEAR(out[0].value(flat(out[0], direction, a, b, c)),
                      p.inputs[0].value(flat(p.inputs[0], direction, i, j, k)), 1e-7)
              << q << " " << i << " " << j << " " << k;
        }
      }
    }
  }
}

TEST(LbmD3Q19Baseline, ConservesMassAndMomentumOfTheWholeGrid) {
  const Problem p = task().set("public_smoke").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  const AbcFlow pattern;
  const auto before = testing::lattice_totals(p.inputs[0], pattern),
             after = testing::lattice_totals(out[0], pattern);
  EXPECT_NEAR(after.mass / before.mass, 1, 1e-12);
  for (std::size_t d = 0; d < 3; ++d)
    EXPECT_NEAR(after.momentum[d] / before.mass, before.momentum[d] / before.mass, 1e-13);
}

TEST(LbmD3Q19Baseline, AMirroredLatticeGivesTheMirroredResult) {
  // x -> -x, as a grid reversal and an exchange of velocities: any mix-up of directions breaks it.
  const Grid g{5, 4, 3};
  const lattice::VelocitySet& s = lattice::velocity_set(19);
  std::array<std::int64_t, 19> image{};
  for (std::size_t q = 0; q < 19; ++q) {
    for (std::size_t p = 0; p < 19; ++p) {
      if (s.c[p][0] == -s.c[q][0] && s.c[p][1] == s.c[q][1] && s.c[p][2] == s.c[q][2])
        image[q] = static_cast<std::int64_t>(p);
    }
  }
  const Problem p = lattice::flow_problem(step(), g, {21, 1, 0.05, 0.05, 0.25});
  Problem mirrored = p.clone();
  const auto to = mirrored.inputs[0].as<float>();
  const auto from = p.inputs[0].as<float>();
  const auto mirror = [&](const auto& visit) {
    for (std::int64_t q = 0; q < 19; ++q) {
      for (std::int64_t i = 0; i < g.nx; ++i) {
        for (std::int64_t j = 0; j < g.ny; ++j) {
          for (std::int64_t k = 0; k < g.nz; ++k) {
            visit(flat(p.inputs[0], q, i, j, k),
                  flat(p.inputs[0], image[static_cast<std::size_t>(q)], g.nx - 1 - i, j, k));
          }
        }
      }
    }
  };
  mirror([&](std::int64_t a, std::int64_t b) {
    to[static_cast<std::size_t>(b)] = from[static_cast<std::size_t>(a)];
  });
  const Arrays x = run_module(task(), "baseline_f64", p), y = run_module(task(), "baseline_f64", mirrored);
  mirror([&](std::int64_t a, std::int64_t b) { ASSERT_NEAR(x[0].value(a), y[0].value(b), 1e-15); });
}

TEST(LbmD3Q19Baseline, TheEquilibriumIsKept) {
  const Problem p = task().set("hard_uniform_equilibrium").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t i = 0; i < out[0].size(); ++i)
    ASSERT_NEAR(out[0].value(i), p.inputs[0].value(i), 1e-7 * p.inputs[0].value(i));
}

// Decay rate of a transverse shear wave u_y = U sin(k x) over nu k^2, at the given relaxation.
double shear_wave_rate(std::int64_t n, double tau_plus, double magic, int steps) {
  const double k = 2 * std::numbers::pi / static_cast<double>(n), amplitude = 1e-3;
  Problem p = lattice::problem_from(step(), {n, 1, 1}, [&](auto i, auto, auto) {
    return Macroscopic{1.0, {0, amplitude * std::sin(k * static_cast<double>(i)), 0}};
  });
  p.set_scalar("tau_plus", tau_plus);
  p.set_scalar("magic", magic);
  const auto amplitude_of = [&] {
    const lattice::VelocitySet& s = lattice::velocity_set(19);
    double sum = 0;
    for (std::size_t q = 0; q < 19; ++q) {
      for (std::int64_t i = 0; i < n; ++i) {
        sum += s.c[q][1] * p.inputs[0].value(static_cast<std::int64_t>(q) * n + i) *
               std::sin(k * static_cast<double>(i));
      }
    }
    return sum;
  };
  // The first steps set up the non-equilibrium part.
  for (int t = 0; t < 20; ++t) testing::feed_back(run_module(task(), "baseline_f64", p)[0], p);
  const double start = amplitude_of();
  for (int t = 0; t < steps; ++t) testing::feed_back(run_module(task(), "baseline_f64", p)[0], p);
  return std::log(start / amplitude_of()) / steps / ((tau_plus - 0.5) / 3 * k * k);
}

TEST(LbmD3Q19Baseline, AShearWaveDecaysWithTheViscosityOfTauPlus) {
  // The error of the rate is of second order in k.
  const double coarse = shear_wave_rate(16, 0.8, 0.1875, 40) - 1,
               fine = shear_wave_rate(32, 0.8, 0.1875, 40) - 1;
  EXPECT_LT(std::abs(fine), 0.01);
  EXPECT_GT(std::abs(coarse), 3 * std::abs(fine));
}

TEST(LbmD3Q19Baseline, TimeLoop) {
  testing::time_loop_lbm_d3q19("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
