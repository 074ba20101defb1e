// The serial baseline of p2g_pic_flip, validated on its own: by hand, by conservation, and by the fields that
// the hat kernel reproduces.
#include <gtest/gtest.h>

#include "tests/mac_transfer.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using namespace testing::mac;

const Task& task() {
  return find_task("p2g_pic_flip");
}

double at(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return u.value((i * u.shape()[1] + j) * u.shape()[2] + k);
}

TEST(P2gPicFlipBaseline, TwoParticlesByHand) {
  // In cell (1,1,1) of 3^3: at x fractions 1/4 and 3/4, in the middle along y and z, so that only the cell's
  // own two faces across x have weight: 3/4 and 1/4 on the lower one, 1/4 and 3/4 on the upper one.
  const Arrays u =
      run_module(task(), "baseline_f64",
                 problem(task(), {3, 3, 3}, {{{1.25, 1.5, 1.5}, {1, 2, 3}}, {{1.75, 1.5, 1.5}, {5, 6, 7}}}));
  EXPECT_DOUBLE_EQ(at(u[0], 1, 1, 1), 0.75 * 1 + 0.25 * 5);
  EXPECT_DOUBLE_EQ(at(u[0], 2, 1, 1), 0.25 * 1 + 0.75 * 5);
  EXPECT_EQ(at(u[0], 1, 0, 1), 0);
  EXPECT_EQ(at(u[0], 3, 1, 1), 0);
  // Along y both share the faces' weights 1/2. Across x the first one reaches cells 0 and 1 with 1/4 and 3/4.
  EXPECT_DOUBLE_EQ(at(u[1], 1, 1, 1), (2 + 6) / 2.0);
  EXPECT_DOUBLE_EQ(at(u[1], 0, 1, 1), 2);
  EXPECT_DOUBLE_EQ(at(u[1], 2, 2, 1), 6);
  EXPECT_DOUBLE_EQ(at(u[2], 1, 1, 2), 5);
  EXPECT_EQ(at(u[2], 1, 1, 0), 0);
}

TEST(P2gPicFlipBaseline, MomentumArrivesWhole) {
  const auto particles = inside({7, 8, 9}, 80, 82);
  const Problem p = problem(task(), {7, 8, 9}, particles, 0.1f);
  const Arrays u = run_module(task(), "baseline_f64", p);
  for (std::size_t c = 0; c < 3; ++c) {
    double total = 0, momentum = 0, expected = 0;
    each_face(u[c], c, [&](std::int64_t i, const Vec3& face) {
      const double m = mass(p, face, hat);
      total += m;
      momentum += m * u[c].value(i);
      EXPECT_EQ(m > 1e-12, u[c].value(i) != 0);
    });
    for (const Particle& q : particles) expected += q.v[c];
    EXPECT_NEAR(total, 80, 1e-10);
    EXPECT_NEAR(momentum, expected, 1e-10);
  }
}

TEST(P2gPicFlipBaseline, WhatFallsOutsideIsDropped) {
  // One particle a quarter of a cell outside the wall x = 0, in the middle of cells along y and z.
  const Arrays u =
      run_module(task(), "baseline_f64", problem(task(), {2, 2, 2}, {{{-0.25, 0.5, 0.5}, {1, 2, 3}}}));
  EXPECT_DOUBLE_EQ(at(u[0], 0, 0, 0), 1);  // weight 3/4, and nothing else there
  EXPECT_EQ(at(u[0], 1, 0, 0), 0);
  EXPECT_DOUBLE_EQ(at(u[1], 0, 0, 0), 2);  // weight 1/4 1/2
  EXPECT_DOUBLE_EQ(at(u[2], 0, 0, 1), 3);
  EXPECT_EQ(at(u[1], 1, 0, 0), 0);
}

TEST(P2gPicFlipBaseline, ALinearFieldIsReproducedToFirstOrder) {
  // Eight particles a cell, symmetric: exact inside; jittered ones leave an error that halves with the cells.
  const auto error = [](std::int64_t cells, double jitter) {
    std::vector<Particle> particles;
    const double dx = 1.0 / static_cast<double>(cells);
    for (std::uint64_t q = 0; q < static_cast<std::uint64_t>(8 * cells * cells * cells); ++q) {
      Particle p;
      const std::uint64_t side = 2 * static_cast<std::uint64_t>(cells);
      const std::array<std::uint64_t, 3> half{q / side / side, q / side % side, q % side};
      for (std::size_t d = 0; d < 3; ++d)
        p.x[d] = 0.25 + 0.5 * static_cast<double>(half[d]) + jitter * uniform11(83, 0, 3 * q + d);
      p.v = {p.x[1] * dx, p.x[2] * dx, p.x[0] * dx};
      particles.push_back(p);
    }
    const Arrays u =
        run_module(task(), "baseline_f64", problem(task(), {cells, cells, cells}, particles, dx));
    double square = 0;
    int faces = 0;
    each_face(u[0], 0, [&](std::int64_t i, const Vec3& face) {
      if (face[1] < 1 || face[1] > static_cast<double>(cells) - 1) return;
      square += std::pow(u[0].value(i) - face[1] * dx, 2);
      ++faces;
    });
    return std::sqrt(square / faces);
  };
  EXPECT_LT(error(6, 0), 1e-7);  // float32 inputs
  const double coarse = error(6, 0.2), fine = error(12, 0.2);
  EXPECT_GT(coarse, 1e-3);
  EXPECT_NEAR(coarse / fine, 2, 0.25);
}

TEST(P2gPicFlipBaseline, AxesAreAlike) {
  expect_axes_alike(task());
}

TEST(P2gPicFlipBaseline, TheSetsAreThoseOfThePaper) {
  expect_blocks_as_specified(task());
}

}  // namespace
}  // namespace gpuphys
