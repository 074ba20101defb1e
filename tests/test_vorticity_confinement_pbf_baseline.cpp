// The serial baseline of vorticity_confinement_pbf, validated on its own: by all pairs, by a vortex, by
// bounds and symmetries.
#include <gtest/gtest.h>

#include "tests/fluid_baseline.hpp"

namespace gpuphys::testing {
namespace {

const std::string kTask = "vorticity_confinement_pbf";

struct Expected {
  std::vector<Vec3> omega, v;
};

// The three stages of the specification, for all pairs.
Expected by_all_pairs(const Problem& p) {
  const double h = p.scalar("h"), strength = p.scalar("epsilon") * p.scalar("dt");
  const std::vector<Vec3> x = vectors(p.inputs[0]), v = vectors(p.inputs[1]);
  Expected e{std::vector<Vec3>(x.size(), Vec3{}), v};
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) {
      e.omega[i] = plus(e.omega[i], -1, cross(plus(v[j], -1, v[i]), spiky(plus(x[i], -1, x[j]), h)));
    }
  }
  for (std::size_t i = 0; i < x.size(); ++i) {
    Vec3 eta{};
    for (std::size_t j = 0; j < x.size(); ++j) {
      eta = plus(eta, length(e.omega[j]) - length(e.omega[i]), spiky(plus(x[i], -1, x[j]), h));
    }
    e.v[i] = plus(e.v[i], strength / (length(eta) + 0x1p-20), cross(eta, e.omega[i]));
  }
  return e;
}

TEST(VorticityConfinementPbfBaseline, EqualsTheFormulasOverAllPairs) {
  for (const std::string set :
       {"hard_coincident", "hard_far_apart", "hard_h_1_37", "hard_faint", "hard_thirty_three"}) {
    const Problem p = find_task(kTask).set(set).make();
    expect_all(truth_of(kTask, p), by_all_pairs(p).v, 1e-9);
  }
}

TEST(VorticityConfinementPbfBaseline, ARotatingLatticeHasTheVorticityOfItsShells) {
  // Rotation about z at 1 rad/s. A neighbour at distance r adds (1 - cos^2) r |grad W| to omega_z: over a
  // shell of the cubic lattice, 2/3 of it.
  Particles all = fluid::block({.lattice = {5, 5, 5}, .corner = {-2, -2, -2}});
  for (Particle& p : all) p.v = {-p.x[1], p.x[0], 0};
  const Problem p = fluid_problem(kTask, all, {{"h", 2}, {"epsilon", 1}, {"dt", 1}});
  double expected = 0;
  for (const auto& [count, r] : {std::pair{6, 1.0}, {12, std::sqrt(2.0)}, {8, std::sqrt(3.0)}})
    expected += 2.0 / 3 * count * r * 45 / (std::numbers::pi * 16) * std::pow(1 - r / 2, 2);
  const Expected e = by_all_pairs(p);
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (length(all[i].x) < 0.5) expect_vec(e.omega[i], {0, 0, expected}, 1e-12, i);
  }
}

TEST(VorticityConfinementPbfBaseline, AVortexIsDrivenTheWayItTurns) {
  // Fast at the axis, slow outside: eta points to the axis, N x omega along the flow.
  Particles all = fluid::block({.lattice = {13, 13, 5}, .corner = {-6, -6, -2}});
  for (Particle& p : all) {
    const double turn = std::exp(-(p.x[0] * p.x[0] + p.x[1] * p.x[1]) / 16);
    p.v = {-turn * p.x[1], turn * p.x[0], 0};
  }
  const auto v = truth_of(kTask, fluid_problem(kTask, all, {{"h", 2}, {"epsilon", 0.1}, {"dt", 0.1}}));
  int looked_at = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const double r = std::hypot(all[i].x[0], all[i].x[1]);
    if (r < 1 || r > 3 || std::abs(all[i].x[2]) > 0.5) continue;
    ++looked_at;
    const Vec3 change = plus(v[i], -1, all[i].v), along{-all[i].x[1] / r, all[i].x[0] / r, 0};
    EXPECT_GT(dot(change, along), 0.9 * length(change)) << i;
    EXPECT_GT(length(change), 0);
  }
  EXPECT_GT(looked_at, 20);
}

TEST(VorticityConfinementPbfBaseline, ThePushIsBoundedAndAcrossTheVorticity) {
  const Problem p =
      fluid_problem(kTask, fluid::block(test_block()), {{"h", 2}, {"epsilon", 0.3}, {"dt", 0.2}});
  const Expected e = by_all_pairs(p);
  const std::vector<Vec3> before = vectors(p.inputs[1]), after = truth_of(kTask, p);
  for (std::size_t i = 0; i < after.size(); ++i) {
    const Vec3 change = plus(after[i], -1, before[i]);
    const double most = 0.3f * 0.2f * length(e.omega[i]);
    EXPECT_LE(length(change), most * (1 + 1e-6));
    EXPECT_NEAR(dot(change, e.omega[i]), 0, 1e-12 + 1e-6 * most * length(e.omega[i]));
  }
}

TEST(VorticityConfinementPbfBaseline, WithoutDifferencesNothingChanges) {
  Particles all = fluid::block(test_block());
  for (Particle& p : all) p.v = {3, -1, 0.5};
  for (const Vec3& v : truth_of(kTask, fluid_problem(kTask, all, {{"h", 2}, {"epsilon", 1}, {"dt", 1}})))
    expect_vec(v, {3, -1, 0.5}, 0);
}

TEST(VorticityConfinementPbfBaseline, OrderAndAxesDoNotMatter) {
  const Particles all = fluid::block(test_block());
  const auto before = truth_of(kTask, fluid_problem(kTask, all, {{"h", 1.7}, {"epsilon", 1}, {"dt", 0.1}}));
  const auto after =
      truth_of(kTask, fluid_problem(kTask, turned(all), {{"h", 1.7}, {"epsilon", 1}, {"dt", 0.1}}));
  expect_all(after, turned(before), 1e-10);
}

}  // namespace
}  // namespace gpuphys::testing
