// The serial baseline of solve_constraint_xpbd, validated on its own: by hand, by closed forms, by
// conservation and against a dense solve.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "cases/position_constraint/solve_constraint_xpbd.hpp"
#include "cases/position_constraint/spring_inputs.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/solve_constraint_xpbd.hpp"

namespace gpuphys {
namespace {

using position_constraint::SpringSystem;
using testing::run_module;

const Task& task() {
  return find_task("solve_constraint_xpbd");
}

struct Solver {
  double compliance = 0, dt = 1;
  int iterations = 1;
};

// Positions after the solve, FP64.
std::vector<double> solved(const SpringSystem& system, const Solver& solver,
                           const std::string& label = "baseline_f64") {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(system.position.size())},
                                             {"m", static_cast<std::int64_t>(system.springs.size())}});
  position_constraint::store(system, p);
  p.set_scalar("compliance", solver.compliance);
  p.set_scalar("dt", solver.dt);
  p.set_scalar("iters", solver.iterations);
  const Arrays out = run_module(task(), label, p);
  std::vector<double> x;
  for (std::int64_t i = 0; i < out[0].size(); ++i) x.push_back(out[0].value(i));
  return x;
}

TEST(SolveConstraintXpbdBaseline, OneSpringByHand) {
  // Length 3, rest 1: C = 2. With w = 1 and 3, alpha~ = 0: dlambda = -1/2, the ends move by 1/2 and 3/2
  // towards each other, and the spring is at rest after one iteration.
  const SpringSystem s{{{0, 0, 0}, {3, 0, 0}}, {1, 3}, {{0, 1}}, {1}};
  const std::vector<double> x = solved(s, {0, 1, 1});
  EXPECT_EQ(x, (std::vector<double>{0.5, 0, 0, 1.5, 0, 0}));
  EXPECT_EQ(solved(s, {0, 1, 5}), x);
}

TEST(SolveConstraintXpbdBaseline, ChainOfTwoByHand) {
  // The middle particle has two springs, so each correction is halved. C = 1 and 2, alpha~ = 2 / 0.5^2 = 8, w
  // = 1: dlambda = -1/10/2 and -2/10/2, and the middle moves by the difference of both.
  const SpringSystem s{{{0, 0, 0}, {0, 2, 0}, {0, 2, 3}}, {}, {{1, 0}, {1, 2}}, {1, 1}};
  const std::vector<double> x = solved(s, {2, 0.5, 1});
  const std::vector<double> expected{0, 0.05, 0, 0, 1.95, 0.1, 0, 2, 2.9};
  for (std::size_t i = 0; i < x.size(); ++i) EXPECT_NEAR(x[i], expected[i], 1e-15) << i;
}

TEST(SolveConstraintXpbdBaseline, MultipliersAccumulate) {
  // One spring of valence one, alpha~ = 2, w = 1: the first iteration leaves lambda = -C/(2 + alpha~), for
  // which C_now + alpha~ lambda = 0, so that further iterations change nothing: closed form C alpha~ / (2 +
  // alpha~).
  const SpringSystem s{{{0, 0, 0}, {0, 0, 2}}, {}, {{0, 1}}, {1}};
  for (const int iterations : {1, 2, 8}) {
    const std::vector<double> x = solved(s, {2, 1, iterations});
    EXPECT_NEAR(x[5] - x[2] - 1, 0.5, 1e-15) << iterations;
  }
}

TEST(SolveConstraintXpbdBaseline, ConvergesToTheSolutionOfTheLinearSystem) {
  // A straight chain of springs along x with one end pinned: C is linear in the positions, so that the
  // multipliers tend to the solution of (J W J^T + alpha~) lambda = -C.
  constexpr std::size_t m = 6;
  constexpr double alpha = 0.25;
  SpringSystem s;
  for (std::size_t i = 0; i <= m; ++i) {
    const auto k = static_cast<double>(i);
    s.position.push_back({1.25 * k + 0.0625 * k * k, 0, 0});
    s.inv_mass.push_back(i == 0 ? 0 : 0.5 * k);
    if (i == 0) continue;
    s.springs.push_back({static_cast<std::int32_t>(i), static_cast<std::int32_t>(i - 1)});
    s.rest.push_back(1);
  }
  // Tridiagonal system by elimination.
  std::vector<double> diagonal(m), off(m), right(m), lambda(m + 1, 0.0);
  for (std::size_t j = 0; j < m; ++j) {
    diagonal[j] = s.inv_mass[j] + s.inv_mass[j + 1] + alpha;
    off[j] = -s.inv_mass[j + 1];  // coupling of springs j and j + 1
    right[j] = -(s.position[j + 1][0] - s.position[j][0] - 1);
    if (j == 0) continue;
    const double factor = off[j - 1] / diagonal[j - 1];
    diagonal[j] -= factor * off[j - 1];
    right[j] -= factor * right[j - 1];
  }
  for (std::size_t j = m; j-- > 0;)
    lambda[j] = (right[j] - (j + 1 < m ? off[j] * lambda[j + 1] : 0)) / diagonal[j];
  const std::vector<double> x = solved(s, {alpha, 1, 2000});
  for (std::size_t i = 0; i <= m; ++i) {
    const double push = (i > 0 ? lambda[i - 1] : 0.0) - (i < m ? lambda[i] : 0.0);
    EXPECT_NEAR(x[3 * i], s.position[i][0] + s.inv_mass[i] * push, 1e-12) << i;
  }
}

TEST(SolveConstraintXpbdBaseline, MomentumIsConserved) {
  // Sum of dx / w over a cloth of unequal masses; 1e-14 of the sum of magnitudes is the rounding of FP64.
  position_constraint::RolledCloth parameters;
  parameters.rows = 19;
  parameters.columns = 23;
  parameters.free_side = 2;
  const auto cloth = position_constraint::make_rolled_cloth(parameters);
  SpringSystem s{cloth.position, {}, cloth.springs, cloth.rest};
  for (std::size_t i = 0; i < s.position.size(); ++i) s.inv_mass.push_back(0.5 + static_cast<double>(i % 7));
  const std::vector<double> x = solved(s, {0.01, 0.5, 8});
  for (std::size_t d = 0; d < 3; ++d) {
    double sum = 0, scale = 0;
    for (std::size_t i = 0; i < s.position.size(); ++i) {
      const double from = static_cast<double>(static_cast<float>(s.position[i][d]));
      const double w = static_cast<double>(static_cast<float>(s.inv_mass[i]));
      sum += (x[3 * i + d] - from) / w;
      scale += std::abs(x[3 * i + d]) / w;
    }
    EXPECT_LT(std::abs(sum), 1e-14 * scale) << "axis " << d;
  }
}

TEST(SolveConstraintXpbdBaseline, AllSpringsSeeTheSameState) {
  // Springs and their ends in reverse order give the same result but for the rounding of sums.
  position_constraint::RolledCloth parameters;
  parameters.rows = 17;
  parameters.columns = 13;
  parameters.free_side = 1;
  const auto cloth = position_constraint::make_rolled_cloth(parameters);
  SpringSystem s{cloth.position, {}, cloth.springs, cloth.rest};
  const std::vector<double> x = solved(s, {0.005, 0.1, 8});
  std::reverse(s.springs.begin(), s.springs.end());
  std::reverse(s.rest.begin(), s.rest.end());
  for (auto& ends : s.springs) std::swap(ends[0], ends[1]);
  const std::vector<double> y = solved(s, {0.005, 0.1, 8});
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_NEAR(x[i], y[i], 1e-14) << i;
}

TEST(SolveConstraintXpbdBaseline, SkipsWhatHasNoDirectionOrNoMass) {
  // A spring to itself (which does not count in the valence either), coincident ends, two pinned ends.
  const SpringSystem s{{{1, 2, 3}, {1, 2, 3}, {5, 0, 0}, {8, 0, 0}, {0, 0, 9}, {0, 0, 12}},
                       {1, 1, 0, 0, 1, 1},
                       {{0, 1}, {2, 3}, {4, 4}, {4, 5}},
                       {1, 1, 1, 1}};
  const std::vector<double> x = solved(s, {0, 1, 1});
  EXPECT_EQ(x, (std::vector<double>{1, 2, 3, 1, 2, 3, 5, 0, 0, 8, 0, 0, 0, 0, 10, 0, 0, 11}));
}

TEST(SolveConstraintXpbdBaseline, TimeLoop) {
  testing::time_loop_solve_constraint_xpbd("baseline_f64");
}

TEST(RolledCloth, HasThePapersCountsAndNeighbourDistances) {
  EXPECT_EQ(position_constraint::sheet_springs(1024, 1024).size(), 6281218u);
  position_constraint::RolledCloth parameters;
  parameters.rows = 40;
  parameters.columns = 30;
  parameters.free_side = 2;
  parameters.strain = 0;
  parameters.jitter = 0;
  const auto cloth = position_constraint::make_rolled_cloth(parameters);
  EXPECT_EQ(cloth.position.size(), 40u * 30u + 8u);
  std::vector<int> valence(cloth.position.size(), 0);
  for (std::size_t j = 0; j < cloth.springs.size(); ++j) {
    const auto& a = cloth.position[static_cast<std::size_t>(cloth.springs[j][0])];
    const auto& b = cloth.position[static_cast<std::size_t>(cloth.springs[j][1])];
    const double length = std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    // A chord of a circle of radius 5 is shorter than its arc of 2 by 2 (2/5)^2 / 24 = 0.0133.
    EXPECT_LE(length, cloth.rest[j] + 1e-9);
    EXPECT_GE(length, cloth.rest[j] - 0.0134);
    ++valence[static_cast<std::size_t>(cloth.springs[j][0])];
    ++valence[static_cast<std::size_t>(cloth.springs[j][1])];
  }
  EXPECT_EQ(std::count(valence.begin(), valence.end(), 12), 36 * 26);
  EXPECT_EQ(std::count(valence.begin(), valence.end(), 0), 8);
}

}  // namespace
}  // namespace gpuphys
