// The serial baseline of mass_spring_explicit, validated on its own: by hand, by the energy that its forces
// come from, by conservation, by the period of a chain, and in a time loop.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "cases/local_interaction/elastic_inputs.hpp"
#include "cases/local_interaction/mass_spring_explicit.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/mass_spring_explicit.hpp"

namespace gpuphys {
namespace {

using elastic::SpringBody;
using elastic::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("mass_spring_explicit");
}

Problem problem_of(const SpringBody& body, double k, double dt) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", k);
  p.set_scalar("dt", dt);
  return p;
}

// One spring along y, 3 m long.
SpringBody pair(double rest, double mass_b = 1) {
  SpringBody b;
  b.x = {{1, 0, 0}, {1, 3, 0}};
  b.v = {{0, 0, 0}, {5, 0, 0}};
  b.mass = {1, mass_b};
  b.springs = {{0, 1}};
  b.rest = {rest};
  return b;
}

TEST(MassSpringExplicitBaseline, AStretchedSpringPullsItsEndsTogether) {
  // 2 m too long at 4 N/m: 8 N; over 1/8 s that is 1 m/s for 1 kg and 1/2 m/s for 2 kg.
  const Arrays out = run_module(task(), "baseline_f64", problem_of(pair(1, 2), 4, 0.125));
  const std::vector<double> v{0, 1, 0, 5, -0.5, 0};
  for (std::size_t i = 0; i < 6; ++i)
    EXPECT_EQ(find(out, "v_new", "out").value(static_cast<std::int64_t>(i)), v[i]);
}

TEST(MassSpringExplicitBaseline, ACompressedSpringPushesThemApart) {
  const Arrays out = run_module(task(), "baseline_f64", problem_of(pair(5), 4, 0.125));
  EXPECT_EQ(find(out, "v_new", "out").value(1), -1);
  EXPECT_EQ(find(out, "v_new", "out").value(4), 1);
}

TEST(MassSpringExplicitBaseline, PositionsMoveWithTheNewVelocity) {
  const Arrays out = run_module(task(), "baseline_f64", problem_of(pair(1), 4, 0.125));
  const std::vector<double> x{1, 0.125, 0, 1 + 0.125 * 5, 3 - 0.125, 0};
  for (std::size_t i = 0; i < 6; ++i)
    EXPECT_EQ(find(out, "x_new", "out").value(static_cast<std::int64_t>(i)), x[i]);
}

TEST(MassSpringExplicitBaseline, EndsThatCoincideHaveNoForce) {
  SpringBody b = pair(1);
  b.x[1] = b.x[0];
  b.springs.push_back({1, 1});
  b.rest.push_back(2);
  const Arrays out = run_module(task(), "baseline_f64", problem_of(b, 4, 0.125));
  EXPECT_EQ(find(out, "v_new", "out").value(1), 0);
  EXPECT_EQ(find(out, "v_new", "out").value(3), 5);
}

SpringBody lattice() {
  return elastic::spring_lattice(
      {5, 4, 6}, 2, {.periods = 1, .strain = 0.05, .jitter = 0.05, .speed = 1, .noise = 0.1, .seed = 7});
}

TEST(MassSpringExplicitBaseline, TheForceIsMinusTheSlopeOfTheEnergy) {
  Problem p = problem_of(lattice(), 100, 1);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<mass_spring_explicit::Inputs>(p);
  const auto x = p.inputs[0].as<float>();
  constexpr float step = 0x1p-7f;
  for (std::size_t c = 0; c < x.size(); c += 17) {
    const float start = x[c];
    x[c] = start + step;
    const double after = testing::spring_totals(p).elastic, width = static_cast<double>(x[c]);
    x[c] = start - step;
    const double slope = (after - testing::spring_totals(p).elastic) / (width - static_cast<double>(x[c]));
    x[c] = start;
    const auto i = static_cast<std::int64_t>(c);
    const double force = (find(out, "v_new", "out").value(i) - static_cast<double>(in.v.data[c])) *
                         static_cast<double>(in.mass(i / 3));
    EXPECT_NEAR(force, -slope, 0.02) << "coordinate " << c;  // forces of some 10 N
  }
}

TEST(MassSpringExplicitBaseline, ForcesKeepMomentumAndAngularMomentum) {
  Problem p = problem_of(lattice(), 100, 1);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<mass_spring_explicit::Inputs>(p);
  double sum[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, size = 0;
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    double f[3], x[3];
    for (int c = 0; c < 3; ++c) {
      f[c] = (find(out, "v_new", "out").value(3 * i + c) - static_cast<double>(in.v(i, c))) *
             static_cast<double>(in.mass(i));
      x[c] = in.x(i, c);
      sum[c] += f[c];
      size += std::abs(f[c]);
    }
    for (int c = 0; c < 3; ++c)
      torque[c] += x[(c + 1) % 3] * f[(c + 2) % 3] - x[(c + 2) % 3] * f[(c + 1) % 3];
  }
  for (int c = 0; c < 3; ++c) {
    EXPECT_LT(std::abs(sum[c]), 1e-13 * size);
    EXPECT_LT(std::abs(torque[c]), 1e-12 * size);
  }
}

TEST(MassSpringExplicitBaseline, AChainSwingsWithItsPeriod) {
  // n unit masses in a row, ends free: the first mode is cos(pi (i + 1/2) / n), at 2 sqrt(k/m) sin(pi / 2n).
  constexpr int n = 12;
  constexpr double k = 100, dt = 0.005;
  SpringBody b;
  for (int i = 0; i < n; ++i) {
    b.x.push_back({i + 0.05 * std::cos(std::numbers::pi * (i + 0.5) / n), 0, 0});
    b.v.push_back({0, 0, 0});
    b.mass.push_back(1);
    if (i == 0) continue;
    b.springs.push_back({i, i - 1});
    b.rest.push_back(1);
  }
  Problem p = problem_of(b, k, dt);
  const auto amplitude = [&] {
    double sum = 0;
    for (int i = 0; i < n; ++i)
      sum += (p.inputs[0].value(3 * i) - i) * std::cos(std::numbers::pi * (i + 0.5) / n);
    return sum;
  };
  std::vector<double> crossings;
  double earlier = amplitude();
  for (int step = 1; crossings.size() < 2 && step < 2000; ++step) {
    ASSERT_TRUE(testing::advance(task(), "baseline_f64", p));
    const double now = amplitude();
    if (earlier * now < 0) crossings.push_back(dt * (step - now / (now - earlier)));
    earlier = now;
  }
  ASSERT_EQ(crossings.size(), 2u);
  const double omega = 2 * std::sqrt(k) * std::sin(std::numbers::pi / (2 * n));
  EXPECT_NEAR(crossings[1] - crossings[0], std::numbers::pi / omega, 0.01 * std::numbers::pi / omega);
}

TEST(SpringLattice, HasThePapersNumberOfSpringsAndLengths) {
  // 3 n^2 (n - 1) along axes and 6 n (n - 1)^2 diagonals; 96^3 has 7,824,960.
  const SpringBody b = elastic::spring_lattice(
      {8, 8, 8}, 2, {.periods = 2, .strain = 0.01, .jitter = 0.01, .speed = 1, .noise = 0.1, .seed = 3});
  EXPECT_EQ(b.springs.size(), 3u * 64 * 7 + 6u * 8 * 49);
  EXPECT_EQ(b.x.size(), 520u);
  for (std::size_t j = 0; j < b.springs.size(); ++j) {
    const Vec3 &p = b.x[static_cast<std::size_t>(b.springs[j][0])],
               &q = b.x[static_cast<std::size_t>(b.springs[j][1])];
    EXPECT_NEAR(std::hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]), b.rest[j], 0.1);
  }
}

TEST(MassSpringExplicitBaseline, ALatticeKeepsItsEnergy) {
  testing::time_loop_mass_spring_explicit("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
