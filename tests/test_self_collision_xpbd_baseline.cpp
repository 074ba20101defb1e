// The serial baseline of self_collision_xpbd, validated on its own: by hand, by closed forms, by conservation
// and against all pairs tested one by one.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using Points = std::vector<std::array<double, 3>>;

struct Solver {
  double thickness = 1, radius = 1.25, compliance = 0, dt = 1, relaxation = 0.5;
  int iterations = 1;
};

Points solved(const Points& x, const Solver& s, const std::vector<double>& inv_mass = {}) {
  const Task& task = find_task("self_collision_xpbd");
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(x.size())}});
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) p.inputs[0].as<float>()[3 * i + d] = static_cast<float>(x[i][d]);
    p.inputs[1].as<float>()[i] = inv_mass.empty() ? 1.0f : static_cast<float>(inv_mass[i]);
  }
  p.set_scalar("thickness", s.thickness);
  p.set_scalar("search_radius", s.radius);
  p.set_scalar("compliance", s.compliance);
  p.set_scalar("dt", s.dt);
  p.set_scalar("relaxation", s.relaxation);
  p.set_scalar("iters", s.iterations);
  const Arrays out = run_module(task, "baseline_f64", p);
  Points moved(x.size());
  for (std::int64_t i = 0; i < out[0].size(); ++i)
    moved[static_cast<std::size_t>(i / 3)][static_cast<std::size_t>(i % 3)] = out[0].value(i);
  return moved;
}

TEST(SelfCollisionXpbdBaseline, OneSweepByHand) {
  // Distance 1/2, thickness 1: C = -1/2. With w = 1 and relaxation 1/2 the multiplier becomes 1/8.
  EXPECT_EQ(solved({{0, 0, 0}, {0, 0.5, 0}}, {}), (Points{{0, -0.125, 0}, {0, 0.625, 0}}));
}

TEST(SelfCollisionXpbdBaseline, TheGapClosesGeometrically) {
  Solver s;
  for (s.iterations = 1; s.iterations < 8; ++s.iterations) {
    const Points x = solved({{0, 0, 0}, {0, 0.5, 0}}, s);
    EXPECT_NEAR(1 - (x[1][1] - x[0][1]), 0.5 * std::pow(0.5, s.iterations), 1e-15);
  }
}

TEST(SelfCollisionXpbdBaseline, ComplianceLeavesAGap) {
  // At rest, C + alpha~ lambda = 0 and C = -1/2 + 2 lambda: lambda = 0.5/(2 + alpha~) with alpha~ = 3/0.5^2
  // = 12.
  const Points x = solved({{0, 0, 0}, {0, 0.5, 0}}, {1, 1.25, 3, 0.5, 0.5, 200});
  EXPECT_NEAR(x[1][1] - x[0][1], 0.5 + 2 * 0.5 / 14, 1e-14);
}

TEST(SelfCollisionXpbdBaseline, OpenContactsDoNotPull) {
  const Points x{{0, 0, 0}, {0, 1.125, 0}};
  EXPECT_EQ(solved(x, {1, 1.25, 0, 1, 1, 5}), x);
}

TEST(SelfCollisionXpbdBaseline, TheRadiusItselfIsOutside) {
  // The second is pushed towards the third, which is a contact of its own only if it was nearer than the
  // radius.
  const Points at{{0, -0.25, 0}, {0, 0, 0}, {0, 1.25, 0}},
      inside{{0, -0.25, 0}, {0, 0, 0}, {0, 1.2421875, 0}};
  const Solver s{1, 1.25, 0, 1, 0.5, 4};
  EXPECT_EQ(solved(at, s)[2], at[2]);
  EXPECT_NE(solved(inside, s)[2], inside[2]);
}

TEST(SelfCollisionXpbdBaseline, WhatIsPinnedOrCoincidentStays) {
  const Points x{{0, 0, 0}, {0, 0.5, 0}, {9, 9, 9}, {9, 9, 9}};
  const Points moved = solved(x, {}, {0, 1, 1, 1});
  EXPECT_EQ(moved[0], x[0]);
  EXPECT_EQ(moved[1], (std::array<double, 3>{0, 0.75, 0}));
  EXPECT_EQ(moved[2], x[2]);
  EXPECT_EQ(moved[3], x[3]);
}

Points cloud(std::size_t n, double size) {
  Points x(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < 3; ++d)
      x[i][d] = static_cast<double>(static_cast<float>(size * uniform11(91, 0, 3 * i + d)));
  }
  return x;
}

TEST(SelfCollisionXpbdBaseline, ACloudAgreesWithAllPairs) {
  const Points x = cloud(1000, 5);
  const Solver s{1, 1.25, 0, 1, 0.25, 1};
  Points expected = x;
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) {
      const double dx = x[i][0] - x[j][0], dy = x[i][1] - x[j][1], dz = x[i][2] - x[j][2];
      const double length = std::sqrt(dx * dx + dy * dy + dz * dz);
      if (i == j || length >= 1) continue;
      const double push = 0.25 * (1 - length) / 2 / length;
      expected[i][0] += push * dx;
      expected[i][1] += push * dy;
      expected[i][2] += push * dz;
    }
  }
  const Points moved = solved(x, s);
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(moved[i][d], expected[i][d], 1e-13) << i;
  }
}

TEST(SelfCollisionXpbdBaseline, MomentumStays) {
  const Points x = cloud(500, 3);
  std::vector<double> w;
  for (std::size_t i = 0; i < x.size(); ++i) w.push_back(0.5 + uniform01(91, 1, i));
  for (double& v : w) v = static_cast<double>(static_cast<float>(v));
  const Points moved = solved(x, {1, 1.25, 0.1, 0.5, 0.25, 8}, w);
  double total = 0;
  for (std::size_t d = 0; d < 3; ++d) {
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      sum += (moved[i][d] - x[i][d]) / w[i];
      total += std::abs(moved[i][d] - x[i][d]);
    }
    EXPECT_NEAR(sum, 0, 1e-10);
  }
  EXPECT_GT(total, 1);
}

TEST(SelfCollisionXpbdBaseline, OverlapFalls) {
  const Points x = cloud(300, 3);
  const auto overlap = [](const Points& p) {
    double sum = 0;
    for (std::size_t i = 0; i < p.size(); ++i) {
      for (std::size_t j = 0; j < i; ++j) {
        const double dx = p[i][0] - p[j][0], dy = p[i][1] - p[j][1], dz = p[i][2] - p[j][2];
        sum += std::pow(std::max(0.0, 1 - std::sqrt(dx * dx + dy * dy + dz * dz)), 2);
      }
    }
    return sum;
  };
  EXPECT_LT(overlap(solved(x, {1, 2, 0, 1, 0.1, 8})), 0.5 * overlap(x));
}

}  // namespace
}  // namespace gpuphys
