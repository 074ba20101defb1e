// What the serial baselines of projective dynamics share: the constant matrix of the global step, and its
// solve.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "core/base/parallel.hpp"

namespace gpuphys::serial {

template <class Real>
using Vectors = std::vector<std::array<Real, 3>>;

/// diag(mass) + a weighted graph Laplacian, the same for all three components.
template <class Real>
class GlobalMatrix {
 public:
  GlobalMatrix(const float* mass, std::int64_t n)
      : diagonal_(static_cast<std::size_t>(n)), first_(diagonal_.size() + 1) {
    for (std::size_t i = 0; i < diagonal_.size(); ++i) diagonal_[i] = static_cast<Real>(mass[i]);
  }

  /// weight (e_i - e_j)(e_i - e_j)^T; i != j. Edges may repeat.
  void add_edge(std::int32_t i, std::int32_t j, Real weight) { edges_.push_back({i, j, weight}); }

  /// Makes rows of the edges; to be called once, after the last one.
  void finish() {
    for (const Edge& e : edges_) {
      ++first_[static_cast<std::size_t>(e.i) + 1];
      ++first_[static_cast<std::size_t>(e.j) + 1];
    }
    for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
    std::vector<Entry> unmerged(2 * edges_.size());
    std::vector<std::int64_t> next(first_.begin(), first_.end() - 1);
    for (const Edge& e : edges_) {
      unmerged[static_cast<std::size_t>(next[static_cast<std::size_t>(e.i)]++)] = {e.j, e.weight};
      unmerged[static_cast<std::size_t>(next[static_cast<std::size_t>(e.j)]++)] = {e.i, e.weight};
      diagonal_[static_cast<std::size_t>(e.i)] += e.weight;
      diagonal_[static_cast<std::size_t>(e.j)] += e.weight;
    }
    edges_ = {};
    // Entries of a pair come together.
    std::int64_t begin = 0;
    for (std::size_t i = 0; i < diagonal_.size(); ++i) {
      const auto from = unmerged.begin() + begin, to = unmerged.begin() + first_[i + 1];
      begin = first_[i + 1];
      std::stable_sort(from, to, [](const Entry& a, const Entry& b) { return a.other < b.other; });
      for (auto e = from; e != to; ++e) {
        const bool again = e != from && e->other == entries_.back().other;
        if (again) {
          entries_.back().weight += e->weight;
        } else {
          entries_.push_back(*e);
        }
      }
      first_[i + 1] = static_cast<std::int64_t>(entries_.size());
    }
    reorder();
  }

  /// A x in the order of the rows, as all of the solve is.
  Vectors<Real> times(const Vectors<Real>& x) const {
    Vectors<Real> y(x.size());
    for_rows([&](std::size_t i) {
      for (std::size_t c = 0; c < 3; ++c) y[i][c] = diagonal_[i] * x[i][c];
      for (auto e = static_cast<std::size_t>(first_[i]); e < static_cast<std::size_t>(first_[i + 1]); ++e) {
        const auto& other = x[static_cast<std::size_t>(entries_[e].other)];
        for (std::size_t c = 0; c < 3; ++c) y[i][c] -= entries_[e].weight * other[c];
      }
    });
    return y;
  }

  /// Solves A x = b by conjugate gradients, preconditioned by the diagonal, until the residual is below
  /// `target` or below `relative` of b.
  Vectors<Real> solve(const Vectors<Real>& right_hand_side, Real target, Real relative) const {
    Vectors<Real> b(right_hand_side.size());
    for (std::size_t k = 0; k < b.size(); ++k) b[k] = right_hand_side[static_cast<std::size_t>(order_[k])];
    Vectors<Real> x(b.size(), {0, 0, 0}), r = b, z = scaled(r), p = z;
    Real rz = dot(r, z);
    const Real stop = std::max(target, relative * std::sqrt(dot(b, b)));
    for (int iteration = 0; iteration < 100000 && std::sqrt(dot(r, r)) > stop; ++iteration) {
      const Vectors<Real> q = times(p);
      const Real alpha = rz / dot(p, q);
      for_rows([&](std::size_t i) {
        for (std::size_t c = 0; c < 3; ++c) {
          x[i][c] += alpha * p[i][c];
          r[i][c] -= alpha * q[i][c];
          z[i][c] = r[i][c] / diagonal_[i];
        }
      });
      const Real earlier = rz;
      rz = dot(r, z);
      for_rows([&](std::size_t i) {
        for (std::size_t c = 0; c < 3; ++c) p[i][c] = z[i][c] + rz / earlier * p[i][c];
      });
    }
    Vectors<Real> solution(x.size());
    for (std::size_t k = 0; k < x.size(); ++k) solution[static_cast<std::size_t>(order_[k])] = x[k];
    return solution;
  }

  static Real dot(const Vectors<Real>& a, const Vectors<Real>& b) {
    // By blocks, in FP64 in any case: the sum does not depend on the number of threads.
    constexpr std::size_t block = 4096;
    std::vector<double> sums((a.size() + block - 1) / block, 0.0);
    parallel_for(static_cast<std::int64_t>(sums.size()), [&](std::int64_t k) {
      const std::size_t begin = static_cast<std::size_t>(k) * block, end = std::min(a.size(), begin + block);
      double sum = 0;
      for (std::size_t i = begin; i < end; ++i) {
        for (std::size_t c = 0; c < 3; ++c)
          sum += static_cast<double>(a[i][c]) * static_cast<double>(b[i][c]);
      }
      sums[static_cast<std::size_t>(k)] = sum;
    });
    double total = 0;
    for (const double sum : sums) total += sum;
    return static_cast<Real>(total);
  }

 private:
  struct Edge {
    std::int32_t i, j;
    Real weight;
  };
  struct Entry {
    std::int32_t other;
    Real weight;
  };

  // Rows in the order of a breadth-first search, so that a row's neighbours are in the cache.
  void reorder() {
    const std::size_t n = diagonal_.size();
    std::vector<std::int32_t> number(n, -1);
    for (std::size_t start = 0; start < n; ++start) {
      if (number[start] >= 0) continue;
      number[start] = static_cast<std::int32_t>(order_.size());
      order_.push_back(static_cast<std::int32_t>(start));
      for (std::size_t at = order_.size() - 1; at < order_.size(); ++at) {
        const auto row = static_cast<std::size_t>(order_[at]);
        for (auto e = static_cast<std::size_t>(first_[row]); e < static_cast<std::size_t>(first_[row + 1]);
             ++e) {
          std::int32_t& other = number[static_cast<std::size_t>(entries_[e].other)];
          if (other >= 0) continue;
          other = static_cast<std::int32_t>(order_.size());
          order_.push_back(entries_[e].other);
        }
      }
    }
    std::vector<Entry> entries;
    entries.reserve(entries_.size());
    std::vector<std::int64_t> first{0};
    std::vector<Real> diagonal;
    for (const std::int32_t old : order_) {
      const auto row = static_cast<std::size_t>(old);
      for (auto e = static_cast<std::size_t>(first_[row]); e < static_cast<std::size_t>(first_[row + 1]); ++e)
        entries.push_back({number[static_cast<std::size_t>(entries_[e].other)], entries_[e].weight});
      first.push_back(static_cast<std::int64_t>(entries.size()));
      diagonal.push_back(diagonal_[row]);
    }
    entries_ = std::move(entries);
    first_ = std::move(first);
    diagonal_ = std::move(diagonal);
  }

  template <class Body>
  void for_rows(Body&& body) const {
    constexpr std::int64_t block = 4096;
    const auto n = static_cast<std::int64_t>(diagonal_.size());
    parallel_for((n + block - 1) / block, [&](std::int64_t k) {
      for (std::int64_t i = k * block; i < std::min(n, (k + 1) * block); ++i)
        body(static_cast<std::size_t>(i));
    });
  }

  Vectors<Real> scaled(const Vectors<Real>& r) const {
    Vectors<Real> z(r.size());
    for_rows([&](std::size_t i) {
      for (std::size_t c = 0; c < 3; ++c) z[i][c] = r[i][c] / diagonal_[i];
    });
    return z;
  }

  std::vector<Real> diagonal_;
  std::vector<std::int64_t> first_;
  std::vector<Edge> edges_;
  std::vector<Entry> entries_;
  std::vector<std::int32_t> order_;  // of the rows: their numbers outside
};

/// `iters` local-global iterations. The unknown is the displacement u from x; gradient(u) is the gradient of
/// the elastic energy at x + u. With z = x + u, a global step in the difference form is
///   A (z' - z) = M (y - z) - dt^2 gradient(z).
template <class Real, class Inputs, class Gradient>
Vectors<Real> local_global_iterations(const Inputs& in, const GlobalMatrix<Real>& matrix,
                                      Gradient&& gradient) {
  const std::int64_t n = in.mass.shape[0];
  const Real dt = in.dt;
  Vectors<Real> u(static_cast<std::size_t>(n));
  for (std::int64_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      u[static_cast<std::size_t>(i)][c] = dt * static_cast<Real>(in.v(i, c));
  }
  const Vectors<Real> inertial = u;
  Real first_residual = 0;
  for (std::int32_t k = 0; k < in.iters; ++k) {
    Vectors<Real> residual = gradient(u);
    for (std::size_t i = 0; i < residual.size(); ++i) {
      const Real mass = in.mass(static_cast<std::int64_t>(i));
      for (std::size_t c = 0; c < 3; ++c)
        residual[i][c] = mass * (inertial[i][c] - u[i][c]) - dt * dt * residual[i][c];
    }
    if (k == 0) first_residual = std::sqrt(GlobalMatrix<Real>::dot(residual, residual));
    // FP32 cannot go by the first residual: later ones are some hundred times smaller.
    const bool exact = sizeof(Real) == 8;
    const Vectors<Real> step = matrix.solve(residual, exact ? Real(1e-9) * first_residual : Real(0),
                                            exact ? Real(1e-12) : Real(1e-6));
    for (std::size_t i = 0; i < u.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) u[i][c] += step[i][c];
    }
  }
  return u;
}

/// x_new = x + u, v_new = u / dt.
template <class Real, class Inputs, class Outputs>
void write_displaced(const Inputs& in, const Vectors<Real>& u, const Outputs& out) {
  const Real dt = in.dt;
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const Real moved = u[static_cast<std::size_t>(i)][c];
      out.x_new(i, c) = static_cast<Real>(in.x(i, c)) + moved;
      out.v_new(i, c) = moved / dt;
    }
  }
}

}  // namespace gpuphys::serial
