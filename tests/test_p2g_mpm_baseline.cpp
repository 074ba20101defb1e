// The serial baseline of p2g_mpm, validated on its own: by hand, by conservation, and against the energy that
// the stress derives from.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>

#include "core/generators/random.hpp"
#include "serial_baselines/particle_grid/elasticity.hpp"
#include "serial_baselines/particle_grid/quadratic_spline.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/p2g_mpm.hpp"

namespace gpuphys {
namespace {

using particle_blocks::diagonal;
using particle_blocks::Mat3;
using particle_blocks::product;
using particle_blocks::random_rotation;
using particle_blocks::transposed;
using particle_blocks::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("p2g_mpm");
}

struct Particle {
  Vec3 cell, v;
  Mat3 f;
};

// dx = dt = m = V0 = 1, so that numbers are easy.
Problem unit_problem(const Shape& nodes, const std::vector<Particle>& particles, double mu, double lambda) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                             {"nx", nodes[0]},
                                             {"ny", nodes[1]},
                                             {"nz", nodes[2]}});
  for (const char* name : {"dx", "dt", "mass_p", "V0"}) p.set_scalar(name, 1);
  p.set_scalar("mu", mu);
  p.set_scalar("lambda", lambda);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t a = 0; a < 3; ++a) {
      p.inputs[0].as<float>()[3 * q + a] = static_cast<float>(particles[q].cell[a]);
      p.inputs[1].as<float>()[3 * q + a] = static_cast<float>(particles[q].v[a]);
      for (std::size_t b = 0; b < 3; ++b)
        p.inputs[2].as<float>()[9 * q + 3 * a + b] = static_cast<float>(particles[q].f[a][b]);
    }
  }
  return p;
}

double at(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return u.value((i * u.shape()[1] + j) * u.shape()[2] + k);
}

// The spline as a function of the distance between node and particle, in cells.
double spline(double r) {
  const double a = std::abs(r);
  if (a < 0.5) return 0.75 - a * a;
  return a < 1.5 ? 0.5 * (1.5 - a) * (1.5 - a) : 0.0;
}

// Masses of all nodes, by a sum over all particles at each node.
std::vector<double> node_masses(const Problem& p, const Shape& n) {
  std::vector<double> mass;
  for (std::int64_t i = 0; i < n[0]; ++i) {
    for (std::int64_t j = 0; j < n[1]; ++j) {
      for (std::int64_t k = 0; k < n[2]; ++k) {
        double m = 0;
        for (std::int64_t q = 0; q < p.inputs[0].shape()[0]; ++q) {
          const auto g = [&](std::int64_t d) { return p.inputs[0].value(3 * q + d) / p.scalar("dx"); };
          m += spline(g(0) - static_cast<double>(i)) * spline(g(1) - static_cast<double>(j)) *
               spline(g(2) - static_cast<double>(k));
        }
        mass.push_back(m);
      }
    }
  }
  return mass;
}

Mat3 random_matrix(std::uint64_t item, double jitter) {
  Mat3 f = diagonal(1, 1, 1);
  for (std::size_t e = 0; e < 9; ++e) f[e / 3][e % 3] += jitter * uniform11(71, 0, 9 * item + e);
  return f;
}

double distance(const Mat3& a, const Mat3& b) {
  double largest = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) largest = std::max(largest, std::abs(a[i][j] - b[i][j]));
  }
  return largest;
}

TEST(P2gMpmBaseline, OneParticleByHand) {
  // On node (2,2,2): weights 1/8, 3/4, 1/8 and slopes -1/2, 0, 1/2 along each axis. F = diag(2, 1, 1), so R =
  // I, J = 2 and tau = diag(2 mu 1 2 + lambda 2, 2 lambda, 2 lambda) = diag(10, 6, 6) for mu = 1, lambda = 3.
  const Problem p = unit_problem({5, 5, 5}, {{{2, 2, 2}, {1, 2, 3}, diagonal(2, 1, 1)}}, 1, 3);
  const Arrays u = run_module(task(), "baseline_f64", p);
  // u = v - tau grad w / w: along each axis grad w / w = slope / weight = -4, 0, 4.
  for (std::int64_t i = -1; i <= 1; ++i) {
    for (std::int64_t j = -1; j <= 1; ++j) {
      for (std::int64_t k = -1; k <= 1; ++k) {
        EXPECT_NEAR(at(u[0], 2 + i, 2 + j, 2 + k), 1 - 10.0 * 4 * static_cast<double>(i), 1e-12);
        EXPECT_NEAR(at(u[1], 2 + i, 2 + j, 2 + k), 2 - 6.0 * 4 * static_cast<double>(j), 1e-12);
        EXPECT_NEAR(at(u[2], 2 + i, 2 + j, 2 + k), 3 - 6.0 * 4 * static_cast<double>(k), 1e-12);
      }
    }
  }
  EXPECT_EQ(at(u[0], 0, 2, 2), 0);
  EXPECT_EQ(at(u[1], 2, 4, 2), 0);
}

TEST(P2gMpmBaseline, MassAndMomentumArriveWhole) {
  std::vector<Particle> particles;
  Vec3 expected{};
  for (std::uint64_t q = 0; q < 60; ++q) {
    Particle particle;
    for (std::uint64_t d = 0; d < 3; ++d) {
      particle.cell[d] = static_cast<double>(static_cast<float>(2 + 4 * uniform01(72, 0, 3 * q + d)));
      particle.v[d] = static_cast<double>(static_cast<float>(uniform11(72, 1, 3 * q + d)));
      expected[d] += particle.v[d];
    }
    particle.f = random_matrix(q, 0.2);
    particles.push_back(particle);
  }
  const Problem p = unit_problem({9, 9, 9}, particles, 0.7, 0.4);
  const Arrays u = run_module(task(), "baseline_f64", p);
  const std::vector<double> mass = node_masses(p, {9, 9, 9});
  double total = 0;
  Vec3 momentum{};
  for (std::size_t i = 0; i < mass.size(); ++i) {
    total += mass[i];
    for (std::size_t d = 0; d < 3; ++d) momentum[d] += mass[i] * u[d].value(static_cast<std::int64_t>(i));
    EXPECT_EQ(mass[i] == 0, u[0].value(static_cast<std::int64_t>(i)) == 0);
  }
  EXPECT_NEAR(total, 60, 1e-10);
  for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(momentum[d], expected[d], 1e-10);  // internal forces cancel
}

TEST(P2gMpmBaseline, WeightsAreAPartitionOfUnityWithLinearPrecision) {
  for (const double g : {0.5, 0.75, 1.0, 1.2, 1.4999, 1.5, 17.3}) {
    const serial::QuadraticSpline<double> s(g);
    double sum = 0, slope = 0, moment = 0;
    for (std::size_t o = 0; o < 3; ++o) {
      const double node = static_cast<double>(s.base) + static_cast<double>(o);
      sum += s.weight[o];
      slope += s.slope[o];
      moment += s.weight[o] * node;
      EXPECT_NEAR(s.weight[o], spline(g - node), 1e-14);
      const double h = 1e-6;
      EXPECT_NEAR(s.slope[o], (spline(g + h - node) - spline(g - h - node)) / (2 * h), 2e-6);
    }
    EXPECT_NEAR(sum, 1, 1e-14);
    EXPECT_NEAR(slope, 0, 1e-14);
    EXPECT_NEAR(moment, g, 1e-13);
  }
}

TEST(P2gMpmBaseline, TheRotationIsTheOneThatWasPutIn) {
  for (std::uint64_t q = 0; q < 300; ++q) {
    // F = R S with S symmetric; R is the answer when S = Q diag Q^T has det > 0, or its smallest value is
    // negative.
    const Mat3 axes = random_rotation(73, 2 * q), r = random_rotation(73, 2 * q + 1);
    const double last = q % 3 == 0 ? 0.6 : (q % 3 == 1 ? -0.3 : 1e-9);
    const Mat3 s = product(product(axes, diagonal(1.3, 0.8, last)), transposed(axes));
    EXPECT_LT(distance(serial::nearest_rotation<double>(product(r, s)), r), 1e-12) << q;
  }
}

TEST(P2gMpmBaseline, TheRotationOfAnyMatrixIsARotation) {
  const std::array<Mat3, 8> matrices{diagonal(0, 0, 0),       diagonal(3, 0, 0),
                                     diagonal(0, -2, 0),      diagonal(1e-20, 1, 0),
                                     diagonal(-1, -1, -1),    diagonal(20, 20, 20),
                                     diagonal(0.05, 0.05, 0), Mat3{{{1, 1, 1}, {1, 1, 1}, {1, 1, 1}}}};
  for (const Mat3& f : matrices) {
    const Mat3 r = serial::nearest_rotation<double>(f);
    EXPECT_LT(distance(product(transposed(r), r), diagonal(1, 1, 1)), 1e-13);
    EXPECT_NEAR(serial::determinant<double>(r), 1, 1e-13);
  }
}

TEST(P2gMpmBaseline, TheStressIsTheDerivativeOfTheEnergy) {
  // tau_ab = sum_c dPsi/dF_ac F_bc: the energy's change when the material is strained by a small (I + e) F.
  constexpr double mu = 2, lambda = 3, h = 1e-5;
  for (std::uint64_t q = 0; q < 20; ++q) {
    const Mat3 f = product(random_rotation(74, q), random_matrix(q + 100, 0.3));
    const serial::Matrix3<double> tau = serial::kirchhoff_stress<double>(f, mu, lambda);
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) {
        Mat3 more = diagonal(1, 1, 1), less = more;
        more[a][b] += h;
        less[a][b] -= h;
        const double slope = (testing::p2g_mpm_loop::energy_density(product(more, f), mu, lambda) -
                              testing::p2g_mpm_loop::energy_density(product(less, f), mu, lambda)) /
                             (2 * h);
        EXPECT_NEAR(tau[a][b], slope, 1e-8);
      }
    }
  }
}

TEST(P2gMpmBaseline, AHomogeneousBodyFeelsForcesAtItsSurfaceOnly) {
  std::vector<Particle> particles;
  for (const auto& x : particle_blocks::ball({14, 14, 14}, 4.6))
    particles.push_back({{x[0], x[1], x[2]}, {1, 0, 0}, diagonal(1.2, 0.9, 1.1)});
  const Arrays u = run_module(task(), "baseline_f64", unit_problem({14, 14, 14}, particles, 1, 1));
  EXPECT_NEAR(at(u[0], 7, 7, 7), 1, 1e-13);
  EXPECT_NEAR(at(u[1], 6, 8, 7), 0, 1e-13);
  EXPECT_GT(std::abs(at(u[0], 2, 7, 7) - 1), 0.1);
}

TEST(P2gMpmBaseline, AnInterchangeOfAxesInterchangesTheResult) {
  const auto build = [](bool exchanged) {
    std::vector<Particle> particles;
    const std::array<std::size_t, 3> to =
        exchanged ? std::array<std::size_t, 3>{1, 0, 2} : std::array<std::size_t, 3>{0, 1, 2};
    for (std::uint64_t q = 0; q < 40; ++q) {
      Particle particle;
      const Mat3 f = random_matrix(q, 0.3);
      for (std::size_t a = 0; a < 3; ++a) {
        particle.cell[to[a]] = -1 + 8 * uniform01(75, 0, 3 * q + a);
        particle.v[to[a]] = uniform11(75, 1, 3 * q + a);
        for (std::size_t b = 0; b < 3; ++b) particle.f[to[a]][to[b]] = f[a][b];
      }
      particles.push_back(particle);
    }
    return unit_problem(exchanged ? Shape{6, 5, 7} : Shape{5, 6, 7}, particles, 0.3, 0.2);
  };
  const Arrays a = run_module(task(), "baseline_f64", build(false));
  const Arrays b = run_module(task(), "baseline_f64", build(true));
  for (std::size_t c = 0; c < 3; ++c) {
    const HostArray& w = b[c == 2 ? 2 : 1 - c];
    for (std::int64_t i = 0; i < 5; ++i) {
      for (std::int64_t j = 0; j < 6; ++j) {
        for (std::int64_t k = 0; k < 7; ++k) {
          const double expected = at(w, j, i, k);
          ASSERT_NEAR(at(a[c], i, j, k), expected, 1e-9 * (1 + std::abs(expected)));
        }
      }
    }
  }
}

TEST(P2gMpmBaseline, TheSetsAreThoseOfThePaper) {
  EXPECT_EQ(particle_blocks::ball({256, 256, 256}, 0.3107 * 256).size(), 16862656u);
  const auto order = particle_blocks::random_order(1000, 3);
  auto sorted = order;
  std::sort(sorted.begin(), sorted.end());
  for (std::size_t i = 0; i < sorted.size(); ++i) ASSERT_EQ(sorted[i], i);
  for (std::size_t i = 1; i < order.size(); ++i)
    ASSERT_LE(random_bits(3, 99, order[i - 1]), random_bits(3, 99, order[i]));
  // The sparse mutant that loses the last partial block needs one.
  for (const char* set : {"public_smoke", "hidden_smoke"})
    EXPECT_NE(task().set(set).make().inputs[0].shape()[0] % 1024, 0) << set;
}

TEST(P2gMpmBaseline, AHundredStepsKeepMomentumAndEnergy) {
  testing::time_loop_p2g_mpm("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
