// The serial baseline of viscosity_pbf, validated on its own: by hand, by all pairs, by what viscosity must
// obey; and the particles that the position-based fluid tasks share.
#include <gtest/gtest.h>

#include <array>
#include <set>

#include "tests/fluid_baseline.hpp"

namespace gpuphys::testing {
namespace {

const std::string kTask = "viscosity_pbf";

// W(0) at h = 2.
const double kPeak = 315 / (64 * std::numbers::pi * 8);

TEST(ViscosityPbfBaseline, APairAtHalfHByHand) {
  // (1 - 1/4)^3 = 27/64; half of the difference of 4 m/s, weighted.
  const auto v = truth_of(
      kTask, fluid_problem(kTask, {{{0, 0, 0}, {4, 0, 0}}, {{0, 1, 0}, {0, 0, 0}}}, {{"h", 2}, {"c", 0.5}}));
  expect_vec(v[0], {4 - 2 * kPeak * 27 / 64, 0, 0}, 1e-14);
  expect_vec(v[1], {2 * kPeak * 27 / 64, 0, 0}, 1e-14);
}

TEST(ViscosityPbfBaseline, CoincidentParticlesExchangeVelocity) {
  const auto v = truth_of(
      kTask, fluid_problem(kTask, {{{1, 1, 1}, {0, 0, 8}}, {{1, 1, 1}, {0, 0, 0}}}, {{"h", 2}, {"c", 0.25}}));
  expect_vec(v[1], {0, 0, 2 * kPeak}, 1e-14);
}

TEST(ViscosityPbfBaseline, HItselfIsNotNear) {
  const auto v = truth_of(
      kTask, fluid_problem(kTask, {{{0, 0, 0}, {1, 2, 3}}, {{0, 0, 2}, {0, 0, 0}}}, {{"h", 2}, {"c", 1e9}}));
  expect_vec(v[0], {1, 2, 3}, 0);
  expect_vec(v[1], {0, 0, 0}, 0);
}

TEST(ViscosityPbfBaseline, FindsThePairsThatAllPairsFinds) {
  for (const std::string set : {"hard_coincident", "hard_far_apart", "hard_h_1_37", "hard_line_z"}) {
    const Problem p = find_task(kTask).set(set).make();
    const double h = p.scalar("h"), c = p.scalar("c");
    const std::vector<Vec3> x = vectors(p.inputs[0]), v = vectors(p.inputs[1]);
    std::vector<Vec3> expected = v;
    for (std::size_t i = 0; i < x.size(); ++i) {
      for (std::size_t j = 0; j < x.size(); ++j) {
        const double w = poly6(length(plus(x[i], -1, x[j])), h);
        if (i != j && w > 0) expected[i] = plus(expected[i], c * w, plus(v[j], -1, v[i]));
      }
    }
    expect_all(truth_of(kTask, p), expected, 1e-12);
  }
}

TEST(ViscosityPbfBaseline, AUniformFlowIsLeftAlone) {
  Particles all = fluid::block(test_block());
  for (Particle& p : all) p.v = {3, -1, 0.5};
  for (const Vec3& v : truth_of(kTask, fluid_problem(kTask, all, {{"h", 2}, {"c", 0.5}})))
    expect_vec(v, {3, -1, 0.5}, 0);
}

TEST(ViscosityPbfBaseline, ALinearFlowIsLeftAloneInsideALattice) {
  Particles all = fluid::block({.lattice = {7, 8, 9}, .corner = {0, 0, 0}});
  for (Particle& p : all) p.v = {p.x[1] - 2 * p.x[2], p.x[0], 3 * p.x[2]};
  const auto v = truth_of(kTask, fluid_problem(kTask, all, {{"h", 2}, {"c", 0.3}}));
  int inside = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Vec3& x = all[i].x;
    if (std::min({x[0], x[1], x[2], 6 - x[0], 7 - x[1], 8 - x[2]}) < 2) continue;
    ++inside;
    expect_vec(v[i], all[i].v, 1e-13, i);
  }
  EXPECT_EQ(inside, 3 * 4 * 5);
}

TEST(ViscosityPbfBaseline, MomentumStaysAndEnergyFalls) {
  const Problem p = fluid_problem(kTask, fluid::block(test_block()), {{"h", 2}, {"c", 0.3}});
  const std::vector<Vec3> before = vectors(p.inputs[1]), after = truth_of(kTask, p);
  expect_vec(sum(after), sum(before), 1e-11);
  double energy_before = 0, energy_after = 0;
  for (const Vec3& v : before) energy_before += dot(v, v);
  for (const Vec3& v : after) energy_after += dot(v, v);
  EXPECT_LT(energy_after, 0.97 * energy_before);
}

TEST(ViscosityPbfBaseline, OrderAndAxesDoNotMatter) {
  const Particles all = fluid::block(test_block());
  const auto before = truth_of(kTask, fluid_problem(kTask, all, {{"h", 1.7}, {"c", 0.3}}));
  const auto after = truth_of(kTask, fluid_problem(kTask, turned(all), {{"h", 1.7}, {"c", 0.3}}));
  expect_all(after, turned(before), 1e-13);
}

TEST(FluidBlock, IsAPermutationOfTheJitteredLattice) {
  const fluid::Block b{
      .lattice = {5, 6, 7}, .seed = 3, .corner = {10, 20, 30}, .jitter = 0.12, .flow = 1, .noise = 0.2};
  std::set<std::array<long, 3>> points;
  std::size_t in_place = 0, index = 0;
  for (const Particle& p : fluid::block(b)) {
    std::array<long, 3> point;
    for (std::size_t c = 0; c < 3; ++c) {
      point[c] = std::lround(p.x[c] - b.corner[c]);
      EXPECT_LE(std::abs(p.x[c] - b.corner[c] - static_cast<double>(point[c])), 0.12 + 1e-12);
      EXPECT_LE(std::abs(p.v[c]), 2.2);
    }
    points.insert(point);
    in_place += static_cast<std::size_t>(point[0] * 42 + point[1] * 7 + point[2]) == index++;
  }
  EXPECT_EQ(points.size(), 210u);
  EXPECT_LT(in_place, 10u);
}

TEST(FluidBlock, WaveAndFlowAreTheFormulas) {
  for (const Particle& p : fluid::block({.lattice = {5, 6, 7},
                           .corner = {0, 0, 0},
                           .wave = 0.3,
                           .wave_length = 4,
                           .flow = 2,
                           .flow_length = 4})) {
    // Multiples of a quarter of the wave: sines and cosines are 0 or +-1, and so is the lattice point's
    // number.
    const double lift = 0.1 * 4 / (2 * std::numbers::pi);
    Vec3 point;
    for (std::size_t c = 0; c < 3; ++c) {
      point[c] = std::round(p.x[c]);
      const double sine = std::sin(std::numbers::pi / 2 * point[c]);
      EXPECT_NEAR(p.x[c], point[c] + lift * sine, 1e-12);
    }
    const double quarter = std::numbers::pi / 2;
    EXPECT_NEAR(p.v[0], 2 * (std::sin(quarter * point[2]) + std::cos(quarter * point[1])), 1e-12);
    EXPECT_NEAR(p.v[1], 2 * (std::sin(quarter * point[0]) + std::cos(quarter * point[2])), 1e-12);
    EXPECT_NEAR(p.v[2], 2 * (std::sin(quarter * point[1]) + std::cos(quarter * point[0])), 1e-12);
  }
}

}  // namespace
}  // namespace gpuphys::testing
