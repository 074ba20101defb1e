// The serial baseline of pbf, validated on its own: free flight, momentum, the composition of its three
// operators, and a column that collapses.
#include <gtest/gtest.h>

#include "tests/fluid_baseline.hpp"
#include "tests/time_loops/pbf.hpp"

namespace gpuphys::testing {
namespace {

const std::string kTask = "pbf";

// Multiples of 2^-10 m and 2^-5 m/s, so that predicted positions at dt = 1/8 are float32 numbers.
Particles dyadic_block() {
  Particles all = fluid::block(test_block());
  for (Particle& p : all) {
    for (double& x : p.x) x = std::round(x * 0x1p10) * 0x1p-10;
    for (double& v : p.v) v = std::round(v * 0x1p5) * 0x1p-5;
  }
  return all;
}

TEST(PbfBaseline, IsTheCompositionOfItsOperators) {
  const Particles all = dyadic_block();
  const double dt = 0.125, c_visc = 0.25, vort_eps = 0.5;
  const Problem step = fluid_problem(kTask, all,
                                     {{"h", 2},
                                      {"rho0", 1.009775},
                                      {"eps", 0.5},
                                      {"k_corr", 0.1},
                                      {"dq", 0.3},
                                      {"iters", 4},
                                      {"dt", dt},
                                      {"gx", 0.5},
                                      {"gy", -2},
                                      {"gz", 1},
                                      {"c_visc", c_visc},
                                      {"vort_eps", vort_eps}});
  Particles now = all;
  for (Particle& p : now) {
    p.v = plus(p.v, dt, {0.5, -2, 1});
    p.x = plus(p.x, dt, p.v);
  }
  const auto solved =
      truth_of("solve_constraint_pbf",
               fluid_problem(
                   "solve_constraint_pbf", now,
                   {{"h", 2}, {"rho0", 1.009775}, {"eps", 0.5}, {"k_corr", 0.1}, {"dq", 0.3}, {"iters", 4}}));
  expect_all(truth_of(kTask, step, 0), solved, 1e-13);
  // From here on the operators' inputs are rounded to float32.
  for (std::size_t i = 0; i < now.size(); ++i) {
    now[i].x = solved[i];
    for (std::size_t c = 0; c < 3; ++c) now[i].v[c] = (solved[i][c] - all[i].x[c]) / dt;
  }
  const auto confined = truth_of(
      "vorticity_confinement_pbf",
      fluid_problem("vorticity_confinement_pbf", now, {{"h", 2}, {"epsilon", vort_eps}, {"dt", dt}}));
  for (std::size_t i = 0; i < now.size(); ++i) now[i].v = confined[i];
  const auto v = truth_of("viscosity_pbf", fluid_problem("viscosity_pbf", now, {{"h", 2}, {"c", c_visc}}));
  expect_all(truth_of(kTask, step, 1), v, 1e-5);
}

TEST(PbfBaseline, AParticleAloneFliesFreely) {
  const Problem p = fluid_problem(kTask, {{{1, 2, 3}, {4, 0, -1}}},
                                  {{"h", 2},
                                   {"rho0", 1},
                                   {"eps", 1},
                                   {"k_corr", 1},
                                   {"dq", 0.5},
                                   {"iters", 3},
                                   {"dt", 0.5},
                                   {"gx", 1},
                                   {"gy", 2},
                                   {"gz", -4},
                                   {"c_visc", 1},
                                   {"vort_eps", 1}});
  expect_vec(truth_of(kTask, p, 1)[0], {4.5, 1, -3}, 0);
  expect_vec(truth_of(kTask, p, 0)[0], {3.25, 2.5, 1.5}, 0);
}

TEST(PbfBaseline, OnlyGravityChangesTheMomentum) {
  Problem p = find_task(kTask).set("hard_crushed").make();
  p.set_scalar("vort_eps", 0);  // confinement is no force between pairs
  const double dt = p.scalar("dt");
  const std::vector<Vec3> before = vectors(p.inputs[1]);
  const Vec3 gained = plus(sum(truth_of(kTask, p, 1)), -1, sum(before));
  expect_vec(gained, {0, 0, dt * p.scalar("gz") * static_cast<double>(before.size())}, 1e-9);
}

TEST(PbfBaseline, OrderAndAxesDoNotMatter) {
  const Particles all = fluid::block(test_block());
  const auto run = [](const Particles& particles, const Vec3& g, std::size_t which) {
    return truth_of(kTask,
                    fluid_problem(kTask, particles,
                                  {{"h", 2},
                                   {"rho0", 1.009775},
                                   {"eps", 0.5},
                                   {"k_corr", 0.1},
                                   {"dq", 0.3},
                                   {"iters", 2},
                                   {"dt", 0.1},
                                   {"gx", g[0]},
                                   {"gy", g[1]},
                                   {"gz", g[2]},
                                   {"c_visc", 0.1},
                                   {"vort_eps", 0.1}}),
                    which);
  };
  for (const std::size_t which : {0u, 1u})
    expect_all(run(turned(all), {2, 3, 1}, which), turned(run(all, {1, 2, 3}, which)), 1e-9);
}

TEST(PbfBaseline, AColumnCollapses) {
  time_loop_pbf("baseline_f64");
}

}  // namespace
}  // namespace gpuphys::testing
