// The serial baseline of fem_newtonian_implicit, validated on its own: the gradient and the Hessian that it
// uses against finite differences, a rigid motion, small steps, and a time loop.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "cases/global_solve/fem_newtonian_implicit.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/fem_newtonian_implicit.hpp"

namespace gpuphys {
namespace {

using elastic::TetBody;
using testing::run_module;

const Task& task() {
  return find_task("fem_newtonian_implicit");
}

Problem problem_of(const TetBody& body, double mu, double lambda, double dt, double tol) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", mu);
  p.set_scalar("lambda", lambda);
  p.set_scalar("dt", dt);
  p.set_scalar("tol", tol);
  return p;
}

TetBody block() {
  return elastic::tet_block(
      {3, 4, 2}, {.periods = 1, .strain = 0.1, .jitter = 0.05, .speed = 1, .noise = 0.1, .seed = 7});
}

TEST(FemNewtonBaseline, TheResultIsStationaryForTheEnergyByFiniteDifferences) {
  const Problem p = problem_of(block(), 4000, 6000, 0.05, 1e-4);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<fem_newtonian_implicit::Inputs>(p);
  const double dt = in.dt;
  std::vector<double> z(static_cast<std::size_t>(in.x.size()));
  for (std::size_t c = 0; c < z.size(); ++c)
    z[c] = find(out, "x_new", "outputs").value(static_cast<std::int64_t>(c));
  const auto at = [&](std::int64_t i, std::int64_t c) { return z[static_cast<std::size_t>(3 * i + c)]; };
  for (std::size_t c = 0; c < z.size(); c += 5) {
    const double start = z[c], y = static_cast<double>(in.x.data[c]) + dt * static_cast<double>(in.v.data[c]);
    z[c] = start + 1e-5;
    const double above = testing::neo_hookean_energy(in, at);
    z[c] = start - 1e-5;
    const double slope = (above - testing::neo_hookean_energy(in, at)) / 2e-5;
    z[c] = start;
    EXPECT_NEAR(static_cast<double>(in.mass.data[c / 3]) * (start - y) + dt * dt * slope, 0, 1e-4)
        << "coordinate " << c;  // terms of some 0.1 kg m
  }
}

TEST(FemNewtonBaseline, NewtonsStepsConvergeFast) {
  // Each factor of ten in tol costs less than one Newton step: between 1e-1 and 1e-4 results close in on one
  // point.
  const Arrays tight = run_module(task(), "baseline_f64", problem_of(block(), 4000, 6000, 0.05, 1e-4));
  double earlier = 1e300;
  for (const double tol : {1e-1, 1e-2, 1e-3}) {
    const Arrays out = run_module(task(), "baseline_f64", problem_of(block(), 4000, 6000, 0.05, tol));
    double off = 0;
    for (std::int64_t c = 0; c < find(out, "x_new", "outputs").size(); ++c)
      off += std::pow(find(out, "x_new", "outputs").value(c) - find(tight, "x_new", "outputs").value(c), 2);
    EXPECT_LE(std::sqrt(off), earlier) << "tol " << tol;
    EXPECT_LE(std::sqrt(off), 20 * tol) << "tol " << tol;
    earlier = std::sqrt(off);
  }
}

TEST(FemNewtonBaseline, ABlockAtRestMovesAsOne) {
  const Problem p = task().set("hard_turned_90").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t c = 0; c < p.inputs[1].size(); ++c)
    EXPECT_EQ(find(out, "x_new", "outputs").value(c), p.inputs[1].value(c) + 0.0625 * p.inputs[2].value(c));
}

TEST(FemNewtonBaseline, AShortStepIsAnExplicitOne) {
  // v_new - v = -dt grad E / mass + O(dt^2): halving dt halves the change.
  const TetBody b = block();
  double change[2] = {0, 0};
  for (int k = 0; k < 2; ++k) {
    const Problem p = problem_of(b, 400, 600, k == 0 ? 0.001953125 : 0.0009765625, 1e-2);
    const Arrays out = run_module(task(), "baseline_f64", p);
    for (std::int64_t c = 0; c < p.inputs[2].size(); ++c)
      change[k] += std::pow(find(out, "v_new", "outputs").value(c) - p.inputs[2].value(c), 2);
  }
  EXPECT_NEAR(std::sqrt(change[0] / change[1]), 2, 0.1);
}

TEST(FemNewtonBaseline, ABlockComesToRest) {
  testing::time_loop_fem_newtonian_implicit("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
