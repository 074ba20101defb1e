// The serial baseline of dem, validated on its own: by hand, by what friction and rotation must obey, against
// contact_dem, and in a time loop.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "cases/local_interaction/dem.hpp"
#include "cases/local_interaction/grain_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/dem.hpp"

namespace gpuphys {
namespace {

using grains::Grain;
using grains::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("dem");
}

struct Scalars {
  double kn = 600, cn = 10, gt = 10, mu = 0.5, rho = 1, dt = 0.01;
};

Problem problem_of(const std::vector<Grain>& grains, const Scalars& s = {}) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(grains.size())}});
  p.set_scalar("kn", s.kn);
  p.set_scalar("cn", s.cn);
  p.set_scalar("gt", s.gt);
  p.set_scalar("mu", s.mu);
  p.set_scalar("rho", s.rho);
  p.set_scalar("dt", s.dt);
  for (std::size_t i = 0; i < grains.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      p.inputs[0].as<float>()[3 * i + c] = static_cast<float>(grains[i].x[c]);
      p.inputs[1].as<float>()[3 * i + c] = static_cast<float>(grains[i].v[c]);
      p.inputs[2].as<float>()[3 * i + c] = static_cast<float>(grains[i].omega[c]);
    }
    p.inputs[3].as<float>()[i] = static_cast<float>(grains[i].radius);
  }
  return p;
}

struct Step {
  std::vector<Vec3> x, v, omega;
};

Step step(const Problem& p) {
  const Arrays out = run_module(task(), "baseline_f64", p);
  Step s;
  std::vector<Vec3>* const all[] = {&s.x, &s.v, &s.omega};
  for (std::size_t a = 0; a < 3; ++a) {
    all[a]->resize(static_cast<std::size_t>(out[a].shape()[0]));
    for (std::size_t i = 0; i < all[a]->size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c)
        (*all[a])[i][c] = out[a].value(static_cast<std::int64_t>(3 * i + c));
    }
  }
  return s;
}

void expect_vec(const Vec3& got, const Vec3& expected, double tolerance = 1e-12) {
  for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(got[c], expected[c], tolerance) << "component " << c;
}

// Radii 1/2, 3/4 m apart: overlap 1/4, normal force 37.5 N at rest, arms 3/8. m = rho pi / 6, I = m / 10.
constexpr double kMass = std::numbers::pi / 6;
constexpr double kInertia = kMass / 10;

std::vector<Grain> hand_pair(const Vec3& v, const Vec3& omega) {
  return {{{1.75, 2, 3}, v, 0.5, omega}, {{1, 2, 3}, {0, 0, 0}, 0.5}};
}

TEST(DemBaseline, APairAtRestIsPushedApart) {
  const Step s = step(problem_of(hand_pair({0, 0, 0}, {0, 0, 0}), {.dt = 0.25}));
  const double v = 0.25 * 37.5 / kMass;
  expect_vec(s.v[0], {v, 0, 0});
  expect_vec(s.v[1], {-v, 0, 0});
  expect_vec(s.x[0], {1.75 + 0.25 * v, 2, 3});
  expect_vec(s.omega[0], {0, 0, 0}, 0);
  expect_vec(s.omega[1], {0, 0, 0}, 0);
}

// Slip 1 m/s along y: 10 N of viscous friction, less than the cap of 18.75 N. Both grains turn backwards:
// -(3/8) x cross (-10 y) = +30/8 z.
TEST(DemBaseline, SlowSlidingIsViscous) {
  const double dt = 0x1p-6;
  const Step s = step(problem_of(hand_pair({0, 1, 0}, {0, 0, 0}), {.dt = dt}));
  expect_vec(s.v[0], {dt * 37.5 / kMass, 1 - dt * 10 / kMass, 0});
  expect_vec(s.v[1], {-dt * 37.5 / kMass, dt * 10 / kMass, 0});
  expect_vec(s.omega[0], {0, 0, dt * 3.75 / kInertia});
  expect_vec(s.omega[1], {0, 0, dt * 3.75 / kInertia});
}

TEST(DemBaseline, FastSlidingIsCapped) {
  const double dt = 0x1p-6;
  for (const double speed : {2.0, 5.0}) {
    const Step s = step(problem_of(hand_pair({0, 0, speed}, {0, 0, 0}), {.dt = dt}));
    expect_vec(s.v[0], {dt * 37.5 / kMass, 0, speed - dt * 18.75 / kMass});
    expect_vec(s.omega[1], {0, -dt * 18.75 * 0.375 / kInertia, 0});
  }
}

// 16 rad/s on arms of 3/8 m: the surface moves at 6 m/s along -y past the other one.
TEST(DemBaseline, ASpinningGrainDragsTheOther) {
  const double dt = 0x1p-6;
  const Step s = step(problem_of(hand_pair({0, 0, 0}, {0, 0, 16}), {.dt = dt}));
  expect_vec(s.v[0], {dt * 37.5 / kMass, dt * 18.75 / kMass, 0});
  expect_vec(s.v[1], {-dt * 37.5 / kMass, -dt * 18.75 / kMass, 0});
  expect_vec(s.omega[0], {0, 0, 16 - dt * 18.75 * 0.375 / kInertia});
  expect_vec(s.omega[1], {0, 0, -dt * 18.75 * 0.375 / kInertia});
}

TEST(DemBaseline, SpinAboutTheNormalFeelsNothing) {
  const Step s = step(problem_of(hand_pair({0, 0, 0}, {16, 0, 0})));
  expect_vec(s.omega[0], {16, 0, 0}, 0);
  expect_vec(s.omega[1], {0, 0, 0}, 0);
}

TEST(DemBaseline, RollingWithoutSlipFeelsNoFriction) {
  // (3/8)(2 + 1) z cross x = 9/8 y.
  const Step s = step(
      problem_of({{{0.75, 0, 0}, {0, 1.125, 0}, 0.5, {0, 0, 2}}, {{0, 0, 0}, {0, 0, 0}, 0.5, {0, 0, 1}}}));
  EXPECT_EQ(s.omega[0][2], 2);
  EXPECT_EQ(s.omega[1][2], 1);
  EXPECT_EQ(s.v[0][1], 1.125);
}

// Separation at 15 m/s: damping cancels the spring, and with it the cap.
TEST(DemBaseline, FrictionIsCappedByTheForceThatActs) {
  const Step s = step(problem_of(hand_pair({15, 4, 0}, {0, 0, 0})));
  expect_vec(s.v[0], {15, 4, 0}, 0);
  expect_vec(s.omega[0], {0, 0, 0}, 0);
}

TEST(DemBaseline, FrictionIsContinuousAtItsCap) {
  // gt slip = mu f at 1.875 m/s.
  const double dt = 0x1p-6;
  const Step below = step(problem_of(hand_pair({0, 1.875 - 0x1p-12, 0}, {0, 0, 0}), {.dt = dt}));
  const Step above = step(problem_of(hand_pair({0, 1.875 + 0x1p-12, 0}, {0, 0, 0}), {.dt = dt}));
  expect_vec(below.omega[0], above.omega[0], 0.01);
}

TEST(DemBaseline, UnequalGrainsTurnByTheirOwnArms) {
  // Radii 1 and 1/4, 1 m apart: overlap 1/4, arms 7/8 and 1/8, r* = 1/5.
  const double dt = 0x1p-8, rho = 3;
  const Step s =
      step(problem_of({{{1, 0, 0}, {0, 8, 0}, 1}, {{0, 0, 0}, {0, 0, 0}, 0.25}}, {.rho = rho, .dt = dt}));
  const double friction = 0.5 * std::sqrt(0.05) * 150;
  const double inertia = 0.4 * 4.0 / 3 * std::numbers::pi * rho;
  EXPECT_NEAR(s.omega[0][2], dt * friction * 0.875 / inertia, 1e-12);
  EXPECT_NEAR(s.omega[1][2], dt * friction * 0.125 / (inertia / 1024), 1e-12);
}

TEST(DemBaseline, CoincidentCentresFeelNothingFromEachOther) {
  const Step s = step(problem_of({{{1, 1, 1}, {3, 0, 0}, 0.5, {1, 2, 3}}, {{1, 1, 1}, {0, 0, 0}, 0.5}}));
  expect_vec(s.v[0], {3, 0, 0}, 0);
  expect_vec(s.omega[0], {1, 2, 3}, 0);
  expect_vec(s.omega[1], {0, 0, 0}, 0);
}

// Without friction the step is that of contact_dem's forces.
TEST(DemBaseline, WithoutFrictionForcesAreThoseOfContactDem) {
  const Scalars smooth{.mu = 0, .rho = 2};
  const Problem p = problem_of(grains::packing({{6, 7, 5}, 4, 0.12, 0.5, 0.6, 0.01, 0.5}), smooth);
  const Task& contact = find_task("contact_dem");
  Problem q = make_problem(contact.contract, {{"n", p.inputs[0].shape()[0]}});
  q.set_scalar("kn", smooth.kn);
  q.set_scalar("cn", smooth.cn);
  for (const auto& [to, from] : {std::pair{0, 0}, {1, 1}, {2, 3}}) {
    const auto source = p.inputs[static_cast<std::size_t>(from)].as<float>();
    std::copy(source.begin(), source.end(), q.inputs[static_cast<std::size_t>(to)].as<float>().begin());
  }
  const Arrays force = run_module(contact, "baseline_f64", q);
  const Step s = step(p);
  for (std::size_t i = 0; i < s.v.size(); ++i) {
    const double mass = testing::grain_mass(p.inputs[3].value(static_cast<std::int64_t>(i)), smooth.rho);
    for (std::size_t c = 0; c < 3; ++c) {
      const auto at = static_cast<std::int64_t>(3 * i + c);
      // dt is rounded to float32.
      EXPECT_NEAR(s.v[i][c], p.inputs[1].value(at) + static_cast<double>(0.01f) * force[0].value(at) / mass,
                  1e-13);
      EXPECT_EQ(s.omega[i][c], p.inputs[2].value(at));
    }
  }
}

TEST(DemBaseline, MomentumAndAngularMomentumStay) {
  for (const char* set : {"public_smoke", "hard_radii_1_to_3", "hard_size_ratio_100", "hard_spin_1e4"}) {
    Problem p = task().set(set).make();
    const testing::DemTotals before = testing::dem_totals(p);
    const Arrays out = run_module(task(), "baseline_f64", p);
    // About the positions before the step: x' - x is along v'.
    for (std::size_t a = 1; a < 3; ++a) {
      for (std::int64_t k = 0; k < out[a].size(); ++k)
        p.inputs[a].as<float>()[static_cast<std::size_t>(k)] = static_cast<float>(out[a].value(k));
    }
    const testing::DemTotals after = testing::dem_totals(p);
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_NEAR(after.momentum[c], before.momentum[c], 1e-7 * after.momentum_scale) << set;
      EXPECT_NEAR(after.angular[c], before.angular[c], 1e-7 * after.angular_scale) << set;
    }
  }
}

TEST(DemBaseline, OrderOfTheGrainsAndFrameOfReferenceDoNotMatter) {
  const grains::Packing packing{.lattice = {7, 9, 8},
                                .seed = 5,
                                .jitter = 0.12,
                                .smallest = 0.4,
                                .largest = 0.6,
                                .shear = 0.01,
                                .noise = 0.5,
                                .spin = 2};
  std::vector<Grain> all = grains::packing(packing);
  const Step before = step(problem_of(all));
  std::reverse(all.begin(), all.end());
  const auto turn = [](Vec3& a) { std::rotate(a.begin(), a.begin() + 1, a.end()); };
  for (Grain& g : all) turn(g.x), turn(g.v), turn(g.omega);
  const Step after = step(problem_of(all));
  for (std::size_t i = 0; i < all.size(); ++i) {
    Vec3 v = before.v[i], omega = before.omega[i];
    turn(v), turn(omega);
    expect_vec(after.v[all.size() - 1 - i], v);
    expect_vec(after.omega[all.size() - 1 - i], omega);
  }
}

TEST(DemBaseline, AGranularGasConservesMomentumAndLosesEnergy) {
  testing::time_loop_dem("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
