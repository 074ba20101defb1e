// The serial baseline of p2g_apic, validated on its own: by hand, by the momenta that APIC keeps, and by
// affine fields.
#include <gtest/gtest.h>

#include "tests/mac_transfer.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using namespace testing::mac;

const Task& task() {
  return find_task("p2g_apic");
}

double at(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return u.value((i * u.shape()[1] + j) * u.shape()[2] + k);
}

TEST(P2gApicBaseline, OneParticleByHand) {
  // On the face (2,2,2) of ux, which sits at (2, 2.5, 2.5): it reaches one face more on either side along
  // each axis. dx = 1, so the velocity changes by 4 B a cell.
  Particle p{{2, 2.5, 2.5}, {1, 2, 3}, {}};
  p.b[0] = {0.25, 0.5, -1};
  const Arrays u = run_module(task(), "baseline_f64", problem(task(), {5, 5, 5}, {p}));
  for (std::int64_t i = -1; i <= 1; ++i) {
    for (std::int64_t j = -1; j <= 1; ++j) {
      for (std::int64_t k = -1; k <= 1; ++k) {
        EXPECT_DOUBLE_EQ(
            at(u[0], 2 + i, 2 + j, 2 + k),
            1 + static_cast<double>(i) + 2 * static_cast<double>(j) - 4 * static_cast<double>(k));
      }
    }
  }
  EXPECT_EQ(at(u[0], 0, 2, 2), 0);
  EXPECT_EQ(at(u[0], 4, 2, 2), 0);
  // uy: samples at (i + 1/2, j, k + 1/2). Along x and y the particle lies half way: the third sample has
  // weight 0.
  EXPECT_DOUBLE_EQ(at(u[1], 1, 2, 2), 2);
  EXPECT_DOUBLE_EQ(at(u[1], 2, 3, 1), 2);
  EXPECT_EQ(at(u[1], 0, 2, 2), 0);
  EXPECT_EQ(at(u[1], 3, 2, 2), 0);
}

TEST(P2gApicBaseline, MomentumAndItsMomentsArriveWhole) {
  // The sum of m u x over the faces is that of v x + B over the particles: with it angular momentum is kept.
  const Cells cells{8, 7, 9};
  const auto particles = inside(cells, 60, 84);
  const double dx = static_cast<double>(0.1f);
  const Problem p = problem(task(), cells, particles, dx);
  const Arrays u = run_module(task(), "baseline_f64", p);
  for (std::size_t c = 0; c < 3; ++c) {
    double momentum = 0, expected = 0;
    Vec3 moment{}, expected_moment{};
    each_face(u[c], c, [&](std::int64_t i, const Vec3& face) {
      const double m = mass(p, face, quadratic);
      momentum += m * u[c].value(i);
      for (std::size_t b = 0; b < 3; ++b) moment[b] += m * u[c].value(i) * face[b] * dx;
      EXPECT_EQ(m > 1e-12, u[c].value(i) != 0);
    });
    for (std::size_t q = 0; q < particles.size(); ++q) {
      expected += particles[q].v[c];
      for (std::size_t b = 0; b < 3; ++b)
        expected_moment[b] += particles[q].v[c] * p.inputs[0].value(static_cast<std::int64_t>(3 * q + b)) +
                              particles[q].b[c][b];
    }
    EXPECT_NEAR(momentum, expected, 1e-9);
    for (std::size_t b = 0; b < 3; ++b) EXPECT_NEAR(moment[b], expected_moment[b], 1e-9);
  }
}

TEST(P2gApicBaseline, AffineFieldsAreExact) {
  const Mat3 slope{{{0.5, -1, 2}, {0.25, 0.125, -0.75}, {1, 3, -2}}};
  std::vector<Particle> particles = inside({7, 7, 7}, 200, 85);
  for (Particle& p : particles) {
    for (double& x : p.x)
      x = std::floor(x * 512) / 512 * 1.75 - 2.5;  // outside as well; v is exact in float32
    for (std::size_t c = 0; c < 3; ++c) {
      p.v[c] = 1;
      for (std::size_t b = 0; b < 3; ++b) {
        p.v[c] += slope[c][b] * p.x[b];
        p.b[c][b] = slope[c][b] / 4;
      }
    }
  }
  const Arrays u = run_module(task(), "baseline_f64", problem(task(), {5, 4, 6}, particles));
  for (std::size_t c = 0; c < 3; ++c) {
    int moving = 0;
    each_face(u[c], c, [&](std::int64_t i, const Vec3& face) {
      if (u[c].value(i) == 0) return;
      ++moving;
      const double expected = 1 + slope[c][0] * face[0] + slope[c][1] * face[1] + slope[c][2] * face[2];
      EXPECT_NEAR(u[c].value(i), expected, 1e-11);
    });
    EXPECT_GT(moving, 80);
  }
}

TEST(P2gApicBaseline, AxesAreAlike) {
  expect_axes_alike(task());
}

TEST(P2gApicBaseline, TheSetsAreThoseOfThePaper) {
  expect_blocks_as_specified(task());
}

}  // namespace
}  // namespace gpuphys
