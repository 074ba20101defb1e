// The serial baseline of poisson_neumann against what is known without it: systems solved by hand,
// manufactured solutions, the two solvers against each other, and the identities of a Neumann operator.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

// The baseline lives in an unnamed namespace: testing it means being in its translation unit.
#include "serial_baselines/global_solve/poisson_neumann.cpp"
#include "tests/poisson_baseline.hpp"

namespace gpuphys::poisson_neumann {

Task make_task();

namespace {

namespace shared = poisson_testing;
using poisson::Boundary;
using seven_point_baseline::norm;
using shared::NullSpace, shared::Rows, shared::set_b, shared::small_sets;

Problem box(std::int64_t nx, std::int64_t ny, std::int64_t nz, const poisson::FaceConductance& conductance) {
  return shared::box(nx, ny, nz, Boundary::neumann, conductance);
}

template <class Real>
std::vector<double> solved(const Problem& p) {
  return shared::solved<Baseline, Real>(p);
}

template <class Real>
class PoissonNeumannBaseline : public testing::Test {
 protected:
  static constexpr double kExact = shared::kExact<Real>;
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(PoissonNeumannBaseline, Reals);

// Flux q through a face of conductance g needs a drop of q/g; zero mean puts half of it on either side.
TYPED_TEST(PoissonNeumannBaseline, SolvesTwoCellsByHand) {
  for (int axis = 0; axis < 3; ++axis) {
    Problem p = box(1 + (axis == 0), 1 + (axis == 1), 1 + (axis == 2), [](auto...) { return 0.25; });
    set_b(p, {1, -1});
    const std::vector<double> x = solved<TypeParam>(p);
    EXPECT_NEAR(x[0], 2, 2 * this->kExact);
    EXPECT_NEAR(x[1], -2, 2 * this->kExact);
  }
}

// Sources 3 and 1, sink 4, conductances 1 and 2: fluxes 3 and 4, drops 3 and 2, so x = (a, a-3, a-5) with a =
// 8/3.
TYPED_TEST(PoissonNeumannBaseline, SolvesThreeCellsByHand) {
  for (int axis = 0; axis < 3; ++axis) {
    Problem p = box(axis == 0 ? 3 : 1, axis == 1 ? 3 : 1, axis == 2 ? 3 : 1,
                    [axis](int d, std::int64_t i, std::int64_t j, std::int64_t k) {
                      const std::int64_t at[3] = {i, j, k};
                      return d == axis ? (at[axis] == 0 ? 1.0 : 2.0) : 0.0;
                    });
    set_b(p, {3, 1, -4});
    const std::vector<double> x = solved<TypeParam>(p);
    EXPECT_NEAR(x[0], 8.0 / 3, 4 * this->kExact);
    EXPECT_NEAR(x[1], -1.0 / 3, 4 * this->kExact);
    EXPECT_NEAR(x[2], -7.0 / 3, 4 * this->kExact);
  }
}

// An L of three cells in a 2 x 2 box with an inactive corner, whose value must be exactly zero.
TYPED_TEST(PoissonNeumannBaseline, LeavesInactiveCellsAtZero) {
  Problem p = poisson::make_system(2, 2, 1, 1e-6);
  poisson::assemble(
      p, poisson::Boundary::neumann,
      [](std::int64_t i, std::int64_t j, std::int64_t) { return i == 0 || j == 0; },
      [](auto...) { return 1.0; });
  set_b(p, {0, 1, -1, 0});  // from (0,1) through (0,0) to (1,0)
  const std::vector<double> x = solved<TypeParam>(p);
  EXPECT_NEAR(x[0], 0, this->kExact);
  EXPECT_NEAR(x[1], 1, this->kExact);
  EXPECT_NEAR(x[2], -1, this->kExact);
  EXPECT_EQ(x[3], 0);
}

TYPED_TEST(PoissonNeumannBaseline, ReturnsZeroForAZeroRightHandSide) {
  const Problem p = box(4, 3, 5, [](auto...) { return 1.0; });
  for (const double v : solved<TypeParam>(p)) EXPECT_EQ(v, 0);
}

TYPED_TEST(PoissonNeumannBaseline, SolutionScalesWithTheRightHandSide) {
  Problem p = box(5, 4, 3, [](auto...) { return 0.5; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 3, 1, 0.5));
  shared::expect_solution_to_scale<Baseline, TypeParam>(p);
}

TEST(PoissonNeumannBaselineF32, EndsWhenTheToleranceIsOutOfReach) {
  shared::expect_an_end_when_the_tolerance_is_out_of_reach<Baseline>(Boundary::neumann);
}

TEST(PoissonNeumannBaselineF32, StopsEarlierForALooserTolerance) {
  shared::expect_an_earlier_stop_for_a_looser_tolerance<Baseline>(Boundary::neumann);
}

TEST(PoissonNeumannBaselineF64, CholmodAgreesWithConjugateGradients) {
  shared::expect_cholmod_to_agree_with_conjugate_gradients(make_task(), NullSpace::constants);
}

// cos(pi x) cos(2 pi y) cos(pi z) on the unit cube has zero normal derivative and zero mean.
TEST(PoissonNeumannBaselineF64, ConvergesAtSecondOrderToACosineSolution) {
  shared::expect_second_order<Baseline>(
      Boundary::neumann, [](auto...) { return 0.0; },
      [](double s) { return std::cos(std::numbers::pi * s); });
}

// b = A (x* + 7) is b = A x* up to the rounding of the diagonals; the answer must be the zero-mean
// representative.
TEST(PoissonNeumannBaselineF64, RecoversAShiftedManufacturedSolution) {
  Problem p = make_task().set("hard_odd_33x17x5").make();
  const Inputs in = bind_inputs<Inputs>(p);
  const std::vector<double> exact = poisson::ramp_and_noise(p, 5, 1, 0.5);
  std::vector<double> shifted = exact;
  for (std::int64_t c = 0; c < in.b.size(); ++c) {
    if (in.is_dof.data[c]) shifted[static_cast<std::size_t>(c)] += 7;
  }
  poisson::set_right_hand_side(p, shifted);
  // 7 row sums of up to 2^-24 of the diagonal each
  EXPECT_LT(shared::energy_error(p, solved<double>(p), exact), 1e-5);
  EXPECT_LT(shared::energy_error(p, solved<float>(p), exact), 1e-4);
}

TEST(PoissonNeumannBaselineF64, RecoversTheManufacturedSolutionOfThePublicSmokeSet) {
  const Problem p = make_task().set("public_smoke").make();
  EXPECT_LT(shared::energy_error(p, solved<double>(p), poisson::ramp_and_noise(p, 1, 1, 0.5)), 1e-6);
}

TEST(PoissonNeumannOperator, IsSymmetric) {
  shared::expect_a_symmetric_operator(make_task(), NullSpace::constants);
}

// Columns sum to zero up to the one rounding of each diagonal: what A x creates in total is bounded by it.
TEST(PoissonNeumannOperator, ConservesUpToTheRoundingOfTheDiagonals) {
  for (const InputSet& set : small_sets(make_task())) {
    if (set.name == "hard_one_cell") continue;  // its diagonal is not a sum of couplings
    const Problem p = set.make();
    const Rows<double> a(bind_inputs<Inputs>(p), NullSpace::constants);
    const std::size_t n = static_cast<std::size_t>(a.size());
    const std::vector<double> x = shared::random_vector(n, 3);
    std::vector<double> ax(n);
    a.multiply(x, ax);
    double sum = 0, allowed = 0;
    for (std::size_t i = 0; i < n; ++i) {
      sum += ax[i];
      allowed += 0x1p-24 * a.diagonal[i] * std::abs(x[i]);
    }
    EXPECT_LE(std::abs(sum), allowed + 1e-15 * norm(ax) * static_cast<double>(n)) << set.name;
  }
}

TEST(PoissonNeumannOperator, AgreesWithTheOneThatJudges) {
  shared::expect_the_operator_that_judges(make_task(), NullSpace::constants);
}

TEST(PoissonNeumannPreconditioner, IsSymmetricAndPositive) {
  shared::expect_a_symmetric_positive_preconditioner(make_task().set("hard_odd_33x17x5").make(),
                                                     NullSpace::constants);
}

TEST(PairwiseSum, KeepsTheDigitsThatARunningFloatSumLoses) {
  constexpr std::int64_t n = 10'000'000;
  const float term = 0.1f;
  const double exact = static_cast<double>(term) * static_cast<double>(n);
  EXPECT_LT(
      std::abs(seven_point_baseline::pairwise_sum<float>(0, n, [&](std::int64_t) { return term; }) - exact),
      1e-5 * exact);
  float running = 0;
  for (std::int64_t i = 0; i < n; ++i) running += term;
  EXPECT_GT(std::abs(running - exact), 1e-3 * exact);
}

}  // namespace
}  // namespace gpuphys::poisson_neumann
