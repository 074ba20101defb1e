// The serial baseline of contact_dem, validated on its own: by hand, by closed forms, by brute force, by what
// a force between pairs must obey, and in a time loop.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <set>
#include <vector>

#include "cases/local_interaction/contact_dem.hpp"
#include "cases/local_interaction/grain_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/contact_dem.hpp"

namespace gpuphys {
namespace {

using grains::Grain;
using grains::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("contact_dem");
}

Problem problem_of(const std::vector<Grain>& grains, double kn = 600, double cn = 10) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(grains.size())}});
  p.set_scalar("kn", kn);
  p.set_scalar("cn", cn);
  for (std::size_t i = 0; i < grains.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      p.inputs[0].as<float>()[3 * i + c] = static_cast<float>(grains[i].x[c]);
      p.inputs[1].as<float>()[3 * i + c] = static_cast<float>(grains[i].v[c]);
    }
    p.inputs[2].as<float>()[i] = static_cast<float>(grains[i].radius);
  }
  return p;
}

std::vector<Vec3> forces(const Problem& p) {
  const Arrays out = run_module(task(), "baseline_f64", p);
  std::vector<Vec3> all(static_cast<std::size_t>(out[0].shape()[0]));
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) all[i][c] = out[0].value(static_cast<std::int64_t>(3 * i + c));
  }
  return all;
}

void expect_vec(const Vec3& got, const Vec3& expected, double tolerance = 0) {
  for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(got[c], expected[c], tolerance) << "component " << c;
}

// Radii 1/2, so r* = 1/4; overlap 1/4, so sqrt(r* overlap) = 1/4 and kn overlap = 150 N/m.
std::vector<Grain> hand_pair(const Vec3& v0) {
  return {{{1.75, 2, 3}, v0, 0.5}, {{1, 2, 3}, {0, 0, 0}, 0.5}};
}

TEST(ContactDemBaseline, TwoGrainsByHand) {
  const auto at_rest = forces(problem_of(hand_pair({0, 0, 0})));
  expect_vec(at_rest[0], {37.5, 0, 0});
  expect_vec(at_rest[1], {-37.5, 0, 0});
  // Separation at 1 m/s takes 10 N off each 1/4: (150 - 10) / 4; approach adds as much.
  expect_vec(forces(problem_of(hand_pair({1, 0, 0})))[0], {35, 0, 0});
  expect_vec(forces(problem_of(hand_pair({-1, 0, 0})))[0], {40, 0, 0});
}

TEST(ContactDemBaseline, FastSeparationDoesNotPull) {
  expect_vec(forces(problem_of(hand_pair({14, 0, 0})))[0], {2.5, 0, 0});
  expect_vec(forces(problem_of(hand_pair({15, 0, 0})))[0], {0, 0, 0});
  expect_vec(forces(problem_of(hand_pair({40, 0, 0})))[0], {0, 0, 0});
}

TEST(ContactDemBaseline, SlidingDoesNotMatter) {
  expect_vec(forces(problem_of(hand_pair({1, 7, -5})))[0], {35, 0, 0});
}

TEST(ContactDemBaseline, TheElasticForceGrowsWithOverlapToThreeHalves) {
  const auto force = [](double overlap) {
    return forces(problem_of({{{0, 0, 0}, {0, 0, 0}, 0.5}, {{0, 0, 1 - overlap}, {0, 0, 0}, 0.5}}))[1][2];
  };
  EXPECT_NEAR(force(0.25) / force(0.0625), 8, 1e-12);
  EXPECT_NEAR(force(0.5) / force(0.125), 8, 1e-12);
  EXPECT_EQ(force(0), 0);
  EXPECT_EQ(force(-0.125), 0);
}

TEST(ContactDemBaseline, RadiiEnterThroughTheirHarmonicMean) {
  // r* = 1/2 x 3/2 / 2 = 3/8, overlap 1/4: sqrt(3/32) x 150.
  const auto f = forces(problem_of({{{0, 0, 0}, {0, 0, 0}, 0.5}, {{0, 1.75, 0}, {0, 0, 0}, 1.5}}));
  expect_vec(f[1], {0, std::sqrt(3.0 / 32) * 150, 0}, 1e-12);
}

TEST(ContactDemBaseline, CoincidentCentresFeelNothingFromEachOther) {
  const auto f = forces(
      problem_of({{{1, 1, 1}, {3, 0, 0}, 0.5}, {{1, 1, 1}, {0, 0, 0}, 0.5}, {{1.75, 1, 1}, {0, 0, 0}, 0.5}}));
  // Each of the two pushes the third one, which moves away from the first at -3 m/s.
  expect_vec(f[0], {-(150.0 + 30) / 4, 0, 0});
  expect_vec(f[1], {-37.5, 0, 0});
  expect_vec(f[2], {37.5 + 45, 0, 0});
}

// Every pair by the formulas of the specification.
std::vector<Vec3> brute_force(const Problem& p) {
  const auto in = bind_inputs<contact_dem::Inputs>(p);
  const std::int64_t n = in.radius.shape[0];
  std::vector<Vec3> f(static_cast<std::size_t>(n), Vec3{0, 0, 0});
  for (std::int64_t i = 0; i < n; ++i) {
    for (std::int64_t j = 0; j < n; ++j) {
      Vec3 d, w;
      double dd = 0, wd = 0;
      for (std::size_t c = 0; c < 3; ++c) {
        d[c] = static_cast<double>(in.x(i, c)) - static_cast<double>(in.x(j, c));
        w[c] = static_cast<double>(in.v(i, c)) - static_cast<double>(in.v(j, c));
        dd += d[c] * d[c];
        wd += d[c] * w[c];
      }
      const double distance = std::sqrt(dd), ri = in.radius(i), rj = in.radius(j),
                   overlap = ri + rj - distance;
      if (i == j || distance == 0 || overlap <= 0) continue;
      const double size = std::sqrt(ri * rj / (ri + rj) * overlap) *
                          (static_cast<double>(in.kn) * overlap - static_cast<double>(in.cn) * wd / distance);
      if (size <= 0) continue;
      for (std::size_t c = 0; c < 3; ++c) f[static_cast<std::size_t>(i)][c] += size * d[c] / distance;
    }
  }
  return f;
}

TEST(ContactDemBaseline, FindsThePairsThatAllPairsFinds) {
  for (const std::string set : {"hard_size_ratio_100", "hard_far_apart", "hard_coincident", "hard_line_z"}) {
    const Problem p = task().set(set).make();
    const std::vector<Vec3> got = forces(p), expected = brute_force(p);
    double scale = 0;
    for (const Vec3& f : expected) scale = std::max({scale, std::abs(f[0]), std::abs(f[1]), std::abs(f[2])});
    EXPECT_GT(scale, 0) << set;
    for (std::size_t i = 0; i < got.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c)
        ASSERT_NEAR(got[i][c], expected[i][c], 1e-12 * scale) << set << " " << i;
    }
  }
}

TEST(ContactDemBaseline, OrderOfTheGrainsAndFrameOfReferenceDoNotMatter) {
  const grains::Packing packing{{7, 9, 8}, 5, 0.12, 0.5, 0.6, 0.01, 0.5};
  std::vector<Grain> all = grains::packing(packing);
  const std::vector<Vec3> before = forces(problem_of(all));
  std::reverse(all.begin(), all.end());
  for (Grain& g : all) {
    std::rotate(g.x.begin(), g.x.begin() + 1, g.x.end());
    std::rotate(g.v.begin(), g.v.begin() + 1, g.v.end());
  }
  const std::vector<Vec3> after = forces(problem_of(all));
  for (std::size_t i = 0; i < before.size(); ++i) {
    Vec3 expected = before[i];
    std::rotate(expected.begin(), expected.begin() + 1, expected.end());
    expect_vec(after[before.size() - 1 - i], expected, 1e-11);
  }
}

TEST(ContactDemBaseline, ForcesBalance) {
  const std::vector<Vec3> f = forces(task().set("public_smoke").make());
  for (std::size_t c = 0; c < 3; ++c) {
    double sum = 0, size = 0;
    for (const Vec3& g : f) {
      sum += g[c];
      size += std::abs(g[c]);
    }
    EXPECT_LT(std::abs(sum), 1e-13 * size);
  }
}

TEST(GrainPacking, IsAPermutationOfTheJitteredLattice) {
  const grains::Packing packing{{5, 6, 7}, 3, 0.12, 0.5, 0.6, 0.01, 0.5, {10, 20, 30}};
  std::set<std::array<long, 3>> points;
  std::size_t in_place = 0, index = 0;
  for (const Grain& g : grains::packing(packing)) {
    std::array<long, 3> point;
    for (std::size_t c = 0; c < 3; ++c) {
      const double x = g.x[c] - packing.corner[c];
      point[c] = std::lround(x);
      EXPECT_LE(std::abs(x - static_cast<double>(point[c])), 0.12 + 1e-12);
    }
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_LE(std::abs(g.v[c] - (c == 0 ? 0.01 * static_cast<double>(point[2]) : 0)), 0.5 + 1e-12);
    }
    EXPECT_GE(g.radius, 0.5);
    EXPECT_LE(g.radius, 0.6);
    points.insert(point);
    in_place += static_cast<std::size_t>(point[0] * 42 + point[1] * 7 + point[2]) == index++;
  }
  EXPECT_EQ(points.size(), 210u);
  EXPECT_LT(in_place, 10u);
}

TEST(ContactDemBaseline, AGranularGasConservesMomentumAndLosesEnergy) {
  testing::time_loop_contact_dem("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
