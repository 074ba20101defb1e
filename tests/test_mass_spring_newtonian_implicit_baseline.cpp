// The serial baseline of mass_spring_newtonian_implicit, validated on its own: a step by hand, the closed
// form of a linear one, what a step must keep, and a time loop.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "cases/global_solve/mass_spring_newtonian_implicit.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/mass_spring_newtonian_implicit.hpp"

namespace gpuphys {
namespace {

using elastic::SpringBody;
using testing::run_module;

const Task& task() {
  return find_task("mass_spring_newtonian_implicit");
}

Problem problem_of(const SpringBody& body, double k, double dt, double tol) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", k);
  p.set_scalar("dt", dt);
  p.set_scalar("tol", tol);
  return p;
}

double position(const Arrays& out, std::int64_t c) {
  return find(out, "x_new", "outputs").value(c);
}

TEST(MassSpringNewtonBaseline, AStretchedPairByHand) {
  // dt^2 k = 1, unit masses, 3 m apart, 1 m at rest: u = 3 - 2 u - 1, u = 2/3.
  SpringBody b;
  b.x = {{0, 0, 0}, {0, 0, 3}};
  b.v = {{0, 0, 0}, {0, 0, 0}};
  b.mass = {1, 1};
  b.springs = {{0, 1}};
  b.rest = {1};
  const Arrays out = run_module(task(), "baseline_f64", problem_of(b, 4, 0.5, 1e-4));
  EXPECT_NEAR(position(out, 2), 2.0 / 3, 1e-4);
  EXPECT_NEAR(position(out, 5), 3 - 2.0 / 3, 1e-4);
  EXPECT_NEAR(find(out, "v_new", "outputs").value(2), position(out, 2) / 0.5, 1e-12);
}

TEST(MassSpringNewtonBaseline, WithRestLengthsOfZeroTheStepIsLinear) {
  // A pair with L = 0 about its centre: d' = d / (1 + 2 dt^2 k / m) for d = y_a - y_b.
  SpringBody b;
  b.x = {{1, 2, 3}, {-1, 5, 7}};
  b.v = {{4, 0, 0}, {0, 0, -8}};
  b.mass = {2, 2};
  b.springs = {{1, 0}};
  b.rest = {0};
  const Arrays out = run_module(task(), "baseline_f64", problem_of(b, 8, 0.25, 1e-4));
  const double d[3] = {3, -3, -2}, shrink = 1 / (1 + 2 * 0.0625 * 8 / 2);
  for (std::int64_t c = 0; c < 3; ++c)
    EXPECT_NEAR(position(out, c) - position(out, 3 + c), d[c] * shrink, 1e-3) << "axis " << c;
}

TEST(MassSpringNewtonBaseline, ARestStateMovesAsOne) {
  const Problem p = task().set("hard_rigid").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t c = 0; c < p.inputs[0].size(); ++c)
    EXPECT_EQ(position(out, c), p.inputs[0].value(c) + 0.125 * p.inputs[1].value(c));
}

TEST(MassSpringNewtonBaseline, ATighterToleranceConvergesToOnePoint) {
  const SpringBody b = elastic::spring_lattice(
      {5, 4, 6}, 1, {.periods = 1, .strain = 0.01, .jitter = 0.005, .speed = 10, .noise = 0.1, .seed = 7});
  const Arrays tight = run_module(task(), "baseline_f64", problem_of(b, 1e4, 0.02, 1e-4));
  double earlier = 1e300;
  for (const double tol : {1e-1, 1e-2, 1e-3}) {
    const Arrays out = run_module(task(), "baseline_f64", problem_of(b, 1e4, 0.02, tol));
    double off = 0;
    for (std::int64_t c = 0; c < find(out, "x_new", "outputs").size(); ++c)
      off += std::pow(position(out, c) - position(tight, c), 2);
    EXPECT_LE(std::sqrt(off), 0.6 * earlier) << "tol " << tol;
    earlier = std::sqrt(off);
  }
}

TEST(MassSpringNewtonBaseline, ALatticeComesToRest) {
  testing::time_loop_mass_spring_newtonian_implicit("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
