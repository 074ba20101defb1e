// The serial baseline of fem_pd, validated on its own: a step by hand, the energy that iterations lower, the
// minimum that they tend to, and what a step must keep.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "cases/global_solve/fem_pd.hpp"
#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/fem_pd.hpp"

namespace gpuphys {
namespace {

using elastic::TetBody;
using elastic::Vec3;
using elastic::operator*;
using testing::run_module;

const Task& task() {
  return find_task("fem_pd");
}

Problem problem_of(const TetBody& body, double mu, double dt, int iters) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", mu);
  p.set_scalar("dt", dt);
  p.set_scalar("iters", iters);
  return p;
}

TetBody block() {
  return elastic::tet_block(
      {3, 4, 2}, {.periods = 1, .strain = 0.1, .jitter = 0.05, .speed = 2, .noise = 0.1, .seed = 7});
}

TEST(FemPdBaseline, OneIterationOfAStretchedCornerByHand) {
  // hard_one_tet of the task: the stretched vertex comes half the way back.
  const Arrays out = run_module(task(), "baseline_f64", task().set("hard_one_tet").make());
  EXPECT_NEAR(find(out, "x_new", "outputs").value(3), 1.25, 1e-9);
  EXPECT_NEAR(find(out, "x_new", "outputs").value(4), 0, 1e-9);
}

TEST(FemPdBaseline, EachIterationLowersTheEnergy) {
  double earlier = 1e300;
  for (int iters = 0; iters <= 12; ++iters) {
    const Problem p = problem_of(block(), 4000, 0.05, iters);
    const double energy =
        testing::incremental_energy(bind_inputs<fem_pd::Inputs>(p), run_module(task(), "baseline_f64", p));
    EXPECT_LT(energy, earlier) << iters << " iterations";
    earlier = energy;
  }
}

TEST(FemPdBaseline, IterationsTendToAStationaryPointOfTheEnergy) {
  const Problem p = problem_of(block(), 4000, 0.05, 500);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<fem_pd::Inputs>(p);
  std::vector<double> z = testing::values_of(find(out, "x_new", "outputs"));
  const double dt = in.dt;
  for (std::size_t c = 0; c < z.size(); c += 5) {
    const double start = z[c], inertia = static_cast<double>(in.mass.data[c / 3]) *
                                         (find(out, "v_new", "outputs").value(static_cast<std::int64_t>(c)) -
                                          static_cast<double>(in.v.data[c])) /
                                         dt;
    z[c] = start + 1e-5;
    const double above = testing::corotated_energy(in, z);
    z[c] = start - 1e-5;
    const double slope = (above - testing::corotated_energy(in, z)) / 2e-5;
    z[c] = start;
    EXPECT_NEAR(inertia + slope, 0, 1e-3) << "coordinate " << c;  // forces of some 100 N
  }
}

TEST(FemPdBaseline, ARigidMotionGoesOn) {
  TetBody b = block();
  const elastic::Mat3 turn{{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}}};
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    for (double& c : b.rest[i]) c = std::round(c * 1024) / 1024;
    b.x[i] = turn * b.rest[i];
    b.v[i] = {1, 2, -3};
  }
  const Arrays out = run_module(task(), "baseline_f64", problem_of(b, 4000, 0.0625, 5));
  for (std::int64_t c = 0; c < find(out, "v_new", "outputs").size(); ++c) {
    EXPECT_NEAR(find(out, "v_new", "outputs").value(c), c % 3 == 0 ? 1 : c % 3 == 1 ? 2 : -3, 1e-10);
  }
}

TEST(FemPdBaseline, StepsKeepMomentum) {
  const Problem p = problem_of(block(), 4000, 0.05, 7);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<fem_pd::Inputs>(p);
  for (int d = 0; d < 3; ++d) {
    double sum = 0, size = 0;
    for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
      const double change = find(out, "v_new", "outputs").value(3 * i + d) - static_cast<double>(in.v(i, d));
      sum += static_cast<double>(in.mass(i)) * change;
      size += static_cast<double>(in.mass(i)) * std::abs(change);
    }
    EXPECT_LT(std::abs(sum), 1e-9 * size);
  }
}

TEST(FemPdBaseline, ABlockComesToRest) {
  testing::time_loop_fem_pd("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
