// The serial baseline of xpbd, validated on its own: by hand, against the tasks that it is composed of, by
// conservation, and in a time loop.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <vector>

#include "core/generators/random.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/xpbd.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using Points = std::vector<std::array<double, 3>>;

struct Scene {
  Points x, v;
  std::vector<double> inv_mass;
  std::vector<std::array<std::int32_t, 2>> springs{{0, 0}};
  std::vector<double> rest{1};
  double dt = 0.5, spring_compliance = 0, contact_compliance = 0, thickness = 1, radius = 1.25,
         relaxation = 0.5;
  int iterations = 1;
};

Problem problem_of(const Scene& s) {
  Problem p = make_problem(find_task("xpbd").contract, {{"n", static_cast<std::int64_t>(s.x.size())},
                                                        {"m", static_cast<std::int64_t>(s.springs.size())}});
  for (std::size_t i = 0; i < s.x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      p.inputs[0].as<float>()[3 * i + d] = static_cast<float>(s.x[i][d]);
      p.inputs[1].as<float>()[3 * i + d] = static_cast<float>(s.v[i][d]);
    }
    p.inputs[2].as<float>()[i] = s.inv_mass.empty() ? 1.0f : static_cast<float>(s.inv_mass[i]);
  }
  for (std::size_t j = 0; j < s.springs.size(); ++j) {
    p.inputs[3].as<std::int32_t>()[2 * j] = s.springs[j][0];
    p.inputs[3].as<std::int32_t>()[2 * j + 1] = s.springs[j][1];
    p.inputs[4].as<float>()[j] = static_cast<float>(s.rest[j]);
  }
  p.set_scalar("dt", s.dt);
  p.set_scalar("spring_compliance", s.spring_compliance);
  p.set_scalar("contact_compliance", s.contact_compliance);
  p.set_scalar("thickness", s.thickness);
  p.set_scalar("search_radius", s.radius);
  p.set_scalar("relaxation", s.relaxation);
  p.set_scalar("iters", s.iterations);
  return p;
}

std::array<Points, 2> solved(const Scene& s) {
  const Arrays out = run_module(find_task("xpbd"), "baseline_f64", problem_of(s));
  std::array<Points, 2> result{Points(s.x.size()), Points(s.x.size())};
  for (std::size_t k = 0; k < 2; ++k) {
    for (std::int64_t i = 0; i < out[k].size(); ++i)
      result[k][static_cast<std::size_t>(i / 3)][static_cast<std::size_t>(i % 3)] = out[k].value(i);
  }
  return result;
}

TEST(XpbdBaseline, AFreeParticleFliesOn) {
  const auto [x, v] = solved({{{1, 2, 3}}, {{4, -2, 1}}, {}});
  EXPECT_EQ(x[0], (std::array<double, 3>{3, 1, 3.5}));
  EXPECT_EQ(v[0], (std::array<double, 3>{4, -2, 1}));
}

TEST(XpbdBaseline, APinnedParticleStaysWhateverItsVelocity) {
  const auto [x, v] = solved({{{1, 2, 3}}, {{4, -2, 1}}, {0}});
  EXPECT_EQ(x[0], (std::array<double, 3>{1, 2, 3}));
  EXPECT_EQ(v[0], (std::array<double, 3>{0, 0, 0}));
}

TEST(XpbdBaseline, ContactsAreThoseOfThePrediction) {
  // 3 apart, predicted 1/2 apart: lambda = 1/8, each moves by 1/8 out of the prediction, velocities by 1/4.
  const auto [x, v] = solved({{{0, 0, 0}, {0, 3, 0}}, {{0, 0, 0}, {0, -5, 0}}, {}});
  EXPECT_EQ(x, (Points{{0, -0.125, 0}, {0, 0.625, 0}}));
  EXPECT_EQ(v, (Points{{0, -0.25, 0}, {0, -4.75, 0}}));
  // Near at the start only: no contact.
  EXPECT_EQ(solved({{{0, 0, 0}, {0, 0.5, 0}}, {{0, 0, 0}, {0, 5, 0}}, {}})[0],
            (Points{{0, 0, 0}, {0, 3, 0}}));
}

TEST(XpbdBaseline, SpringsAndContactsActOnTheSamePositions) {
  // A spring of rest 2 and a contact of thickness 1, both between two particles 1/2 apart: the spring pushes
  // with 3/2 / 2, the contact with 1/2 * 1/2 / 2.
  Scene s{{{0, 0, 0}, {0.5, 0, 0}}, {{0, 0, 0}, {0, 0, 0}}, {}, {{0, 1}}, {2}};
  const double push = 0.75 + 0.125;
  EXPECT_EQ(solved(s)[0], (Points{{-push, 0, 0}, {0.5 + push, 0, 0}}));
}

TEST(XpbdBaseline, ContactsDoNotCountInTheValence) {
  // The same with a third particle in contact with the second one: the spring's share stays.
  Scene s{{{0, 0, 0}, {2, 0, 0}, {2, 0.5, 0}}, {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}}, {}, {{0, 1}}, {1}};
  const Points x = solved(s)[0];
  EXPECT_EQ(x, (Points{{0.5, 0, 0}, {1.5, -0.125, 0}, {2, 0.625, 0}}));
}

Scene cloud() {
  Scene s;
  s.springs.clear();
  s.rest.clear();
  for (std::size_t i = 0; i < 300; ++i) {
    s.x.push_back({});
    s.v.push_back({});
    for (std::size_t d = 0; d < 3; ++d) {
      s.x[i][d] = static_cast<double>(static_cast<float>(3 * uniform11(92, 0, 3 * i + d)));
      s.v[i][d] = static_cast<double>(static_cast<float>(uniform11(92, 1, 3 * i + d)));
    }
    s.inv_mass.push_back(static_cast<double>(static_cast<float>(0.5 + uniform01(92, 2, i))));
    s.springs.push_back({static_cast<std::int32_t>(i), static_cast<std::int32_t>((7 * i + 1) % 300)});
    s.rest.push_back(2);
  }
  s.dt = 0.25;
  s.relaxation = 0.1;
  s.iterations = 6;
  s.spring_compliance = 0.01;
  s.contact_compliance = 0.002;
  return s;
}

TEST(XpbdBaseline, WithoutSpringsItIsSelfCollision) {
  Scene s = cloud();
  s.springs = {{0, 0}};
  s.rest = {1};
  for (auto& v : s.v) v = {0, 0, 0};
  const Task& contacts = find_task("self_collision_xpbd");
  Problem p = make_problem(contacts.contract, {{"n", 300}});
  const Problem whole = problem_of(s);
  std::copy_n(whole.inputs[0].as<float>().begin(), 900, p.inputs[0].as<float>().begin());
  std::copy_n(whole.inputs[2].as<float>().begin(), 300, p.inputs[1].as<float>().begin());
  p.set_scalar("compliance", s.contact_compliance);
  for (const char* name : {"thickness", "search_radius", "dt", "relaxation", "iters"})
    p.set_scalar(name, whole.scalar(name));
  const Arrays expected = run_module(contacts, "baseline_f64", p);
  const Points x = solved(s)[0];
  for (std::size_t i = 0; i < 900; ++i)
    EXPECT_NEAR(x[i / 3][i % 3], expected[0].value(static_cast<std::int64_t>(i)), 1e-13) << i;
}

TEST(XpbdBaseline, WithoutContactsItIsTheSpringSolve) {
  Scene s = cloud();
  s.thickness = s.radius = 1e-6;
  for (auto& v : s.v) v = {0, 0, 0};
  const Task& solve = find_task("solve_constraint_xpbd");
  Problem p = make_problem(solve.contract, {{"n", 300}, {"m", 300}});
  const Problem whole = problem_of(s);
  std::copy_n(whole.inputs[0].as<float>().begin(), 900, p.inputs[0].as<float>().begin());
  std::copy_n(whole.inputs[2].as<float>().begin(), 300, p.inputs[1].as<float>().begin());
  std::copy_n(whole.inputs[3].as<std::int32_t>().begin(), 600, p.inputs[2].as<std::int32_t>().begin());
  std::copy_n(whole.inputs[4].as<float>().begin(), 300, p.inputs[3].as<float>().begin());
  p.set_scalar("compliance", s.spring_compliance);
  p.set_scalar("dt", s.dt);
  p.set_scalar("iters", s.iterations);
  const Arrays expected = run_module(solve, "baseline_f64", p);
  const Points x = solved(s)[0];
  for (std::size_t i = 0; i < 900; ++i)
    EXPECT_NEAR(x[i / 3][i % 3], expected[0].value(static_cast<std::int64_t>(i)), 1e-13) << i;
}

TEST(XpbdBaseline, MomentumStays) {
  const Scene s = cloud();
  const Points v = solved(s)[1];
  double changed = 0;
  for (std::size_t d = 0; d < 3; ++d) {
    double sum = 0;
    for (std::size_t i = 0; i < v.size(); ++i) {
      sum += (v[i][d] - s.v[i][d]) / s.inv_mass[i];
      changed += std::abs(v[i][d] - s.v[i][d]);
    }
    EXPECT_NEAR(sum, 0, 1e-9);
  }
  EXPECT_GT(changed, 1);
}

TEST(XpbdBaseline, ClothHangsAndDrapes) {
  testing::time_loop_xpbd("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
