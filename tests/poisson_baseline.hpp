// What the tests of the Poisson tasks' serial baselines share. Include it after the baseline's source.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "cases/global_solve/poisson_system.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "serial_baselines/global_solve/seven_point_system.hpp"

namespace gpuphys::poisson_testing {

using poisson::Boundary, poisson::Inputs, poisson::Outputs;
using seven_point_baseline::dot, seven_point_baseline::norm;
using seven_point_baseline::NullSpace, seven_point_baseline::Rows, seven_point_baseline::Vector;

/// A box that is active throughout, with the conductance of every face given.
inline Problem box(std::int64_t nx, std::int64_t ny, std::int64_t nz, Boundary boundary,
                   const poisson::FaceConductance& conductance) {
  Problem p = poisson::make_system(nx, ny, nz, 1e-6);
  poisson::assemble(
      p, boundary, [](auto...) { return true; }, conductance);
  return p;
}

inline void set_b(Problem& p, const std::vector<float>& values) {
  for (HostArray& a : p.inputs) {
    if (a.name() == "b") std::copy(values.begin(), values.end(), a.as<float>().begin());
  }
}

/// x as the baseline returns it.
template <template <class> class Baseline, class Real>
Arrays outputs_of(const Problem& p) {
  Arrays outputs = make_outputs(describe<Inputs, Outputs<float>>(), p, dtype_of<Real>());
  Baseline<Real> baseline;
  const Inputs in = bind_inputs<Inputs>(p);
  const auto out = bind_outputs<Outputs<Real>>(outputs);
  baseline.allocate(in, out);
  baseline.compute(in, out);
  return outputs;
}
template <template <class> class Baseline, class Real>
std::vector<double> solved(const Problem& p) {
  const Arrays outputs = outputs_of<Baseline, Real>(p);
  std::vector<double> x;
  for (std::int64_t c = 0; c < outputs[0].size(); ++c) x.push_back(outputs[0].value(c));
  return x;
}

inline std::vector<double> random_vector(std::size_t n, std::uint64_t seed) {
  std::vector<double> v(n);
  for (std::size_t i = 0; i < n; ++i) v[i] = uniform11(seed, 50, i);
  return v;
}

inline double relative_difference(const std::vector<double>& a, const std::vector<double>& b) {
  std::vector<double> d(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) d[i] = a[i] - b[i];
  return norm(d) / norm(b);
}

/// All sets that are cheap enough to solve here.
inline std::vector<InputSet> small_sets(const Task& task) {
  std::vector<InputSet> sets;
  for (const InputSet& s : task.sets) {
    if (s.size == Size::smoke) sets.push_back(s);
  }
  return sets;
}

/// A few roundings of values of size 1.
template <class Real>
constexpr double kExact = 8 * static_cast<double>(std::numeric_limits<Real>::epsilon());

// The tests themselves, for a baseline and the null space of its task.

/// Powers of two, so that nothing else may change.
template <template <class> class Baseline, class Real>
void expect_solution_to_scale(Problem& p) {
  const std::vector<double> x = solved<Baseline, Real>(p);
  const Inputs in = bind_inputs<Inputs>(p);
  const std::vector<float> original(in.b.data, in.b.data + in.b.size());
  for (const int exponent : {-66, 66}) {
    std::vector<float> b = original;
    for (float& v : b) v = std::ldexp(v, exponent);
    set_b(p, b);
    const std::vector<double> y = solved<Baseline, Real>(p);
    for (std::size_t c = 0; c < x.size(); ++c) EXPECT_EQ(y[c], std::ldexp(x[c], exponent));
  }
}

template <template <class> class Baseline>
void expect_an_end_when_the_tolerance_is_out_of_reach(Boundary boundary) {
  Problem p = box(12, 11, 10, boundary, [](auto...) { return 1.0; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 4, 1, 0.5));
  p.set_scalar("tol", 1e-20);
  EXPECT_LT((poisson::residual_of(p, outputs_of<Baseline, float>(p)[0]).relative_l2), 5e-7);
}

template <template <class> class Baseline>
void expect_an_earlier_stop_for_a_looser_tolerance(Boundary boundary) {
  Problem p = box(20, 19, 18, boundary, [](auto...) { return 1.0; });
  poisson::set_right_hand_side(p, poisson::ramp_and_noise(p, 4, 1, 0.5));
  double before = 0;
  for (const double tol : {1e-6, 1e-5, 1e-4, 1e-3, 1e-2}) {
    p.set_scalar("tol", tol);
    const double residual = poisson::residual_of(p, outputs_of<Baseline, float>(p)[0]).relative_l2;
    EXPECT_LT(residual, tol);
    EXPECT_GT(residual, before);
    before = residual;
  }
}

/// Two solvers that share only the matrix rows.
inline void expect_cholmod_to_agree_with_conjugate_gradients(const Task& task, NullSpace null_space) {
  int compared = 0;
  for (const InputSet& set : small_sets(task)) {
    const Problem p = set.make();
    const Inputs in = bind_inputs<Inputs>(p);
    const Rows<double> a(in, null_space);
    if (a.size() < 2 || a.size() > 20000) continue;
    Vector<double> b(static_cast<std::size_t>(a.size())), r(b.size());
    for (std::int64_t i = 0; i < a.size(); ++i) b[i] = in.b.data[a.cell[i]];
    if (norm(b) == 0) continue;
    ++compared;
    const Vector<double> direct = solve(a, b, 0.0);
    const Vector<double> iterative = solve(a, b, 0.0, /*direct_limit=*/0);
    a.project(b);
    for (const Vector<double>* x : {&direct, &iterative}) {
      a.residual(b, *x, r);
      EXPECT_LT(norm(r), 1e-11 * norm(b)) << set.name;
    }
    EXPECT_LT(relative_difference(iterative, direct), 1e-8) << set.name;
  }
  EXPECT_GE(compared, 6);
}

/// -h^2 times the Laplacian of product(x, y, z) = wave(x) wave(2 y) wave(z) on the unit cube, against the
/// product: the order of convergence. `wave` is a sine or cosine of pi times its argument.
template <template <class> class Baseline>
void expect_second_order(Boundary boundary, const poisson::FaceConductance& conductance_of_unit_cells,
                         const std::function<double(double)>& wave) {
  const auto error = [&](std::int64_t n) {
    Problem p = box(n, n, n, boundary, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
      const std::int64_t at = axis == 0 ? i : axis == 1 ? j : k;
      return at < 0 || at + 1 == n ? conductance_of_unit_cells(axis, i, j, k) : 1.0;
    });
    const double h = 1.0 / static_cast<double>(n), pi = std::numbers::pi;
    std::vector<double> exact;
    std::vector<float> b;
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::int64_t j = 0; j < n; ++j) {
        for (std::int64_t k = 0; k < n; ++k) {
          const auto at = [&](std::int64_t q) { return (static_cast<double>(q) + 0.5) * h; };
          const double u = wave(at(i)) * wave(2 * at(j)) * wave(at(k));
          exact.push_back(u);
          b.push_back(static_cast<float>(h * h * 6 * pi * pi * u));
        }
      }
    }
    set_b(p, b);
    return relative_difference(solved<Baseline, double>(p), exact);
  };
  const double coarse = error(6), middle = error(12), fine = error(24);
  EXPECT_NEAR(std::log2(coarse / middle), 2, 0.15);
  EXPECT_NEAR(std::log2(middle / fine), 2, 0.05);
}

/// How far x is from `exact` in the energy norm, relative.
inline double energy_error(const Problem& p, std::vector<double> x, const std::vector<double>& exact) {
  const Inputs in = bind_inputs<Inputs>(p);
  for (std::size_t c = 0; c < x.size(); ++c) x[c] -= exact[c];
  return std::sqrt(dot(x, poisson::multiply(in, x)) / dot(exact, poisson::multiply(in, exact)));
}

inline void expect_a_symmetric_operator(const Task& task, NullSpace null_space) {
  for (const InputSet& set : small_sets(task)) {
    const Problem p = set.make();
    const Rows<double> a(bind_inputs<Inputs>(p), null_space);
    const std::size_t n = static_cast<std::size_t>(a.size());
    const std::vector<double> x = random_vector(n, 1), y = random_vector(n, 2);
    std::vector<double> ax(n), ay(n);
    a.multiply(x, ax);
    a.multiply(y, ay);
    EXPECT_NEAR(dot(y, ax), dot(x, ay), 1e-13 * (1 + norm(x) * norm(ay))) << set.name;
  }
}

/// The judging code has its own A x.
inline void expect_the_operator_that_judges(const Task& task, NullSpace null_space) {
  for (const InputSet& set : small_sets(task)) {
    const Problem p = set.make();
    const Inputs in = bind_inputs<Inputs>(p);
    const Rows<double> a(in, null_space);
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

inline void expect_a_symmetric_positive_preconditioner(const Problem& p, NullSpace null_space) {
  const Rows<double> a(bind_inputs<Inputs>(p), null_space);
  const std::size_t n = static_cast<std::size_t>(a.size());
  const std::vector<double> x = random_vector(n, 5), y = random_vector(n, 6);
  std::vector<double> mx(n), my(n);
  a.precondition(x, mx);
  a.precondition(y, my);
  EXPECT_NEAR(dot(y, mx), dot(x, my), 1e-12 * norm(x) * norm(my));
  EXPECT_GT(dot(x, mx), 0);
  EXPECT_GT(dot(y, my), 0);
}

}  // namespace gpuphys::poisson_testing
