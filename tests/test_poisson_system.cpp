// What the Poisson tasks are generated and judged with: assembly by hand, the guarantees of every input set,
// and checks that pass at half their tolerance, fail at twice it, and never pass NaN.
#include "cases/global_solve/poisson_system.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <limits>

#include "core/contract/task.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys {

namespace poisson_dirichlet {
Task make_task();
}
namespace poisson_neumann {
Task make_task();
}

namespace poisson {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

Problem box(std::int64_t nx, std::int64_t ny, std::int64_t nz, Boundary boundary,
            const FaceConductance& conductance) {
  Problem p = make_system(nx, ny, nz, 1e-6);
  assemble(
      p, boundary, [](auto...) { return true; }, conductance);
  return p;
}

void set(Problem& p, const std::string& name, const std::vector<float>& values) {
  for (HostArray& a : p.inputs) {
    if (a.name() == name) std::copy(values.begin(), values.end(), a.as<float>().begin());
  }
}

Arrays outputs_of(const Problem& p, const std::vector<float>& x) {
  Arrays out = make_outputs(describe<Inputs, Outputs<float>>(), p);
  std::copy(x.begin(), x.end(), out[0].as<float>().begin());
  return out;
}

double error(const Check& check, const Problem& p, const std::vector<float>& x) {
  const Arrays out = outputs_of(p, x);
  return check.measure({p, out, nullptr}).error;
}

bool passed(const Check& check, const Problem& p, const std::vector<float>& x) {
  return passes(error(check, p, x), check.tolerance);
}

// Conductances 1, 2, 4 along x of a 2 x 1 x 1 box: outer face, inner face, outer face; 8 and 16 on the side
// faces.
double distinct(int axis, std::int64_t i, std::int64_t, std::int64_t) {
  if (axis == 0) return i == -1 ? 1 : i == 0 ? 2 : 4;
  return axis == 1 ? 8 : 16;
}

TEST(AssembledSystem, NeumannFacesLeaveTheDiagonal) {
  const Problem p = box(2, 1, 1, Boundary::neumann, distinct);
  const Inputs in = bind_inputs<Inputs>(p);
  EXPECT_EQ(in.a_diag(0, 0, 0), 2);
  EXPECT_EQ(in.a_diag(1, 0, 0), 2);
  EXPECT_EQ(in.a_x(0, 0, 0), -2);
  EXPECT_EQ(in.a_x(1, 0, 0), 0);
  EXPECT_EQ(in.a_y(0, 0, 0), 0);
  EXPECT_EQ(in.a_z(1, 0, 0), 0);
  EXPECT_EQ(in.tol, 1e-6f);
}

TEST(AssembledSystem, DirichletFacesStayInTheDiagonal) {
  const Problem p = box(2, 1, 1, Boundary::dirichlet, distinct);
  const Inputs in = bind_inputs<Inputs>(p);
  EXPECT_EQ(in.a_diag(0, 0, 0), 1 + 2 + 8 + 8 + 16 + 16);
  EXPECT_EQ(in.a_diag(1, 0, 0), 2 + 4 + 8 + 8 + 16 + 16);
  EXPECT_EQ(in.a_x(0, 0, 0), -2);
  EXPECT_EQ(in.a_x(1, 0, 0), 0);
}

TEST(AssembledSystem, InactiveCellsAreEmpty) {
  for (const Boundary boundary : {Boundary::neumann, Boundary::dirichlet}) {
    Problem p = make_system(1, 1, 3, 1e-6);
    assemble(
        p, boundary, [](std::int64_t, std::int64_t, std::int64_t k) { return k != 1; },
        [](auto...) { return 1.0; });
    const Inputs in = bind_inputs<Inputs>(p);
    EXPECT_TRUE(in.is_dof(0, 0, 0) && !in.is_dof(0, 0, 1) && in.is_dof(0, 0, 2));
    EXPECT_EQ(in.a_diag(0, 0, 1), 0);
    EXPECT_EQ(in.a_z(0, 0, 0), 0);
    EXPECT_EQ(in.a_z(0, 0, 1), 0);
    EXPECT_EQ(in.a_diag(0, 0, 0), boundary == Boundary::neumann ? 0 : 6);
  }
}

// Rows of a 2 x 2 x 2 box with conductances 1, 10 and 100 along x, y and z, applied to the digits 1 to 8.
TEST(AssembledSystem, MultipliesByHand) {
  const Problem p = box(2, 2, 2, Boundary::neumann, [](int axis, auto...) { return std::pow(10.0, axis); });
  std::vector<double> x{1, 2, 3, 4, 5, 6, 7, 8};  // z steps by 1, y by 2, x by 4
  const std::vector<double> y = multiply(bind_inputs<Inputs>(p), x);
  for (int c = 0; c < 8; ++c) {
    const double along_x = c < 4 ? -4 : 4, along_y = c % 4 < 2 ? -2 : 2, along_z = c % 2 == 0 ? -1 : 1;
    EXPECT_EQ(y[static_cast<std::size_t>(c)], along_x + 10 * along_y + 100 * along_z);
  }
}

TEST(AssembledSystem, RoundingAmplificationOfTwoCells) {
  Problem p = box(2, 1, 1, Boundary::neumann, [](auto...) { return 1.0; });
  set(p, "b", {1, -1});
  // |A||x| = 1*2.5 + 1*1.5 in both rows
  EXPECT_DOUBLE_EQ(rounding_amplification(p, {2.5, 1.5}), 4);
}

TEST(ManufacturedField, HasNoMeanAndKeepsInactiveCellsAtZero) {
  Problem p = make_system(7, 6, 5, 1e-6);
  assemble(
      p, Boundary::neumann, [](std::int64_t i, std::int64_t j, std::int64_t) { return i + j > 2; },
      [](auto...) { return 1.0; });
  const Inputs in = bind_inputs<Inputs>(p);
  const std::vector<double> x = ramp_and_noise(p, 1, 1, 0.5);
  double sum = 0;
  for (std::int64_t c = 0; c < in.b.size(); ++c) {
    sum += x[static_cast<std::size_t>(c)];
    if (!in.is_dof.data[c]) {
      EXPECT_EQ(x[static_cast<std::size_t>(c)], 0);
    }
  }
  EXPECT_NEAR(sum, 0, 1e-13);
}

TEST(ManufacturedField, WithoutNoiseIsTheRamp) {
  const Problem p = box(2, 4, 1, Boundary::neumann, [](auto...) { return 1.0; });
  const std::vector<double> x = ramp_and_noise(p, 1, 3, 0);
  EXPECT_NEAR(x[4] - x[0], 3 * 2.0 / 3 / 2, 1e-14);  // one cell along x
  EXPECT_NEAR(x[1] - x[0], 3 * 2.0 / 3 / 4, 1e-14);  // one cell along y
}

// What both specifications guarantee, cell by cell; `row(cell, magnitudes of its couplings)` sees the active
// ones. Returns how many there are.
std::int64_t expect_valid_rows(const Inputs& in, const std::function<void(std::int64_t, double)>& row) {
  EXPECT_GT(in.tol, 0);
  const std::int64_t n[3] = {in.b.shape[0], in.b.shape[1], in.b.shape[2]};
  const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
  const float* coupling[3] = {in.a_x.data, in.a_y.data, in.a_z.data};
  std::int64_t active = 0, wrong = 0;
  for (std::int64_t c = 0; c < in.b.size(); ++c) {
    const std::int64_t at[3] = {c / step[0], c / step[1] % n[1], c % n[2]};
    double off = 0;
    for (int d = 0; d < 3; ++d) {
      const float a = coupling[d][c];
      const bool next = at[d] + 1 < n[d] && in.is_dof.data[c] && in.is_dof.data[c + step[d]];
      wrong += !std::isfinite(a) || a > 0 || (std::signbit(a) && a == 0) || (!next && a != 0);
      off -= a;
      if (at[d] > 0) off -= coupling[d][c - step[d]];
    }
    wrong += !std::isfinite(in.b.data[c]) || !std::isfinite(in.a_diag.data[c]);
    if (!in.is_dof.data[c]) {
      wrong += in.a_diag.data[c] != 0 || in.b.data[c] != 0;
      continue;
    }
    ++active;
    wrong += !(in.a_diag.data[c] > 0);
    row(c, off);
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_GT(active, 0);
  return active;
}

// The cells that `start` reaches through non-zero couplings.
std::vector<std::int64_t> component_of(const Inputs& in, std::int64_t start, std::vector<char>& reached) {
  const std::int64_t n[3] = {in.b.shape[0], in.b.shape[1], in.b.shape[2]};
  const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
  const float* coupling[3] = {in.a_x.data, in.a_y.data, in.a_z.data};
  std::vector<std::int64_t> cells{start};
  reached[static_cast<std::size_t>(start)] = 1;
  for (std::size_t next = 0; next < cells.size(); ++next) {
    const std::int64_t c = cells[next];
    const std::int64_t at[3] = {c / step[0], c / step[1] % n[1], c % n[2]};
    for (int d = 0; d < 3; ++d) {
      for (const int side : {-1, 1}) {
        if (at[d] + side < 0 || at[d] + side >= n[d]) continue;
        const std::int64_t other = c + side * step[d];
        if (coupling[d][side < 0 ? other : c] == 0 || reached[static_cast<std::size_t>(other)]) continue;
        reached[static_cast<std::size_t>(other)] = 1;
        cells.push_back(other);
      }
    }
  }
  return cells;
}

// On every set that is small enough to look at cell by cell.
TEST(PoissonNeumannInputs, KeepTheGuaranteesOfTheSpecification) {
  int sets = 0;
  for (const InputSet& s : poisson_neumann::make_task().sets) {
    if (s.size != Size::smoke || s.name == "hard_no_active_cell") continue;  // nothing there to look at
    ++sets;
    SCOPED_TRACE(s.name);
    const Problem p = s.make();
    const Inputs in = bind_inputs<Inputs>(p);
    std::int64_t first = -1;
    double sum_b = 0, sum_abs_b = 0, sum_diagonal = 0;
    const std::int64_t active = expect_valid_rows(in, [&](std::int64_t c, double off) {
      if (first < 0) first = c;
      if (s.name != "hard_one_cell") {
        EXPECT_NEAR(in.a_diag.data[c], off, 0x1p-24 * off);
      }
      sum_b += in.b.data[c];
      sum_abs_b += std::abs(in.b.data[c]);
      sum_diagonal += in.a_diag.data[c];
    });
    // b sums to zero up to its own rounding and that of the diagonals, which multiply an x of this size:
    const double size_x = s.name == "hard_channel_source_sink" ? 256
                          : s.name == "hard_huge_rhs"          ? 2e20
                          : s.name == "hard_tiny_rhs"          ? 2e-20
                                                               : 2;
    if (s.name != "hard_incompatible_rhs") {
      EXPECT_LE(std::abs(sum_b), 0x1p-24 * (sum_abs_b + size_x * sum_diagonal));
    }
    std::vector<char> reached(static_cast<std::size_t>(in.b.size()), 0);
    EXPECT_EQ(static_cast<std::int64_t>(component_of(in, first, reached).size()), active);
  }
  EXPECT_GE(sets, 12);
}

TEST(PoissonDirichletInputs, KeepTheGuaranteesOfTheSpecification) {
  int sets = 0;
  for (const InputSet& s : poisson_dirichlet::make_task().sets) {
    if (s.size != Size::smoke || s.name == "hard_no_active_cell") continue;  // nothing there to look at
    ++sets;
    SCOPED_TRACE(s.name);
    const Problem p = s.make();
    const Inputs in = bind_inputs<Inputs>(p);
    const std::size_t cells = static_cast<std::size_t>(in.b.size());
    std::vector<char> held(cells, 0), reached(cells, 0);
    expect_valid_rows(in, [&](std::int64_t c, double off) {
      EXPECT_GE(in.a_diag.data[c], off * (1 - 0x1p-24));
      held[static_cast<std::size_t>(c)] = in.a_diag.data[c] > off * (1 + 0x1p-23);
    });
    // Every component is held at zero somewhere.
    for (std::size_t c = 0; c < cells; ++c) {
      if (!in.is_dof.data[c] || reached[c]) continue;
      bool any = false;
      for (const std::int64_t member : component_of(in, static_cast<std::int64_t>(c), reached))
        any = any || held[static_cast<std::size_t>(member)];
      ASSERT_TRUE(any) << c;
    }
  }
  EXPECT_GE(sets, 10);
}

const std::vector<Task>& tasks() {
  static const std::vector<Task> both = [] {
    std::vector<Task> t;
    t.push_back(poisson_dirichlet::make_task());
    t.push_back(poisson_neumann::make_task());
    return t;
  }();
  return both;
}

TEST(PoissonInputs, AreTheSameEveryTime) {
  for (const Task& t : tasks()) {
    for (const InputSet& s : t.sets) {
      if (s.size != Size::smoke) continue;
      const Problem a = s.make(), b = s.make();
      for (std::size_t q = 0; q < a.inputs.size(); ++q) {
        EXPECT_EQ(std::memcmp(a.inputs[q].data(), b.inputs[q].data(), a.inputs[q].bytes()), 0)
            << t.name << ' ' << s.name << ' ' << a.inputs[q].name();
      }
    }
  }
}

// The active cells of poisson_dirichlet are the same in both, as in the paper.
TEST(PoissonInputs, DifferBetweenThePublicAndTheHiddenSet) {
  for (const Task& t : tasks()) {
    const Problem a = t.set("public_smoke").make(), b = t.set("hidden_smoke").make();
    for (std::size_t q = 0; q < a.inputs.size(); ++q) {
      if (a.inputs[q].name() == "is_dof") continue;  // obstacles may be the same
      EXPECT_NE(std::memcmp(a.inputs[q].data(), b.inputs[q].data(), a.inputs[q].bytes()), 0)
          << t.name << ' ' << a.inputs[q].name();
    }
  }
}

// The manufactured solution is the truth at the paper's size: it must solve the rounded system far below the
// tolerance, also after rounding it to float32.
TEST(PoissonInputs, AreSolvedByTheirManufacturedSolution) {
  for (const Task& t : tasks()) {
    for (const auto& [name, seed] :
         {std::pair<const char*, std::uint64_t>{"public_smoke", 1}, {"hidden_smoke", 2}}) {
      const Problem p = t.set(name).make();
      const std::vector<double> x = ramp_and_noise(p, seed, 1, 0.5);
      EXPECT_LT(residual_of(p, as_solution(t.contract, p, x)[0]).relative_l2, 5e-8) << t.name;
      EXPECT_LT(residual_of(p, outputs_of(p, {x.begin(), x.end()})[0]).relative_l2, 1e-7) << t.name;
    }
  }
}

// Two cells, unit conductance, b = (1, -1): x = (0.5 + e, -0.5 - e) leaves the residual 2e (1, -1).
class PoissonChecks : public testing::Test {
 protected:
  PoissonChecks() : p(box(2, 1, 1, Boundary::neumann, [](auto...) { return 1.0; })) { set(p, "b", {1, -1}); }
  Problem p;
};

TEST_F(PoissonChecks, ResidualPassesAtHalfAndFailsAtTwiceTheTolerance) {
  const Check check = residual_check(1e-3, "");
  EXPECT_EQ(error(check, p, {0.5f, -0.5f}), 0);
  EXPECT_TRUE(passed(check, p, {0.5f + 0.25e-3f, -0.5f - 0.25e-3f}));
  EXPECT_FALSE(passed(check, p, {0.5f + 1e-3f, -0.5f - 1e-3f}));
}

TEST_F(PoissonChecks, ResidualIgnoresAConstant) {
  EXPECT_EQ(error(residual_check(1e-3, ""), p, {8.5f, 7.5f}), 0);
}

TEST_F(PoissonChecks, ResidualIsAbsoluteForAZeroRightHandSide) {
  set(p, "b", {0, 0});
  EXPECT_EQ(error(residual_check(1e-3, ""), p, {0, 0}), 0);
  EXPECT_DOUBLE_EQ(error(residual_check(1e-3, ""), p, {0.5f, -0.5f}), std::sqrt(2.0));
}

TEST_F(PoissonChecks, LocalResidualFindsTheOneBadCell) {
  Problem big = box(1, 1, 1000, Boundary::neumann, [](auto...) { return 1.0; });
  std::vector<double> x(1000);
  for (std::size_t c = 0; c < 1000; ++c) x[c] = c % 2 ? 0.25 : -0.25;  // b is 1 or -1 but for the ends
  set_right_hand_side(big, x);
  std::vector<float> got(x.begin(), x.end());
  EXPECT_EQ(error(local_residual_check(1e-3, ""), big, got), 0);
  got[700] += 1e-3f;  // residual 2e-3 there, 1e-3 on either side
  EXPECT_NEAR(error(local_residual_check(1e-3, ""), big, got), 2e-3, 1e-5);
  EXPECT_FALSE(passed(local_residual_check(1e-3, ""), big, got));
  EXPECT_TRUE(passed(residual_check(1e-3, ""), big, got))
      << "the global norm forgives one cell in a thousand";
  const Arrays out = outputs_of(big, got);
  EXPECT_EQ(residual_of(big, out[0]).worst_place, "x[0,0,700]");
}

TEST_F(PoissonChecks, ResidualOverBoundUsesTheBoundOfTheData) {
  const Check check = residual_over_bound_check(
      "r", "1e-3", [](const Problem& q) { return 1e3 * q.scalar("tol"); }, "");
  EXPECT_TRUE(passed(check, p, {0.5f + 0.25e-3f, -0.5f - 0.25e-3f}));
  EXPECT_FALSE(passed(check, p, {0.5f + 1e-3f, -0.5f - 1e-3f}));
}

TEST_F(PoissonChecks, MeanPassesAtHalfAndFailsAtTwiceTheTolerance) {
  const Check check = mean_check(1e-2, "");
  EXPECT_TRUE(passed(check, p, {1 + 0.5e-2f, -1 + 0.5e-2f}));
  EXPECT_FALSE(passed(check, p, {1 + 2e-2f, -1 + 2e-2f}));
  EXPECT_FALSE(passed(check, p, {1 - 2e-2f, -1 - 2e-2f}));
}

TEST_F(PoissonChecks, MeanOfAZeroSolutionIsZero) {
  EXPECT_EQ(error(mean_check(1e-4, ""), p, {0, 0}), 0);
}

TEST_F(PoissonChecks, MeanCountsActiveCellsOnly) {
  Problem q = make_system(1, 1, 4, 1e-6);
  assemble(
      q, Boundary::neumann, [](std::int64_t, std::int64_t, std::int64_t k) { return k < 2; },
      [](auto...) { return 1.0; });
  EXPECT_EQ(error(mean_check(1e-4, ""), q, {1, -1, 5, 5}), 0);
}

TEST_F(PoissonChecks, ZeroOutsideCountsInactiveCellsOnly) {
  Problem q = make_system(1, 1, 4, 1e-6);
  assemble(
      q, Boundary::neumann, [](std::int64_t, std::int64_t, std::int64_t k) { return k < 2; },
      [](auto...) { return 1.0; });
  const Check check = zero_outside_check();
  EXPECT_EQ(error(check, q, {1, -1, 0, 0}), 0);
  EXPECT_EQ(error(check, q, {1, -1, -0.0f, 0}), 0);
  EXPECT_EQ(error(check, q, {1, -1, 0, std::numeric_limits<float>::denorm_min()}), 1);
  EXPECT_FALSE(passed(check, q, {1, -1, 0, std::numeric_limits<float>::denorm_min()}));
}

TEST_F(PoissonChecks, ZeroSolutionCountsEveryValue) {
  EXPECT_EQ(error(zero_solution_check(""), p, {0, -0.0f}), 0);
  EXPECT_EQ(error(zero_solution_check(""), p, {0, 1e-30f}), 1);
}

TEST_F(PoissonChecks, NothingPassesNaNOrInfinity) {
  Problem q = make_system(1, 1, 4, 1e-6);
  assemble(
      q, Boundary::neumann, [](std::int64_t, std::int64_t, std::int64_t k) { return k < 2; },
      [](auto...) { return 1.0; });
  const std::vector<Check> checks{residual_check(1e9, ""),
                                  local_residual_check(1e9, ""),
                                  mean_check(1e9, ""),
                                  zero_outside_check(),
                                  finite_check(""),
                                  zero_solution_check(""),
                                  residual_over_bound_check(
                                      "r", "", [](const Problem&) { return 1e9; }, "")};
  for (const float bad :
       {kNaN, std::numeric_limits<float>::infinity(), -std::numeric_limits<float>::infinity()}) {
    for (std::size_t at = 0; at < 4; ++at) {  // on active and on inactive cells
      std::vector<float> x(4, 0);
      x[at] = bad;
      for (const Check& check : checks)
        EXPECT_FALSE(passed(check, q, x)) << check.name << ' ' << bad << " at " << at;
    }
  }
}

TEST_F(PoissonChecks, ABoundThatIsNotANumberFails) {
  EXPECT_FALSE(passed(residual_over_bound_check(
                          "r", "", [](const Problem&) { return std::nan(""); }, ""),
                      p, {0.5f, -0.5f}));
  EXPECT_FALSE(passed(residual_over_bound_check(
                          "r", "", [](const Problem&) { return 0.0; }, ""),
                      p, {0.5f, -0.5f}));
}

TEST_F(PoissonChecks, AnAnswerOfAnotherShapeIsAnError) {
  Arrays out;
  out.emplace_back("x", DType::f32, Shape{2, 1, 2});
  EXPECT_THROW(residual_check(1, "").measure({p, out, nullptr}), Error);
  EXPECT_THROW(zero_outside_check().measure({p, out, nullptr}), Error);
  Arrays none;
  EXPECT_THROW(residual_check(1, "").measure({p, none, nullptr}), Error);
}

TEST_F(PoissonChecks, AcceptFP64Answers) {
  const std::vector<double> x{0.5, -0.5};
  const Arrays out = as_solution(describe<Inputs, Outputs<float>>(), p, x);
  EXPECT_EQ(residual_check(1e-6, "").measure({p, out, nullptr}).error, 0);
}

}  // namespace
}  // namespace poisson
}  // namespace gpuphys
