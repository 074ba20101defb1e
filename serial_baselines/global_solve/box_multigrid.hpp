// A solver for symmetric seven-point systems on a box, for the serial baselines of the fluid steps: conjugate
// gradients with one V-cycle of a geometric multigrid as preconditioner, inside iterative refinement.
//
//   (A x)_c = excess_c x_c + sum over the faces of c of g_f (x_c - x_neighbour),   g_f >= 0, excess_c >= 0
//
// A cell without any of these has no equation and x = 0. Where an excess is zero on a whole component, x is
// defined up to a constant there and b has to sum to zero on it.
//
// FP64 ignores the tolerance and refines to 1e-13 or stagnation (truth); FP32 stops at 0.8 of the
// tolerance or at stagnation.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <vector>

namespace gpuphys::serial {

template <class Real>
class BoxSystem {
 public:
  using Values = std::vector<Real>;

  /// No couplings, no excess, no cells if an extent is 0.
  explicit BoxSystem(const std::array<std::int64_t, 3>& extents) : n(extents) {
    const auto cells = static_cast<std::size_t>(n[0] * n[1] * n[2]);
    for (Values& v : g) v.assign(cells, Real(0));
    excess.assign(cells, Real(0));
  }

  std::array<std::int64_t, 3> n;
  std::array<Values, 3> g;  ///< between a cell and its successor along each axis; 0 at the end
  Values excess;

  std::size_t size() const { return excess.size(); }
  std::size_t flat(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return static_cast<std::size_t>((i * n[1] + j) * n[2] + k);
  }

  /// visit(cell, lower, upper) in order (or against it): faces of a cell that exist, as offsets of
  /// neighbours; 0 where there is none.
  template <class Visit>
  void each(bool forwards, Visit&& visit) const {
    const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
    const auto row = [&](std::int64_t a) { return forwards ? a : n[0] * n[1] - 1 - a; };
    for (std::int64_t a = 0; a < n[0] * n[1]; ++a) {
      const std::int64_t i = row(a) / n[1], j = row(a) % n[1];
      std::int64_t lower[3] = {i > 0 ? step[0] : 0, j > 0 ? step[1] : 0, 0};
      std::int64_t upper[3] = {i + 1 < n[0] ? step[0] : 0, j + 1 < n[1] ? step[1] : 0, 0};
      for (std::int64_t b = 0; b < n[2]; ++b) {
        const std::int64_t k = forwards ? b : n[2] - 1 - b;
        lower[2] = k > 0 ? 1 : 0;
        upper[2] = k + 1 < n[2] ? 1 : 0;
        visit(row(a) * n[2] + k, lower, upper);
      }
    }
  }

  /// What multiplies x_c in its own equation.
  Values diagonal() const {
    Values d(size());
    each(true, [&](std::int64_t c, const std::int64_t* lower, const std::int64_t*) {
      Real sum = excess[static_cast<std::size_t>(c)];
      for (std::size_t a = 0; a < 3; ++a) {
        sum += g[a][static_cast<std::size_t>(c)];
        if (lower[a]) sum += g[a][static_cast<std::size_t>(c - lower[a])];
      }
      d[static_cast<std::size_t>(c)] = sum;
    });
    return d;
  }

  /// A x, from differences of neighbours.
  void multiply(const Values& x, Values& product) const {
    each(true, [&](std::int64_t cell, const std::int64_t* lower, const std::int64_t* upper) {
      const auto c = static_cast<std::size_t>(cell);
      Real sum = excess[c] * x[c];
      for (std::size_t a = 0; a < 3; ++a) {
        if (upper[a]) sum += g[a][c] * (x[c] - x[static_cast<std::size_t>(cell + upper[a])]);
        if (lower[a]) {
          const auto o = static_cast<std::size_t>(cell - lower[a]);
          sum += g[a][o] * (x[c] - x[o]);
        }
      }
      product[c] = sum;
    });
  }

  /// The system of 2 x 2 x 2 blocks: couplings summed and halved, because centres are twice as far apart.
  BoxSystem coarser() const {
    BoxSystem coarse({(n[0] + 1) / 2, (n[1] + 1) / 2, (n[2] + 1) / 2});
    each(true, [&](std::int64_t cell, const std::int64_t*, const std::int64_t*) {
      const auto c = static_cast<std::size_t>(cell);
      const std::int64_t at[3] = {cell / (n[1] * n[2]), cell / n[2] % n[1], cell % n[2]};
      const std::size_t parent = coarse.flat(at[0] / 2, at[1] / 2, at[2] / 2);
      coarse.excess[parent] += excess[c];
      for (std::size_t a = 0; a < 3; ++a) {
        if (at[a] % 2 == 1) coarse.g[a][parent] += g[a][c] / 2;
      }
    });
    return coarse;
  }
};

template <class Real>
class BoxMultigrid {
 public:
  using System = BoxSystem<Real>;
  using Values = typename System::Values;

  explicit BoxMultigrid(System finest) {
    levels_.push_back(level(std::move(finest)));
    while (levels_.back().system.size() > 1) levels_.push_back(level(levels_.back().system.coarser()));
  }

  const System& system() const { return levels_[0].system; }

  /// x for A x = b; `tolerance` bounds ||b - A x|| / ||b|| in FP32.
  Values solve(const Values& right, Real tolerance) {
    constexpr bool kTruth = std::is_same_v<Real, double>;
    const std::size_t size = right.size();
    Values x(size, Real(0)), b(right);
    Real largest = 0;
    for (const Real v : b) largest = std::max(largest, std::abs(v));
    if (largest == 0) return x;
    // Squares of b need not fit into Real; a power of two scales without rounding.
    int exponent = 0;
    std::frexp(largest, &exponent);
    const Real scale = std::ldexp(Real(1), exponent);
    for (Real& v : b) v /= scale;

    const Real goal = (kTruth ? Real(1e-13) : Real(0.8) * tolerance) * norm(b);
    const Real reduction = kTruth ? Real(1e-14) : Real(1e-3);
    Values r(b), d(size), next(size);
    Real now = norm(r);
    for (int cycle = 0; cycle < 20 && now > goal; ++cycle) {
      conjugate_gradients(r, std::max(reduction * now, goal / 2), d);
      for (std::size_t c = 0; c < size; ++c) next[c] = x[c] + d[c];
      system().multiply(next, r);
      for (std::size_t c = 0; c < size; ++c) r[c] = b[c] - r[c];
      const Real before = now;
      now = norm(r);
      if (!(now < before)) break;  // only rounding is left
      x.swap(next);
      if (now > before / 2) break;
    }
    for (Real& v : x) v *= scale;
    return x;
  }

 private:
  struct Level {
    System system;
    Values inverse;  // of the diagonal, 0 where there is no equation
    Values x, b;
  };
  static Level level(System s) {
    Values inverse = s.diagonal();
    for (Real& v : inverse) v = v > 0 ? 1 / v : Real(0);
    const std::size_t size = s.size();
    return {std::move(s), std::move(inverse), Values(size), Values(size)};
  }

  // Sums in blocks, so that FP32 keeps its digits.
  static Real dot(const Values& a, const Values& b) {
    double total = 0;
    for (std::size_t first = 0; first < a.size(); first += 1024) {
      Real sum = 0;
      for (std::size_t c = first; c < std::min(first + 1024, a.size()); ++c) sum += a[c] * b[c];
      total += static_cast<double>(sum);
    }
    return static_cast<Real>(total);
  }
  static Real norm(const Values& a) { return std::sqrt(dot(a, a)); }

  // x = (b + what its neighbours give) / diagonal, cell after cell.
  static void relax_forwards_from_zero(Level& l) {
    l.system.each(true, [&](std::int64_t cell, const std::int64_t* lower, const std::int64_t*) {
      const auto c = static_cast<std::size_t>(cell);
      Real sum = l.b[c];
      for (std::size_t a = 0; a < 3; ++a) {
        const auto o = static_cast<std::size_t>(cell - lower[a]);
        if (lower[a]) sum += l.system.g[a][o] * l.x[o];
      }
      l.x[c] = sum * l.inverse[c];
    });
  }
  static void relax_backwards(Level& l) {
    l.system.each(false, [&](std::int64_t cell, const std::int64_t* lower, const std::int64_t* upper) {
      const auto c = static_cast<std::size_t>(cell);
      Real sum = l.b[c];
      for (std::size_t a = 0; a < 3; ++a) {
        if (lower[a])
          sum += l.system.g[a][c - static_cast<std::size_t>(lower[a])] *
                 l.x[c - static_cast<std::size_t>(lower[a])];
        if (upper[a]) sum += l.system.g[a][c] * l.x[c + static_cast<std::size_t>(upper[a])];
      }
      l.x[c] = sum * l.inverse[c];
    });
  }

  // One V-cycle from zero; levels_[l].b is given, levels_[l].x comes out. Backwards on the way up, so that
  // the cycle is symmetric.
  void cycle(std::size_t l) {
    Level& fine = levels_[l];
    relax_forwards_from_zero(fine);
    if (l + 1 == levels_.size()) return;
    Level& coarse = levels_[l + 1];
    std::fill(coarse.b.begin(), coarse.b.end(), Real(0));
    const auto& n = fine.system.n;
    const auto parent = [&](std::int64_t cell) {
      return coarse.system.flat(cell / (n[1] * n[2]) / 2, cell / n[2] % n[1] / 2, cell % n[2] / 2);
    };
    // After a relaxation forwards from zero only the upper neighbours are left in the residual.
    fine.system.each(true, [&](std::int64_t cell, const std::int64_t*, const std::int64_t* upper) {
      const auto c = static_cast<std::size_t>(cell);
      if (fine.inverse[c] == 0) return;
      Real residual = 0;
      for (std::size_t a = 0; a < 3; ++a) {
        if (upper[a]) residual += fine.system.g[a][c] * fine.x[c + static_cast<std::size_t>(upper[a])];
      }
      coarse.b[parent(cell)] += residual;
    });
    cycle(l + 1);
    fine.system.each(true, [&](std::int64_t cell, const std::int64_t*, const std::int64_t*) {
      fine.x[static_cast<std::size_t>(cell)] += coarse.x[parent(cell)];
    });
    relax_backwards(fine);
  }

  // A d = r from d = 0 until the recurrence's residual is below `target`; r is overwritten.
  void conjugate_gradients(Values& r, Real target, Values& d) {
    std::fill(d.begin(), d.end(), Real(0));
    Values p(r.size(), Real(0)), ap(r.size());
    Real rz_before = 1, smallest = norm(r);
    int since_smallest = 0;
    for (int iteration = 0; iteration < 1000; ++iteration) {
      levels_[0].b.swap(r);
      cycle(0);
      levels_[0].b.swap(r);
      const Values& z = levels_[0].x;
      const Real rz = dot(r, z), beta = iteration == 0 ? Real(0) : rz / rz_before;
      rz_before = rz;
      for (std::size_t c = 0; c < p.size(); ++c) p[c] = z[c] + beta * p[c];
      system().multiply(p, ap);
      const Real curvature = dot(p, ap);
      if (!(rz > 0) || !(curvature > 0)) return;  // only rounding is left
      const Real alpha = rz / curvature;
      for (std::size_t c = 0; c < p.size(); ++c) {
        d[c] += alpha * p[c];
        r[c] -= alpha * ap[c];
      }
      const Real size = norm(r);
      if (size <= target) return;
      since_smallest = size < smallest ? 0 : since_smallest + 1;
      smallest = std::min(smallest, size);
      if (since_smallest > 20) return;
    }
  }

  std::vector<Level> levels_;
};

}  // namespace gpuphys::serial
