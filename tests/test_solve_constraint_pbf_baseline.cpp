// The serial baseline of solve_constraint_pbf, validated on its own: by hand, by all pairs, by conservation,
// and by what iterations do to the density.
#include <gtest/gtest.h>

#include "tests/fluid_baseline.hpp"

namespace gpuphys::testing {
namespace {

const std::string kTask = "solve_constraint_pbf";
constexpr double kRest = 1.009775;

Problem solver_problem(const Particles& all, int iters, double eps = 0.5, double k_corr = 0.1,
                       double dq = 0.3, double rho0 = kRest, double h = 2) {
  return fluid_problem(
      kTask, all, {{"h", h}, {"rho0", rho0}, {"eps", eps}, {"k_corr", k_corr}, {"dq", dq}, {"iters", iters}});
}

std::vector<double> densities(const std::vector<Vec3>& x, double h) {
  std::vector<double> rho(x.size(), 0);
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (const Vec3& other : x) rho[i] += poly6(length(plus(x[i], -1, other)), h);
  }
  return rho;
}

// One iteration, for all pairs, from positions that need not be float32.
std::vector<Vec3> iterate(const std::vector<Vec3>& x, const Problem& p) {
  const double h = p.scalar("h"), rho0 = p.scalar("rho0"), k = p.scalar("k_corr");
  const double at_dq = poly6(p.scalar("dq") * h, h);
  const std::vector<double> rho = densities(x, h);
  std::vector<double> lambda(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    double squares = 0;
    Vec3 own{};
    for (const Vec3& other : x) {
      const Vec3 g = spiky(plus(x[i], -1, other), h);
      squares += dot(g, g) / rho0 / rho0;
      own = plus(own, 1 / rho0, g);
    }
    lambda[i] = -(rho[i] / rho0 - 1) / (squares + dot(own, own) + p.scalar("eps"));
  }
  std::vector<Vec3> moved = x;
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) {
      const Vec3 d = plus(x[i], -1, x[j]);
      const double pressure = -k * std::pow(poly6(length(d), h) / at_dq, 4);
      moved[i] = plus(moved[i], (lambda[i] + lambda[j] + pressure) / rho0, spiky(d, h));
    }
  }
  return moved;
}

TEST(SolveConstraintPbfBaseline, APairByHand) {
  // h = 2, r = 1, rho0 = W(0): C = (1 - 1/4)^3 = 27/64; |grad W| = 45/(16 pi)/4, W(0) = 315/(512 pi), so
  // |grad C| = 4/7 x 8/4 = 8/7; S = 2 (8/7)^2; no pressure. Each moves by 8/7 x 2 lambda.
  const double peak = 315 / (512 * std::numbers::pi);
  const auto x = truth_of(kTask, solver_problem({{{0, 0, 0}, {}}, {{1, 0, 0}, {}}}, 1, 1, 0, 0, peak));
  const double step = 8.0 / 7 * 2 * (27.0 / 64) / (2 * 64.0 / 49 + 1);
  expect_vec(x[0], {-step, 0, 0}, 1e-6);
  expect_vec(x[1], {1 + step, 0, 0}, 1e-6);
}

TEST(SolveConstraintPbfBaseline, PressureAtItsDistanceIsKCorr) {
  // Two particles dq h apart, with C made zero by the rest density: only s = -k is left.
  const double rest = poly6(0, 2) + poly6(1, 2);
  const auto x = truth_of(kTask, solver_problem({{{0, 0, 0}, {}}, {{0, 1, 0}, {}}}, 1, 1, 0.25, 0.5, rest));
  const double step = 0.25 * 45 / (16 * std::numbers::pi) / 4 / rest;
  expect_vec(x[0], {0, -step, 0}, 1e-6);
}

TEST(SolveConstraintPbfBaseline, EqualsTheFormulasOverAllPairs) {
  for (const std::string set :
       {"hard_crushed", "hard_coincident", "hard_h_1_5", "hard_line_x", "hard_pressure_at_0"}) {
    const Problem p = find_task(kTask).set(set).make();
    std::vector<Vec3> x = vectors(p.inputs[0]);
    for (int k = 0; k < static_cast<int>(p.scalar("iters")); ++k) x = iterate(x, p);
    expect_all(truth_of(kTask, p), x, 1e-9);
  }
}

TEST(SolveConstraintPbfBaseline, PairsMoveInOppositeDirections) {
  const Problem p = solver_problem(fluid::block(test_block()), 5);
  expect_vec(sum(truth_of(kTask, p)), sum(vectors(p.inputs[0])), 1e-10);
}

TEST(SolveConstraintPbfBaseline, TheInteriorOfALatticeStays) {
  const Particles all = fluid::block({.lattice = {11, 10, 9}, .corner = {0, 0, 0}});
  const auto x = truth_of(kTask, solver_problem(all, 1));
  int inside = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const Vec3& at = all[i].x;
    if (std::min({at[0], at[1], at[2], 10 - at[0], 9 - at[1], 8 - at[2]}) < 4) continue;
    ++inside;
    expect_vec(x[i], at, 1e-12, i);
  }
  EXPECT_EQ(inside, 3 * 2 * 1);
}

TEST(SolveConstraintPbfBaseline, TheDensityOfTheLatticeIsItsRestDensity) {
  std::vector<Vec3> x;
  for (const Particle& p : fluid::block({.lattice = {5, 5, 5}})) x.push_back(p.x);
  const std::vector<double> rho = densities(x, 2);
  EXPECT_NEAR(*std::max_element(rho.begin(), rho.end()), kRest, 1e-6);
}

TEST(SolveConstraintPbfBaseline, IterationsBringDensitiesToRest) {
  const Particles all = fluid::block({.lattice = {12, 12, 12}, .seed = 4, .jitter = 0.1, .wave = 0.3});
  const auto excess = [&](int iters) {
    double square = 0;
    for (const double rho : densities(truth_of(kTask, solver_problem(all, iters, 0.5, 0)), 2)) {
      const double above = std::max(0.0, rho / kRest - 1);
      square += above * above;
    }
    return square;
  };
  const double before = excess(0), after_two = excess(2);
  EXPECT_LT(after_two, 0.5 * before);
  EXPECT_LT(excess(5), 0.6 * after_two);
}

// Otherwise rounding would decide directions, and correct programs could differ.
TEST(SolveConstraintPbfBaseline, NoComparedSetBringsParticlesTogether) {
  for (const InputSet& set : find_task(kTask).sets) {
    if (set.size == Size::paper || !set.use_task_checks) continue;
    Problem p = set.make();
    const double h = p.scalar("h");
    const int iters = static_cast<int>(p.scalar("iters"));
    for (int k = iters > 1 ? 0 : 1; k < iters; ++k) {
      p.set_scalar("iters", k);
      std::vector<Vec3> x = truth_of(kTask, p);
      std::sort(x.begin(), x.end());
      double least = h;
      for (std::size_t a = 0; a < x.size(); ++a) {
        for (std::size_t b = a + 1; b < x.size() && x[b][0] - x[a][0] < least; ++b)
          least = std::min(least, length(plus(x[a], -1, x[b])));
      }
      EXPECT_GT(least, 1e-3 * h) << set.name << " before iteration " << k;
    }
  }
}

TEST(SolveConstraintPbfBaseline, OrderAndAxesDoNotMatter) {
  const Particles all = fluid::block(test_block());
  expect_all(truth_of(kTask, solver_problem(turned(all), 3)), turned(truth_of(kTask, solver_problem(all, 3))),
             1e-10);
}

}  // namespace
}  // namespace gpuphys::testing
