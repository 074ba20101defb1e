// The serial baseline of viscosity_implicit, validated on its own: its solver against elimination, single
// unknowns by hand, waves that decay at the rate of their eigenvalue, symmetry, energy.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/generators/random.hpp"
#include "serial_baselines/global_solve/box_multigrid.hpp"
#include "tests/mac_fluid.hpp"

namespace gpuphys {
namespace {

using mac_fluid::Extents;
using testing::face;

// Gaussian elimination of a small system, written out.
std::vector<double> eliminate(const serial::BoxSystem<double>& a, std::vector<double> b) {
  const std::size_t n = a.size();
  std::vector<std::vector<double>> m(n, std::vector<double>(n));
  std::vector<double> unit(n), column(n);
  for (std::size_t c = 0; c < n; ++c) {
    std::fill(unit.begin(), unit.end(), 0.0);
    unit[c] = 1;
    a.multiply(unit, column);
    for (std::size_t r = 0; r < n; ++r) m[r][c] = column[r];
  }
  for (std::size_t c = 0; c < n; ++c) {
    if (m[c][c] == 0) continue;
    for (std::size_t r = c + 1; r < n; ++r) {
      const double f = m[r][c] / m[c][c];
      for (std::size_t e = c; e < n; ++e) m[r][e] -= f * m[c][e];
      b[r] -= f * b[c];
    }
  }
  for (std::size_t c = n; c-- > 0;) {
    if (m[c][c] == 0) continue;
    for (std::size_t e = c + 1; e < n; ++e) b[c] -= m[c][e] * b[e];
    b[c] /= m[c][c];
  }
  return b;
}

TEST(BoxMultigrid, AgreesWithElimination) {
  for (const Extents n : {Extents{5, 4, 3}, Extents{1, 1, 7}, Extents{3, 1, 4}, Extents{1, 1, 1}}) {
    serial::BoxSystem<double> a(n);
    std::vector<double> b(a.size());
    for (std::uint64_t c = 0; c < a.size(); ++c) {
      const std::int64_t at[3] = {static_cast<std::int64_t>(c) / (n[1] * n[2]),
                                  static_cast<std::int64_t>(c) / n[2] % n[1],
                                  static_cast<std::int64_t>(c) % n[2]};
      for (std::size_t d = 0; d < 3; ++d)
        a.g[d][c] = at[d] + 1 < n[d] ? std::pow(10.0, -4 * uniform01(1, d, c)) : 0;
      a.excess[c] = 0.01 * uniform01(1, 3, c);
      b[c] = uniform11(1, 4, c);
    }
    const std::vector<double> expected = eliminate(a, b);
    const std::vector<double> got = serial::BoxMultigrid<double>(a).solve(b, 0);
    for (std::size_t c = 0; c < b.size(); ++c)
      ASSERT_NEAR(got[c], expected[c], 1e-9 * std::abs(expected[0]) + 1e-9);
  }
}

TEST(BoxMultigrid, TakesAFewCyclesWhateverTheSize) {
  // 1e-13 within the limits of the solver: the residual of what comes back is that small.
  for (const std::int64_t n : {8, 33, 64}) {
    serial::BoxSystem<double> a({n, n, n + 1});
    std::vector<double> b(a.size()), ax(a.size());
    for (std::int64_t i = 0; i < n; ++i)
      for (std::int64_t j = 0; j < n; ++j)
        for (std::int64_t k = 0; k <= n; ++k) {
          const std::size_t c = a.flat(i, j, k);
          a.g[0][c] = i + 1 < n ? 1 : 0;
          a.g[1][c] = j + 1 < n ? 1 : 0;
          a.g[2][c] = k < n ? 1 : 0;
          b[c] = uniform11(2, 0, c);
        }
    double mean = 0;
    for (const double v : b) mean += v / static_cast<double>(b.size());
    for (double& v : b) v -= mean;
    const std::vector<double> x = serial::BoxMultigrid<double>(a).solve(b, 0);
    a.multiply(x, ax);
    double error = 0, size = 0;
    for (std::size_t c = 0; c < b.size(); ++c) {
      error += (b[c] - ax[c]) * (b[c] - ax[c]);
      size += b[c] * b[c];
    }
    EXPECT_LT(std::sqrt(error / size), 1e-12) << n;
  }
}

Problem fluid(Extents n, const mac_fluid::Open& open, double dx, double dt, double nu) {
  return testing::fluid_at_rest("viscosity_implicit", n, open,
                                {{"dx", dx}, {"dt", dt}, {"nu", nu}, {"tol", 1e-6}});
}
Arrays run(const Problem& p) {
  return testing::run_module(find_task("viscosity_implicit"), "baseline_f64", p);
}

// alpha = 0.5 x 0.25 / 0.25 = 1/2; two open faces between closed ones: 1/2 u + 1/2 (6 u - v) = 1/2 u*.
TEST(ViscosityImplicitBaseline, TwoFacesByHand) {
  const Problem at_rest = fluid(
      {5, 5, 5},
      [](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        return axis == 1 && i == 2 && j == 2 && (k == 2 || k == 3) ? 0.5 : 0.0;
      },
      0.5, 0.5, 0.25);
  Problem p = at_rest.clone();
  const std::int64_t a = face(p.inputs[1], 2, 2, 2), b = face(p.inputs[1], 2, 2, 3);
  p.inputs[1].as<float>()[static_cast<std::size_t>(a)] = 2;
  const Arrays out = run(p);
  // 7/2 u - v/2 = 1, 7/2 v = u/2.
  EXPECT_NEAR(out[1].value(a), 7.0 / 24, 1e-12);
  EXPECT_NEAR(out[1].value(b), 1.0 / 24, 1e-12);
  for (std::int64_t f = 0; f < out[0].size(); ++f) EXPECT_EQ(out[0].value(f), 0);
}

// In an open box, u_x = sin(pi i / nx) cos(pi (j + 1/2) q / ny) is an eigenvector: at rest at the walls that
// it hits, slipping along the others.
TEST(ViscosityImplicitBaseline, AWaveDecaysByItsEigenvalue) {
  const Extents n{12, 9, 7};
  Problem p = fluid(n, mac_fluid::all_open(), 0.5, 0.25, 3);
  const double alpha = 3, pi = std::numbers::pi;
  mac_fluid::set_velocity(p, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    if (axis == 0)
      return std::sin(pi * 2 * static_cast<double>(i) / 12) *
             std::cos(pi * 3 * (static_cast<double>(j) + 0.5) / 9);
    if (axis == 2)
      return std::sin(pi * static_cast<double>(k) / 7) * std::cos(pi * (static_cast<double>(i) + 0.5) / 12);
    return 0.0;
  });
  const Arrays out = run(p);
  const auto eigenvalue = [&](double angle) { return 2 - 2 * std::cos(angle); };
  const double x = 1 / (1 + alpha * (eigenvalue(2 * pi / 12) + eigenvalue(3 * pi / 9))),
               z = 1 / (1 + alpha * (eigenvalue(pi / 7) + eigenvalue(pi / 12)));
  for (std::int64_t f = 0; f < out[0].size(); ++f)
    EXPECT_NEAR(out[0].value(f), x * p.inputs[0].value(f), 1e-7);
  for (std::int64_t f = 0; f < out[1].size(); ++f) EXPECT_EQ(out[1].value(f), 0);
  for (std::int64_t f = 0; f < out[2].size(); ++f)
    EXPECT_NEAR(out[2].value(f), z * p.inputs[2].value(f), 1e-7);
}

// A^-1 is symmetric: what a unit in one face gives to another is what that gives back, times the fractions.
TEST(ViscosityImplicitBaseline, IsSymmetric) {
  const Extents n{6, 7, 5};
  const Problem at_rest = fluid(n, mac_fluid::random_faces(n, 3, 0.2), 1, 1, 2);
  std::vector<std::int64_t> open;
  for (std::int64_t f = 0; f < at_rest.inputs[5].size(); ++f) {
    const std::int64_t k = f % 6;
    if (at_rest.inputs[5].value(f) > 0 && k > 0 && k < 5) open.push_back(f);
  }
  const std::int64_t a = open[open.size() / 3], b = open[open.size() / 2];
  const auto answer = [&](std::int64_t source, std::int64_t at) {
    Problem p = at_rest.clone();
    p.inputs[2].as<float>()[static_cast<std::size_t>(source)] = 1;
    return run(p)[2].value(at) / at_rest.inputs[5].value(source);
  };
  EXPECT_GT(answer(a, b), 0);
  EXPECT_NEAR(answer(a, b) / answer(b, a), 1, 1e-9);
}

TEST(ViscosityImplicitBaseline, KineticEnergyFalls) {
  const Problem p = find_task("viscosity_implicit").set("hard_ball").make();
  Arrays start;
  for (std::size_t c = 0; c < 3; ++c) start.push_back(p.inputs[c].clone());
  EXPECT_LT(testing::kinetic_energy(p, run(p)), testing::kinetic_energy(p, start));
}

// Outside faces are closed even where w says otherwise; what is stored on closed faces does not matter.
TEST(ViscosityImplicitBaseline, ClosedFacesAreClosed) {
  const Extents n{5, 6, 4};
  Problem p = fluid(n, mac_fluid::random_faces(n, 4, 0.3), 1, 1, 1);
  mac_fluid::set_noise(p, 5, 1);
  const Arrays before = run(p);
  for (std::int64_t j = 0; j < 6; ++j) {
    p.inputs[3].as<float>()[static_cast<std::size_t>(face(p.inputs[3], 0, j, 2))] = 1;
    p.inputs[0].as<float>()[static_cast<std::size_t>(face(p.inputs[0], 0, j, 2))] = 5;
  }
  const Arrays after = run(p);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < before[c].size(); ++f) ASSERT_EQ(before[c].value(f), after[c].value(f));
  }
}

TEST(TaylorGreenModes, HaveNoDivergenceInTheOpenBoxAndRmsOne) {
  Problem p = fluid({120, 130, 110}, mac_fluid::all_open(), 1, 1, 1);
  mac_fluid::set_taylor_green(p, {3, 3});
  const HostArray &ux = p.inputs[0], &uy = p.inputs[1], &uz = p.inputs[2];
  double square = 0, worst = 0;
  std::int64_t open = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < p.inputs[c].size(); ++f) {
      square += p.inputs[c].value(f) * p.inputs[c].value(f);
      open += p.inputs[3 + c].value(f) > 0 ? 1 : 0;
    }
  }
  EXPECT_NEAR(square / static_cast<double>(open), 1, 1e-6);
  // The differences of the sampled field: its divergence is of second order only.
  for (std::int64_t i = 0; i < 120; ++i)
    for (std::int64_t j = 0; j < 130; ++j)
      for (std::int64_t k = 0; k < 110; ++k)
        worst = std::max(worst, std::abs(ux.value(face(ux, i + 1, j, k)) - ux.value(face(ux, i, j, k)) +
                                         uy.value(face(uy, i, j + 1, k)) - uy.value(face(uy, i, j, k)) +
                                         uz.value(face(uz, i, j, k + 1)) - uz.value(face(uz, i, j, k))));
  EXPECT_LT(worst, 0.05);
}

}  // namespace
}  // namespace gpuphys
