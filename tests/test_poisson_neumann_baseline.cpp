// The serial baseline of poisson_neumann against what is known without it: systems solved by hand,
// manufactured solutions, the two solvers against each other, and the identities of a Neumann operator.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "cases/global_solve/poisson_system.hpp"
#include "core/random.hpp"
#include "core/task.hpp"

// The baseline's parts live in an unnamed namespace: testing them means being in their translation unit.
#include "serial_baselines/global_solve/poisson_neumann.cpp"

namespace gpuphys::poisson_neumann {

Task make_task();

namespace {

// A box that is active throughout, with the conductance of every face given.
Problem box(std::int64_t nx, std::int64_t ny, std::int64_t nz, const poisson::FaceConductance& conductance) {
  Problem p = poisson::make_system(nx, ny, nz, 1e-6);
  poisson::assemble(
      p, poisson::Boundary::neumann, [](auto...) { return true; }, conductance);
  return p;
}

void set_b(Problem& p, const std::vector<float>& values) {
  for (HostArray& a : p.inputs) {
    if (a.name() == "b") std::copy(values.begin(), values.end(), a.as<float>().begin());
  }
}

// x as the baseline returns it.
template <class Real>
std::vector<double> solved(const Problem& p) {
  Arrays outputs = make_outputs(describe<Inputs, Outputs<float>>(), p, dtype_of<Real>());
  Baseline<Real> baseline;
  const Inputs in = bind_inputs<Inputs>(p);
  const auto out = bind_outputs<Outputs<Real>>(outputs);
  baseline.allocate(in, out);
  baseline.compute(in, out);
  std::vector<double> x;
  for (std::int64_t c = 0; c < outputs[0].size(); ++c) x.push_back(outputs[0].value(c));
  return x;
}

std::vector<double> random_vector(std::size_t n, std::uint64_t seed) {
  std::vector<double> v(n);
  for (std::size_t i = 0; i < n; ++i) v[i] = uniform11(seed, 50, i);
  return v;
}

double norm2(const std::vector<double>& v) {
  return std::sqrt(dot(v, v));
}

double relative_difference(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> d(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) d[i] = a[i] - b[i];
  return norm2(d) / norm2(b);
}

// All sets that are cheap enough to solve here.
std::vector<InputSet> small_sets() {
  std::vector<InputSet> sets;
  for (const InputSet& s : make_task().sets) {
    if (s.size == Size::smoke) sets.push_back(s);
  }
  return sets;
}

template <class Real>
class PoissonNeumannBaseline : public testing::Test {
 protected:
  // A few roundings of values of size 1.
  static constexpr double kExact = 8 * static_cast<double>(std::numeric_limits<Real>::epsilon());
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
  const std::vector<double> x = solved<TypeParam>(p);
  std::vector<float> scaled;
  for (const HostArray& a : p.inputs) {
    if (a.name() == "b") scaled.assign(a.as<float>().begin(), a.as<float>().end());
  }
  for (const int exponent : {-66, 66}) {  // powers of two, so that nothing else may change
    std::vector<float> b = scaled;
    for (float& v : b) v = std::ldexp(v, exponent);
    set_b(p, b);
    const std::vector<double> y = solved<TypeParam>(p);
    for (std::size_t c = 0; c < x.size(); ++c) EXPECT_EQ(y[c], std::ldexp(x[c], exponent));
  }
}

TEST(PoissonNeumannBaselineF32, EndsWhenTheToleranceIsOutOfReach) {
  Problem p = box(12, 11, 10, [](auto...) { return 1.0; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 4, 1, 0.5));
  p.set_scalar("tol", 1e-20);
  Arrays x = make_outputs(describe<Inputs, Outputs<float>>(), p);
  const std::vector<double> values = solved<float>(p);
  std::copy(values.begin(), values.end(), x[0].as<float>().begin());
  EXPECT_LT(poisson::residual_of(p, x[0]).relative_l2, 5e-7);
}

TEST(PoissonNeumannBaselineF32, StopsEarlierForALooserTolerance) {
  Problem p = box(20, 19, 18, [](auto...) { return 1.0; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 4, 1, 0.5));
  double before = 0;
  for (const double tol : {1e-6, 1e-5, 1e-4, 1e-3, 1e-2}) {
    p.set_scalar("tol", tol);
    Arrays x = make_outputs(describe<Inputs, Outputs<float>>(), p);
    const std::vector<double> values = solved<float>(p);
    std::copy(values.begin(), values.end(), x[0].as<float>().begin());
    const double residual = poisson::residual_of(p, x[0]).relative_l2;
    EXPECT_LT(residual, tol);
    EXPECT_GT(residual, before);
    before = residual;
  }
}

// Two solvers that share only the matrix rows.
TEST(PoissonNeumannBaselineF64, CholmodAgreesWithConjugateGradients) {
  int compared = 0;
  for (const InputSet& set : small_sets()) {
    const Problem p = set.make();
    const Inputs in = bind_inputs<Inputs>(p);
    const Rows<double> a(in);
    if (a.size() < 2 || a.size() > 20000) continue;
    Vector<double> b(static_cast<std::size_t>(a.size())), r(b.size());
    for (std::int64_t i = 0; i < a.size(); ++i) b[i] = in.b.data[a.cell[i]];
    if (norm(b) == 0) continue;
    ++compared;
    const Vector<double> direct = solve(a, b, 0.0);
    const Vector<double> iterative = solve(a, b, 0.0, /*direct_limit=*/0);
    remove_mean(b);
    for (const Vector<double>* x : {&direct, &iterative}) {
      a.residual(b, *x, r);
      EXPECT_LT(norm(r), 1e-11 * norm(b)) << set.name;
    }
    EXPECT_LT(relative_difference(iterative, direct), 1e-8) << set.name;
  }
  EXPECT_GE(compared, 8);
}

// cos(pi x) cos(2 pi y) cos(pi z) on the unit cube has zero normal derivative and zero mean.
TEST(PoissonNeumannBaselineF64, ConvergesAtSecondOrderToACosineSolution) {
  const auto error = [](std::int64_t n) {
    Problem p = box(n, n, n, [](auto...) { return 1.0; });
    const double h = 1.0 / static_cast<double>(n), pi = std::numbers::pi;
    std::vector<double> exact;
    std::vector<float> b;
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::int64_t j = 0; j < n; ++j) {
        for (std::int64_t k = 0; k < n; ++k) {
          const auto at = [&](std::int64_t q) { return (static_cast<double>(q) + 0.5) * h; };
          const double u = std::cos(pi * at(i)) * std::cos(2 * pi * at(j)) * std::cos(pi * at(k));
          exact.push_back(u);
          b.push_back(static_cast<float>(h * h * 6 * pi * pi * u));  // -h^2 laplace(u)
        }
      }
    }
    set_b(p, b);
    return relative_difference(solved<double>(p), exact);
  };
  const double coarse = error(6), middle = error(12), fine = error(24);
  EXPECT_NEAR(std::log2(coarse / middle), 2, 0.15);
  EXPECT_NEAR(std::log2(middle / fine), 2, 0.05);
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
  const auto energy_error = [&](const std::vector<double>& x) {
    std::vector<double> e(x.size());
    for (std::size_t c = 0; c < x.size(); ++c) e[c] = x[c] - exact[c];
    return std::sqrt(dot(e, poisson::multiply(in, e)) / dot(exact, poisson::multiply(in, exact)));
  };
  EXPECT_LT(energy_error(solved<double>(p)), 1e-5);  // 7 row sums of up to 2^-24 of the diagonal each
  EXPECT_LT(energy_error(solved<float>(p)), 1e-4);
}

TEST(PoissonNeumannBaselineF64, RecoversTheManufacturedSolutionOfThePublicSmokeSet) {
  const Problem p = make_task().set("public_smoke").make();
  const Inputs in = bind_inputs<Inputs>(p);
  const std::vector<double> exact = poisson::ramp_and_noise(p, 1, 1, 0.5);
  std::vector<double> e = solved<double>(p);
  for (std::size_t c = 0; c < e.size(); ++c) e[c] -= exact[c];
  EXPECT_LT(std::sqrt(dot(e, poisson::multiply(in, e)) / dot(exact, poisson::multiply(in, exact))), 1e-6);
}

TEST(PoissonNeumannOperator, IsSymmetric) {
  for (const InputSet& set : small_sets()) {
    const Problem p = set.make();
    const Rows<double> a(bind_inputs<Inputs>(p));
    const std::size_t n = static_cast<std::size_t>(a.size());
    const std::vector<double> x = random_vector(n, 1), y = random_vector(n, 2);
    std::vector<double> ax(n), ay(n);
    a.multiply(x, ax);
    a.multiply(y, ay);
    EXPECT_NEAR(dot(y, ax), dot(x, ay), 1e-13 * (1 + norm2(x) * norm2(ay))) << set.name;
  }
}

// Columns sum to zero up to the one rounding of each diagonal: what A x creates in total is bounded by it.
TEST(PoissonNeumannOperator, ConservesUpToTheRoundingOfTheDiagonals) {
  for (const InputSet& set : small_sets()) {
    if (set.name == "hard_one_cell") continue;  // its diagonal is not a sum of couplings
    const Problem p = set.make();
    const Rows<double> a(bind_inputs<Inputs>(p));
    const std::size_t n = static_cast<std::size_t>(a.size());
    const std::vector<double> x = random_vector(n, 3);
    std::vector<double> ax(n);
    a.multiply(x, ax);
    double sum = 0, allowed = 0;
    for (std::size_t i = 0; i < n; ++i) {
      sum += ax[i];
      allowed += 0x1p-24 * a.diagonal[i] * std::abs(x[i]);
    }
    EXPECT_LE(std::abs(sum), allowed + 1e-15 * norm2(ax) * static_cast<double>(n)) << set.name;
  }
}

// The judging code has its own A x.
TEST(PoissonNeumannOperator, AgreesWithTheOneThatJudges) {
  for (const InputSet& set : small_sets()) {
    const Problem p = set.make();
    const Inputs in = bind_inputs<Inputs>(p);
    const Rows<double> a(in);
    const std::size_t n = static_cast<std::size_t>(a.size());
    const std::vector<double> x = random_vector(n, 4);
    std::vector<double> everywhere(static_cast<std::size_t>(in.b.size()), 0.0), ax(n);
    for (std::size_t i = 0; i < n; ++i) everywhere[static_cast<std::size_t>(a.cell[i])] = x[i];
    a.multiply(x, ax);
    const std::vector<double> judged = poisson::multiply(in, everywhere);
    double worst = 0;
    for (std::size_t i = 0; i < n; ++i) {
      worst = std::max(worst, std::abs(judged[static_cast<std::size_t>(a.cell[i])] - ax[i]));
    }
    EXPECT_LE(worst, 1e-14) << set.name;
  }
}

TEST(PoissonNeumannPreconditioner, IsSymmetricAndPositive) {
  const Problem p = make_task().set("hard_odd_33x17x5").make();
  const Rows<double> a(bind_inputs<Inputs>(p));
  const std::size_t n = static_cast<std::size_t>(a.size());
  const std::vector<double> x = random_vector(n, 5), y = random_vector(n, 6);
  std::vector<double> mx(n), my(n);
  a.precondition(x, mx);
  a.precondition(y, my);
  EXPECT_NEAR(dot(y, mx), dot(x, my), 1e-12 * norm2(x) * norm2(my));
  EXPECT_GT(dot(x, mx), 0);
  EXPECT_GT(dot(y, my), 0);
}

TEST(PairwiseSum, KeepsTheDigitsThatARunningFloatSumLoses) {
  constexpr std::int64_t n = 10'000'000;
  const float term = 0.1f;
  const double exact = static_cast<double>(term) * static_cast<double>(n);
  EXPECT_LT(std::abs(pairwise_sum<float>(0, n, [&](std::int64_t) { return term; }) - exact), 1e-5 * exact);
  float running = 0;
  for (std::int64_t i = 0; i < n; ++i) running += term;
  EXPECT_GT(std::abs(running - exact), 1e-3 * exact);
}

}  // namespace
}  // namespace gpuphys::poisson_neumann
