// The serial baseline of mass_spring_pd, validated on its own: a step by hand, the energy that iterations
// lower, the minimum that they tend to, and what a step must keep.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "cases/global_solve/mass_spring_pd.hpp"
#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/mass_spring_pd.hpp"

namespace gpuphys {
namespace {

using elastic::SpringBody;
using testing::run_module;

const Task& task() {
  return find_task("mass_spring_pd");
}

Problem problem_of(const SpringBody& body, double k, double dt, int iters) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", k);
  p.set_scalar("dt", dt);
  p.set_scalar("iters", iters);
  return p;
}

SpringBody pair(double mass_b) {
  SpringBody b;
  b.x = {{0, 0, 0}, {0, 0, 3}};
  b.v = {{0, 0, 0}, {0, 0, 0}};
  b.mass = {1, mass_b};
  b.springs = {{0, 1}};
  b.rest = {1};
  return b;
}

double velocity(const Arrays& out, std::int64_t c) {
  return find(out, "v_new", "outputs").value(c);
}

TEST(MassSpringPdBaseline, OneIterationOfAPairByHand) {
  // dt^2 k = 1, masses 1 and 1: u + (2 u - 3) + 1 = 0 gives u = 2/3; with masses 1 and 3, u_b = u_a / 3 and
  // u + 4/3 u = 2 gives u = 6/7.
  const Arrays equal = run_module(task(), "baseline_f64", problem_of(pair(1), 4, 0.5, 1));
  EXPECT_NEAR(velocity(equal, 2), 2.0 / 3 / 0.5, 1e-9);
  EXPECT_NEAR(velocity(equal, 5), -2.0 / 3 / 0.5, 1e-9);
  const Arrays unequal = run_module(task(), "baseline_f64", problem_of(pair(3), 4, 0.5, 1));
  EXPECT_NEAR(velocity(unequal, 2), 6.0 / 7 / 0.5, 1e-9);
  EXPECT_NEAR(velocity(unequal, 5), -2.0 / 7 / 0.5, 1e-9);
}

TEST(MassSpringPdBaseline, WithoutIterationsParticlesFlyOn) {
  const Problem p = task().set("hard_zero_iterations").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t c = 0; c < 30; ++c)
    EXPECT_NEAR(velocity(out, c), find(p.inputs, "v", "inputs").value(c), 1e-13);
}

// Gradient of |z - y|^2_M / 2 + dt^2 E(z) at the result, over that at y.
double residual_ratio(const Problem& p) {
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<mass_spring_pd::Inputs>(p);
  const double dt = in.dt, k = in.k;
  const auto size = [&](bool at_result) {
    std::vector<double> g(static_cast<std::size_t>(in.x.size())), z(g.size());
    for (std::size_t c = 0; c < g.size(); ++c) {
      const double free = dt * static_cast<double>(in.v.data[c]),
                   moved = at_result ? dt * velocity(out, static_cast<std::int64_t>(c)) : free;
      z[c] = static_cast<double>(in.x.data[c]) + moved;
      g[c] = static_cast<double>(in.mass.data[c / 3]) * (moved - free);
    }
    for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
      const auto a = 3 * static_cast<std::size_t>(in.springs(j, 0)),
                 b = 3 * static_cast<std::size_t>(in.springs(j, 1));
      const double d[3] = {z[a] - z[b], z[a + 1] - z[b + 1], z[a + 2] - z[b + 2]};
      const double length = std::hypot(d[0], d[1], d[2]);
      if (length == 0) continue;
      for (std::size_t c = 0; c < 3; ++c) {
        const double f = dt * dt * k * (length - static_cast<double>(in.rest(j))) * d[c] / length;
        g[a + c] += f;
        g[b + c] -= f;
      }
    }
    double square = 0;
    for (const double e : g) square += e * e;
    return std::sqrt(square);
  };
  return size(true) / size(false);
}

SpringBody lattice() {
  return elastic::spring_lattice(
      {5, 4, 6}, 1, {.periods = 1, .strain = 0.02, .jitter = 0.02, .speed = 5, .noise = 0.1, .seed = 7});
}

TEST(MassSpringPdBaseline, IterationsTendToTheMinimumThatNewtonFinds) {
  EXPECT_GT(residual_ratio(problem_of(lattice(), 2.5e4, 0.02, 1)), 1e-2);
  EXPECT_LT(residual_ratio(problem_of(lattice(), 2.5e4, 0.02, 1000)), 1e-8);
}

TEST(MassSpringPdBaseline, EachIterationLowersTheEnergy) {
  double earlier = 1e300;
  for (int iters = 0; iters <= 12; ++iters) {
    const Problem p = problem_of(lattice(), 2.5e4, 0.02, iters);
    const double energy = testing::incremental_energy(p, run_module(task(), "baseline_f64", p));
    EXPECT_LT(energy, earlier) << iters << " iterations";
    earlier = energy;
  }
}

TEST(MassSpringPdBaseline, StepsKeepMomentum) {
  const Problem p = problem_of(lattice(), 2.5e4, 0.02, 7);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<mass_spring_pd::Inputs>(p);
  for (int d = 0; d < 3; ++d) {
    double sum = 0, size = 0;
    for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
      const double change = velocity(out, 3 * i + d) - static_cast<double>(in.v(i, d));
      sum += static_cast<double>(in.mass(i)) * change;
      size += static_cast<double>(in.mass(i)) * std::abs(change);
    }
    EXPECT_LT(std::abs(sum), 1e-9 * size);
  }
}

TEST(MassSpringPdBaseline, ALatticeComesToRest) {
  testing::time_loop_mass_spring_pd("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
