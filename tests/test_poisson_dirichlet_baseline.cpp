// The serial baseline of poisson_dirichlet against what is known without it: systems solved by hand, a sine
// solution, the two solvers against each other, and what a definite operator of positive conductances
// promises.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

// The baseline lives in an unnamed namespace: testing it means being in its translation unit.
#include "serial_baselines/global_solve/poisson_dirichlet.cpp"
#include "tests/poisson_baseline.hpp"

namespace gpuphys::poisson_dirichlet {

Task make_task();

namespace {

namespace shared = poisson_testing;
using poisson::Boundary;
using shared::NullSpace, shared::set_b;

Problem box(std::int64_t nx, std::int64_t ny, std::int64_t nz, const poisson::FaceConductance& conductance) {
  return shared::box(nx, ny, nz, Boundary::dirichlet, conductance);
}

template <class Real>
std::vector<double> solved(const Problem& p) {
  return shared::solved<Baseline, Real>(p);
}

template <class Real>
class PoissonDirichletBaseline : public testing::Test {
 protected:
  static constexpr double kExact = shared::kExact<Real>;
};
using Reals = testing::Types<float, double>;
TYPED_TEST_SUITE(PoissonDirichletBaseline, Reals);

// Six faces of conductance 1/4 around one cell: 1.5 x = 3.
TYPED_TEST(PoissonDirichletBaseline, SolvesOneCellByHand) {
  Problem p = box(1, 1, 1, [](auto...) { return 0.25; });
  set_b(p, {3});
  EXPECT_NEAR(solved<TypeParam>(p)[0], 2, 2 * this->kExact);
}

// A bar of three cells with closed sides, conductances 1, 2, 2, 1 along it and a unit source in the middle:
// half of it flows out at either end, over resistances 1 and 1/2.
TYPED_TEST(PoissonDirichletBaseline, SolvesABarByHand) {
  for (int axis = 0; axis < 3; ++axis) {
    Problem p = box(axis == 0 ? 3 : 1, axis == 1 ? 3 : 1, axis == 2 ? 3 : 1,
                    [axis](int d, std::int64_t i, std::int64_t j, std::int64_t k) {
                      const std::int64_t at[3] = {i, j, k};
                      if (d != axis) return 0.0;
                      return at[axis] == -1 || at[axis] == 2 ? 1.0 : 2.0;
                    });
    set_b(p, {0, 1, 0});
    const std::vector<double> x = solved<TypeParam>(p);
    EXPECT_NEAR(x[0], 0.5, this->kExact);
    EXPECT_NEAR(x[1], 0.75, this->kExact);
    EXPECT_NEAR(x[2], 0.5, this->kExact);
  }
}

// Two cells with an inactive one between them know nothing of each other: 6 x = b each.
TYPED_TEST(PoissonDirichletBaseline, AnInactiveCellIsHeldAtZero) {
  Problem p = poisson::make_system(1, 1, 3, 1e-6);
  poisson::assemble(
      p, Boundary::dirichlet, [](std::int64_t, std::int64_t, std::int64_t k) { return k != 1; },
      [](auto...) { return 1.0; });
  set_b(p, {6, 0, -12});
  const std::vector<double> x = solved<TypeParam>(p);
  EXPECT_NEAR(x[0], 1, this->kExact);
  EXPECT_EQ(x[1], 0);
  EXPECT_NEAR(x[2], -2, 2 * this->kExact);
}

TYPED_TEST(PoissonDirichletBaseline, ReturnsZeroForAZeroRightHandSide) {
  const Problem p = box(4, 3, 5, [](auto...) { return 1.0; });
  for (const double v : solved<TypeParam>(p)) EXPECT_EQ(v, 0);
}

TYPED_TEST(PoissonDirichletBaseline, SolutionScalesWithTheRightHandSide) {
  Problem p = box(5, 4, 3, [](auto...) { return 0.5; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 3, 1, 0.5));
  shared::expect_solution_to_scale<Baseline, TypeParam>(p);
}

// The inverse of such a matrix has no negative entry: sources nowhere negative, a solution nowhere negative.
TYPED_TEST(PoissonDirichletBaseline, KeepsTheSignOfItsSources) {
  for (const char* name : {"hard_odd_33x17x5", "hard_channel_512x4x4", "hard_maze"}) {
    Problem p = make_task().set(name).make();
    const Inputs in = bind_inputs<Inputs>(p);
    std::vector<float> b(static_cast<std::size_t>(in.b.size()), 0.0f);
    for (std::int64_t c = 0; c < in.b.size(); ++c) b[static_cast<std::size_t>(c)] = std::abs(in.b.data[c]);
    set_b(p, b);
    double lowest = 0, largest = 0;
    for (const double v : solved<TypeParam>(p)) lowest = std::min(lowest, v), largest = std::max(largest, v);
    EXPECT_GT(largest, 0) << name;
    EXPECT_GE(lowest, -1e-6 * largest) << name;
  }
}

TEST(PoissonDirichletBaselineF32, EndsWhenTheToleranceIsOutOfReach) {
  shared::expect_an_end_when_the_tolerance_is_out_of_reach<Baseline>(Boundary::dirichlet);
}

TEST(PoissonDirichletBaselineF32, StopsEarlierForALooserTolerance) {
  shared::expect_an_earlier_stop_for_a_looser_tolerance<Baseline>(Boundary::dirichlet);
}

TEST(PoissonDirichletBaselineF64, CholmodAgreesWithConjugateGradients) {
  shared::expect_cholmod_to_agree_with_conjugate_gradients(make_task(), NullSpace::nothing);
}

// Zero on the faces of the unit cube, half a cell from the centres: faces of conductance 2.
TEST(PoissonDirichletBaselineF64, ConvergesAtSecondOrderToASineSolution) {
  shared::expect_second_order<Baseline>(
      Boundary::dirichlet, [](auto...) { return 2.0; },
      [](double s) { return std::sin(std::numbers::pi * s); });
}

TEST(PoissonDirichletBaselineF64, RecoversTheManufacturedSolutionOfThePublicSmokeSet) {
  const Problem p = make_task().set("public_smoke").make();
  const std::vector<double> exact = poisson::ramp_and_noise(p, 1, 1, 0.5);
  const std::vector<double> x = solved<double>(p);
  EXPECT_LT(shared::energy_error(p, x, exact), 1e-6);
  EXPECT_LT(shared::relative_difference(x, exact), 1e-5);
}

TEST(PoissonDirichletOperator, IsSymmetric) {
  shared::expect_a_symmetric_operator(make_task(), NullSpace::nothing);
}

TEST(PoissonDirichletOperator, AgreesWithTheOneThatJudges) {
  shared::expect_the_operator_that_judges(make_task(), NullSpace::nothing);
}

TEST(PoissonDirichletPreconditioner, IsSymmetricAndPositive) {
  shared::expect_a_symmetric_positive_preconditioner(make_task().set("hard_odd_33x17x5").make(),
                                                     NullSpace::nothing);
}

}  // namespace
}  // namespace gpuphys::poisson_dirichlet
