// What the serial baselines of the Poisson tasks share: the rows of the active cells and the solver.
//
// Iterative refinement: x starts at zero; each cycle evaluates the true residual r = b - A x, solves A d = r
// approximately and adds d. What solves for d:
//   Real = double, up to kDirectLimit unknowns: sparse Cholesky (CHOLMOD), with one unknown grounded if
//   constants are in the null space;
//   otherwise: conjugate gradients, preconditioned by symmetric over-relaxation (SSOR).
// FP64 ignores `tol` and refines until the residual stagnates (truth); FP32 stops at a fraction of `tol`.
#pragma once

#include <cholmod.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "cases/global_solve/poisson.hpp"

// Present when CHOLMOD was built with OpenMP, or over OpenBLAS.
extern "C" {
void omp_set_max_active_levels(int) __attribute__((weak));
int omp_get_max_active_levels(void) __attribute__((weak));
void openblas_set_num_threads(int) __attribute__((weak));
}

namespace gpuphys::seven_point_baseline {

/// Largest number of unknowns that is factorised; beyond it fill-in makes CG the cheaper way.
constexpr std::int64_t kDirectLimit = 65536;

/// Sum in a balanced tree over blocks of 32: each term is rounded log2(n/32) + 32 times at most.
template <class Real, class Term>
Real pairwise_sum(std::int64_t begin, std::int64_t end, Term&& term) {
  if (end - begin <= 32) {
    Real sum = 0;
    for (std::int64_t i = begin; i < end; ++i) sum += term(i);
    return sum;
  }
  const std::int64_t middle = begin + (end - begin) / 2;
  return pairwise_sum<Real>(begin, middle, term) + pairwise_sum<Real>(middle, end, term);
}

template <class Real>
using Vector = std::vector<Real>;

template <class Real>
std::int64_t length(const Vector<Real>& v) {
  return static_cast<std::int64_t>(v.size());
}

template <class Real>
Real dot(const Vector<Real>& a, const Vector<Real>& b) {
  return pairwise_sum<Real>(0, length(a), [&](std::int64_t i) { return a[i] * b[i]; });
}

template <class Real>
Real norm(const Vector<Real>& a) {
  return std::sqrt(dot(a, a));
}

template <class Real>
Real mean_of(const Vector<Real>& a) {
  return pairwise_sum<Real>(0, length(a), [&](std::int64_t i) { return a[i]; }) /
         static_cast<Real>(length(a));
}

template <class Real>
void remove_mean(Vector<Real>& a) {
  const Real mean = mean_of(a);
  for (Real& v : a) v -= mean;
}

/// What A maps to zero: nothing, or the constants (and then only the mean of b is out of reach).
enum class NullSpace { nothing, constants };

/// The equations of the active cells, numbered in array order. Couplings 0, 1, 2 go to the lower neighbours
/// along x, y, z, which have smaller numbers, 3, 4, 5 to the upper ones; `neighbour` is -1 where there is
/// none.
template <class Real>
struct Rows {
  Vector<std::int64_t> cell;  // flat index in the input arrays
  Vector<Real> diagonal;
  std::array<Vector<std::int32_t>, 6> neighbour;
  std::array<Vector<Real>, 6> coupling;
  NullSpace null_space;

  Rows(const poisson::Inputs& in, NullSpace null) : null_space(null) {
    const std::int64_t nx = in.b.shape[0], ny = in.b.shape[1], nz = in.b.shape[2];
    const std::int64_t step_x = ny * nz, step_y = nz, step_z = 1;
    Vector<std::int32_t> number(static_cast<std::size_t>(nx * ny * nz), -1);
    for (std::int64_t c = 0; c < nx * ny * nz; ++c) {
      if (!in.is_dof.data[c]) continue;
      number[c] = static_cast<std::int32_t>(cell.size());
      cell.push_back(c);
      diagonal.push_back(static_cast<Real>(in.a_diag.data[c]));
    }
    for (int f = 0; f < 6; ++f) {
      neighbour[f].assign(cell.size(), -1);
      coupling[f].assign(cell.size(), Real(0));
    }
    for (std::int64_t i = 0; i < length(cell); ++i) {
      const std::int64_t c = cell[i];
      const std::int64_t cx = c / step_x, cy = c / step_y % ny, cz = c % nz;
      const auto couple = [&](int f, std::int64_t other, float a) {
        if (a == 0) return;
        neighbour[f][i] = number[other];
        coupling[f][i] = static_cast<Real>(a);
      };
      if (cx > 0) couple(0, c - step_x, in.a_x.data[c - step_x]);
      if (cy > 0) couple(1, c - step_y, in.a_y.data[c - step_y]);
      if (cz > 0) couple(2, c - step_z, in.a_z.data[c - step_z]);
      if (cx + 1 < nx) couple(3, c + step_x, in.a_x.data[c]);
      if (cy + 1 < ny) couple(4, c + step_y, in.a_y.data[c]);
      if (cz + 1 < nz) couple(5, c + step_z, in.a_z.data[c]);
    }
  }

  std::int64_t size() const { return length(cell); }

  /// Sum of the couplings `first` to `last` of row i times v.
  Real off_diagonal(std::int64_t i, int first, int last, const Vector<Real>& v) const {
    Real sum = 0;
    for (int f = first; f <= last; ++f) {
      if (neighbour[f][i] >= 0) sum += coupling[f][i] * v[neighbour[f][i]];
    }
    return sum;
  }

  /// A v
  void multiply(const Vector<Real>& v, Vector<Real>& result) const {
    for (std::int64_t i = 0; i < size(); ++i) {
      result[i] = diagonal[i] * v[i] + off_diagonal(i, 0, 5, v);
    }
  }

  /// Takes the part out of v that lies in the null space.
  void project(Vector<Real>& v) const {
    if (null_space == NullSpace::constants) remove_mean(v);
  }

  /// b - A v without the part that no v can change
  void residual(const Vector<Real>& b, const Vector<Real>& v, Vector<Real>& r) const {
    multiply(v, r);
    for (std::int64_t i = 0; i < size(); ++i) r[i] = b[i] - r[i];
    project(r);
  }

  /// z = M^-1 r with M = (D/w + L) D^-1 (D/w + U), L and U the triangles of A: a sweep of successive
  /// over-relaxation forwards, one backwards. (The factor that makes M resemble A is left out: conjugate
  /// gradients do not see it.)
  void precondition(const Vector<Real>& r, Vector<Real>& z) const {
    constexpr Real w = Real(1.7);
    for (std::int64_t i = 0; i < size(); ++i) {
      z[i] = w * (r[i] - off_diagonal(i, 0, 2, z)) / diagonal[i];
    }
    for (std::int64_t i = size() - 1; i >= 0; --i) {
      z[i] = w * (z[i] - off_diagonal(i, 3, 5, z) / diagonal[i]);
    }
  }
};

/// Conjugate gradients for A d = r from d = 0 until the recurrence's residual is below `target`. `r` is
/// overwritten.
template <class Real>
void conjugate_gradients(const Rows<Real>& a, Vector<Real>& r, Real target, Vector<Real>& d) {
  const std::size_t n = r.size();
  constexpr int kMaxIterations = 20000, kPatience = 200;
  Vector<Real> z(n), p(n, Real(0)), ap(n);
  std::fill(d.begin(), d.end(), Real(0));
  Real rz_before = 1, smallest = norm(r);
  int smallest_at = 0;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    a.precondition(r, z);
    const Real rz = dot(r, z);
    const Real beta = iteration == 0 ? Real(0) : rz / rz_before;
    rz_before = rz;
    for (std::size_t i = 0; i < n; ++i) p[i] = z[i] + beta * p[i];
    a.multiply(p, ap);
    const Real curvature = dot(p, ap);
    if (!(rz > 0) || !(curvature > 0)) return;  // only rounding is left
    const Real alpha = rz / curvature;
    for (std::size_t i = 0; i < n; ++i) {
      d[i] += alpha * p[i];
      r[i] -= alpha * ap[i];
    }
    a.project(r);  // rounding would let r grow in the null space
    const Real size = norm(r);
    if (size <= target) return;
    if (size < smallest) {
      smallest = size;
      smallest_at = iteration;
    } else if (iteration - smallest_at > kPatience) {
      return;
    }
  }
}

/// Sparse Cholesky factor of A, without its last row and column if constants are in the null space, which
/// makes a connected system definite. A template only so that FP32 builds need not link CHOLMOD.
template <class Real>
class Cholesky {
 public:
  explicit Cholesky(const Rows<Real>& a) : grounded_(a.null_space == NullSpace::constants ? 1 : 0) {
    if (omp_set_max_active_levels) {
      levels_before_ = omp_get_max_active_levels();
      omp_set_max_active_levels(0);
    }
    if (openblas_set_num_threads) openblas_set_num_threads(1);
    cholmod_start(&common_);
    common_.print = 0;
    common_.supernodal = CHOLMOD_SUPERNODAL;
    const std::size_t n = static_cast<std::size_t>(a.size()) - grounded_;
    // Column j of the lower triangle holds the diagonal and the couplings to the upper neighbours, nearest
    // first.
    cholmod_sparse* lower = cholmod_allocate_sparse(n, n, 4 * n, 1, 1, -1, CHOLMOD_REAL, &common_);
    if (!lower) fail("out of memory");
    int* start = static_cast<int*>(lower->p);
    int* row = static_cast<int*>(lower->i);
    double* value = static_cast<double*>(lower->x);
    int entries = 0;
    for (std::size_t j = 0; j < n; ++j) {
      start[j] = entries;
      row[entries] = static_cast<int>(j);
      double diagonal = a.diagonal[j];
      if (a.null_space == NullSpace::constants) {  // the rounding of a_diag may make it indefinite
        diagonal = 0;
        for (int f = 0; f < 6; ++f) diagonal -= a.coupling[f][j];
      }
      value[entries++] = diagonal;
      for (const int f : {5, 4, 3}) {
        const std::int32_t other = a.neighbour[f][j];
        if (other < 0 || other == static_cast<std::int32_t>(n)) continue;
        row[entries] = other;
        value[entries++] = a.coupling[f][j];
      }
    }
    start[n] = entries;
    factor_ = cholmod_analyze(lower, &common_);
    if (factor_) cholmod_factorize(lower, factor_, &common_);
    cholmod_free_sparse(&lower, &common_);
    if (!factor_ || common_.status != CHOLMOD_OK) fail("the matrix cannot be factorised");
  }
  ~Cholesky() { finish(); }
  Cholesky(const Cholesky&) = delete;
  Cholesky& operator=(const Cholesky&) = delete;

  /// d = A^-1 r with the grounded unknown, if there is one, at 0.
  void solve(const Vector<Real>& r, Vector<Real>& d) {
    const std::size_t n = r.size() - grounded_;
    cholmod_dense* right = cholmod_allocate_dense(n, 1, n, CHOLMOD_REAL, &common_);
    if (!right) fail("out of memory");
    std::copy_n(r.begin(), n, static_cast<double*>(right->x));
    cholmod_dense* solution = cholmod_solve(CHOLMOD_A, factor_, right, &common_);
    cholmod_free_dense(&right, &common_);
    if (!solution) fail("out of memory");
    const double* x = static_cast<const double*>(solution->x);
    d.back() = 0;
    std::copy_n(x, n, d.begin());
    cholmod_free_dense(&solution, &common_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) {
    finish();
    throw std::runtime_error("CHOLMOD: " + what);
  }
  void finish() {
    if (factor_) cholmod_free_factor(&factor_, &common_);
    cholmod_finish(&common_);
    if (omp_set_max_active_levels) omp_set_max_active_levels(levels_before_);
  }

  std::size_t grounded_;  // unknowns left out
  cholmod_common common_{};
  cholmod_factor* factor_ = nullptr;
  int levels_before_ = 1;
};

/// A power of two near v, so that scaling by it is exact.
template <class Real>
Real power_of_two_near(Real v) {
  int exponent = 0;
  std::frexp(v, &exponent);
  return std::ldexp(Real(1), exponent);
}

/// Solves A x = b on the active cells. With constants in the null space, FP32 answers may have any mean.
template <class Real>
Vector<Real> solve(const Rows<Real>& a, const Vector<Real>& b, Real tol,
                   std::int64_t direct_limit = kDirectLimit) {
  constexpr bool kTruth = std::is_same_v<Real, double>;
  const std::size_t n = b.size();
  // FP32 aims at a quarter of the tolerance: evaluating r and the final shift each cost a few 1e-8 of ||b||.
  const Real goal = kTruth ? Real(0) : Real(0.25) * tol * norm(b);
  // One cycle gains about half the digits of Real, so that its recurrence cannot drift far from the truth.
  const Real reduction = std::sqrt(std::numeric_limits<Real>::epsilon());
  constexpr int kMaxCycles = 100;

  Vector<Real> x(n, Real(0)), x_next(n), d(n), r(b);
  a.project(r);
  Real size = norm(r);
  const auto improve = [&](auto&& solve_for_d) {
    for (int cycle = 0; cycle < kMaxCycles && size > goal; ++cycle) {
      solve_for_d();
      // A constant is not quite in the null space of a matrix with float32 diagonals: truth keeps to zero
      // mean throughout.
      if (kTruth) a.project(d);
      for (std::size_t i = 0; i < n; ++i) x_next[i] = x[i] + d[i];
      a.residual(b, x_next, r);
      const Real size_before = size;
      size = norm(r);
      if (!(size < size_before)) break;  // rounding has taken over: the earlier x is the better one
      x.swap(x_next);
      if (size <= goal || size > Real(0.5) * size_before) break;
    }
  };
  if constexpr (kTruth) {
    if (static_cast<std::int64_t>(n) <= direct_limit) {
      Cholesky<Real> factor(a);
      improve([&] { factor.solve(r, d); });
      return x;
    }
  }
  improve([&] { conjugate_gradients(a, r, std::max(reduction * size, Real(0.5) * goal), d); });
  return x;
}

/// The whole task but for the choice of a representative: x on the active cells from the scaled b, 0
/// elsewhere.
template <class Real>
void solve_on_active_cells(const poisson::Inputs& in, const poisson::Outputs<Real>& out,
                           NullSpace null_space) {
  const Rows<Real> a(in, null_space);
  for (std::int64_t c = 0; c < out.x.size(); ++c) out.x.data[c] = 0;

  // b is scaled to size 1: its squares need not fit into Real.
  Real largest = 0;
  for (std::int64_t i = 0; i < a.size(); ++i) {
    largest = std::max(largest, static_cast<Real>(std::abs(in.b.data[a.cell[i]])));
  }
  // The only answer is 0 where b is, and where a single cell's equation is empty but for rounding.
  if (largest == 0 || (null_space == NullSpace::constants && a.size() < 2)) return;
  const Real scale = power_of_two_near(largest);
  Vector<Real> b(static_cast<std::size_t>(a.size()));
  for (std::int64_t i = 0; i < a.size(); ++i) b[i] = static_cast<Real>(in.b.data[a.cell[i]]) / scale;

  const Vector<Real> x = solve(a, b, static_cast<Real>(in.tol));
  for (std::int64_t i = 0; i < a.size(); ++i) out.x.data[a.cell[i]] = x[i] * scale;
}

}  // namespace gpuphys::seven_point_baseline
