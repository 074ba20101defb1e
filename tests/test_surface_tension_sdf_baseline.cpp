// The serial baseline of surface_tension_sdf, validated on its own: spheres, a cylinder and a saddle of known
// curvature with the order of the scheme, the pressure jump of Laplace, and a closed surface without net
// force.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>

#include "cases/grid_lattice/surface_tension_sdf.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using Field = std::function<double(double, double, double)>;

Problem problem_of(std::array<std::int64_t, 3> n, double sigma, double dx, const Field& phi) {
  Problem p =
      make_problem(find_task("surface_tension_sdf").contract, {{"nx", n[0]}, {"ny", n[1]}, {"nz", n[2]}});
  p.set_scalar("sigma", sigma);
  p.set_scalar("dx", dx);
  std::size_t cell = 0;
  for (std::int64_t i = 0; i < n[0]; ++i) {
    for (std::int64_t j = 0; j < n[1]; ++j) {
      for (std::int64_t k = 0; k < n[2]; ++k) {
        p.inputs[0].as<float>()[cell++] =
            static_cast<float>(phi(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)));
      }
    }
  }
  return p;
}

Arrays run(const Problem& p) {
  return testing::run_module(find_task("surface_tension_sdf"), "baseline_f64", p);
}

// The curvature that the force of a cell on the interface shows: |f| = sigma |kappa| delta |grad phi| with
// delta = 1/h at phi = 0.
struct Probe {
  double curvature;
  std::array<double, 3> force;
};
Probe probe(const Problem& p, std::array<std::int64_t, 3> at) {
  const Arrays out = run(p);
  const auto in = bind_inputs<surface_tension_sdf::Inputs>(p);
  const std::int64_t cell = in.phi.offset(at[0], at[1], at[2]);
  EXPECT_EQ(in.phi(at[0], at[1], at[2]), 0.0f);
  Probe r;
  double size = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    r.force[c] = out[c].value(cell);
    size += r.force[c] * r.force[c];
  }
  r.curvature = std::sqrt(size) * 1.5 * static_cast<double>(in.dx) / static_cast<double>(in.sigma);
  return r;
}

TEST(SurfaceTensionSdfBaseline, APlaneHasNoForce) {
  for (const HostArray& f :
       run(problem_of({9, 8, 7}, 1, 1, [](double i, double, double) { return i - 4; }))) {
    for (std::int64_t c = 0; c < f.size(); ++c) EXPECT_EQ(f.value(c), 0);
  }
}

// phi = x + y^2/16 about a cell on the interface: slope (1, 0, 0), phi_yy = 1/8, so kappa = 1/8 and
// f_x = -sigma kappa / h = -2/8/1.5.
TEST(SurfaceTensionSdfBaseline, AParabolaByHand) {
  const Problem p =
      problem_of({7, 9, 5}, 2, 1, [](double i, double j, double) { return i - 3 + (j - 4) * (j - 4) / 16; });
  const Probe r = probe(p, {3, 4, 2});
  EXPECT_NEAR(r.force[0], -2.0 / 8 / 1.5, 1e-11);
  EXPECT_EQ(r.force[1], 0);
  EXPECT_EQ(r.force[2], 0);
}

// At the wall x = 0 of phi = j - 3 + i^2/2, phi_xx = phi(1) - phi(0) = 1/2 and phi_x = 1/4: indices are
// clamped, divisors stay. kappa = (1/2)/(1 + 1/16)^1.5, f_y = -kappa/1.5.
TEST(SurfaceTensionSdfBaseline, AtAWallIndicesAreClampedAndDivisorsStay) {
  const Problem p = problem_of({4, 7, 3}, 1, 1, [](double i, double j, double) { return j - 3 + i * i / 2; });
  const Arrays out = run(p);
  const auto in = bind_inputs<surface_tension_sdf::Inputs>(p);
  const double kappa = 0.5 / std::pow(1 + 1.0 / 16, 1.5);
  EXPECT_NEAR(out[1].value(in.phi.offset(0, 3, 1)), -kappa / 1.5, 1e-11);
  EXPECT_NEAR(out[0].value(in.phi.offset(0, 3, 1)), -kappa / 1.5 / 4, 1e-11);
}

TEST(SurfaceTensionSdfBaseline, TheBandEndsAtOneAndAHalfCells) {
  const auto force_at = [](double shift) {
    const Problem p = problem_of({9, 9, 9}, 1, 1, [&](double i, double j, double k) {
      return i - 4 + shift + ((j - 4) * (j - 4) + (k - 4) * (k - 4)) / 8;
    });
    return run(p)[0].value(bind_inputs<surface_tension_sdf::Inputs>(p).phi.offset(4, 4, 4));
  };
  EXPECT_LT(force_at(0), 0);
  EXPECT_NE(force_at(1.4375), 0);
  EXPECT_NE(force_at(-1.4375), 0);
  EXPECT_EQ(force_at(1.5), 0);
  EXPECT_EQ(force_at(-1.5), 0);
  // Half way out the delta is 1/2 of what it is on the interface.
  EXPECT_NEAR(force_at(0.75) / force_at(0), 0.5, 1e-12);
}

TEST(SurfaceTensionSdfBaseline, TheCurvatureIsClampedToOneOverDx) {
  // A cone's tip: kappa is unbounded.
  const Problem p = problem_of({5, 5, 5}, 1, 0.5, [](double i, double j, double k) {
    return 0.5 * (0.125 * (i - 2) + 4 * ((j - 2) * (j - 2) + (k - 2) * (k - 2)));
  });
  EXPECT_NEAR(probe(p, {2, 2, 2}).curvature, 2 * 0.125, 1e-10);  // |grad phi| = 1/8
}

// A sphere through a cell: kappa = 2/R to second order.
TEST(SurfaceTensionSdfBaseline, ASphereHasCurvatureTwoOverRToSecondOrder) {
  std::array<double, 2> error;
  for (const int fine : {0, 1}) {
    const double radius = fine == 1 ? 25 : 12.5;  // (24, 7, 0)/25 lies on it
    const std::int64_t n = fine == 1 ? 60 : 32;
    const std::array<double, 3> centre{fine == 1 ? 26. : 14., fine == 1 ? 28. : 14.5, 15.};
    const Problem p = problem_of({n, n, 31}, 1, 1, [&](double i, double j, double k) {
      return std::sqrt((i - centre[0]) * (i - centre[0]) + (j - centre[1]) * (j - centre[1]) +
                       (k - centre[2]) * (k - centre[2])) -
             radius;
    });
    const std::array<std::int64_t, 3> at =
        fine == 1 ? std::array<std::int64_t, 3>{50, 35, 15} : std::array<std::int64_t, 3>{26, 18, 15};
    const Probe r = probe(p, at);
    error[static_cast<std::size_t>(fine)] = std::abs(r.curvature * radius / 2 - 1);
    // It points to the centre.
    EXPECT_NEAR(r.force[0] / r.force[1], 24.0 / 7, 0.02);
    EXPECT_LT(r.force[0], 0);
  }
  EXPECT_LT(error[0], 0.01);
  EXPECT_GT(error[0], 3.0 * error[1]);
}

// A catenoid-like saddle z = (x^2 - y^2)/(2R) has no mean curvature at its centre; tilting it must not change
// that beyond the order of the scheme. Away from it, z = x y / R needs the mixed difference.
TEST(SurfaceTensionSdfBaseline, ASaddleHasNoMeanCurvature) {
  const Problem p = problem_of({9, 9, 9}, 1, 1,
                               [](double i, double j, double k) { return (k - 4) - (i - 4) * (j - 4) / 16; });
  EXPECT_NEAR(probe(p, {4, 4, 4}).curvature, 0, 1e-12);
  // At (2, 4) off the centre: slope (-1/4, -1/8, 1), phi_xy = -1/16: bracket -2 phi_x phi_y phi_xy.
  const double bracket = 2 * (1.0 / 4) * (1.0 / 8) / 16, steep = 1 + 1.0 / 16 + 1.0 / 64;
  const Problem shifted = problem_of({9, 9, 12}, 1, 1, [](double i, double j, double k) {
    return (k - 4) - (i - 4 + 2) * (j - 4 + 4) / 16 + 0.5;
  });
  EXPECT_NEAR(probe(shifted, {4, 4, 4}).curvature, bracket / std::pow(steep, 1.5) * std::sqrt(steep), 1e-11);
}

// Across the interface of a sphere the force integrates to the pressure jump 2 sigma / R; all of it cancels.
TEST(SurfaceTensionSdfBaseline, TheForceIntegratesToLaplacesPressureAndToNothing) {
  const double radius = 14, sigma = 0.5, dx = 0.25;
  const Problem p = problem_of({41, 42, 43}, sigma, dx, [&](double i, double j, double k) {
    return dx * (std::sqrt((i - 20.3) * (i - 20.3) + (j - 21) * (j - 21) + (k - 21) * (k - 21)) - radius);
  });
  const Arrays out = run(p);
  const auto in = bind_inputs<surface_tension_sdf::Inputs>(p);
  double jump = 0;
  for (std::int64_t i = 20; i < 41; ++i) jump -= out[0].value(in.phi.offset(i, 21, 21)) * dx;
  EXPECT_NEAR(jump / (2 * sigma / (radius * dx)), 1, 0.01);
  for (const HostArray& f : out) {
    double sum = 0, size = 0;
    for (std::int64_t c = 0; c < f.size(); ++c) {
      sum += f.value(c);
      size += std::abs(f.value(c));
    }
    EXPECT_LT(std::abs(sum), 1e-3 * size);
  }
}

TEST(SurfaceTensionSdfBaseline, ExchangingAxesExchangesForces) {
  const Field phi = [](double i, double j, double k) {
    return 1.3 * std::sin(0.5 * i + 0.3 * j) + 0.9 * std::cos(0.4 * k - 0.2 * i);
  };
  const Problem p = problem_of({7, 8, 9}, 1, 1, phi);
  const Problem turned =
      problem_of({8, 9, 7}, 1, 1, [&](double j, double k, double i) { return phi(i, j, k); });
  const Arrays a = run(p), b = run(turned);
  const auto in = bind_inputs<surface_tension_sdf::Inputs>(p);
  const auto other = bind_inputs<surface_tension_sdf::Inputs>(turned);
  for (std::int64_t i = 0; i < 7; ++i) {
    for (std::int64_t j = 0; j < 8; ++j) {
      for (std::int64_t k = 0; k < 9; ++k) {
        for (std::size_t c = 0; c < 3; ++c) {
          ASSERT_NEAR(a[c].value(in.phi.offset(i, j, k)), b[(c + 2) % 3].value(other.phi.offset(j, k, i)),
                      1e-12);
        }
      }
    }
  }
}

}  // namespace
}  // namespace gpuphys
