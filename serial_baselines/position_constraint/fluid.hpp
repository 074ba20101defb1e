// What the serial baselines of the position-based fluid tasks share, written from
// cases/position_constraint/fluid.md and the tasks' own pages: neighbour lists, kernels, and the three
// operators of which pbf is composed. Every particle gathers for itself, so loops may run in parallel:
// nothing depends on the number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <span>
#include <vector>

#include "core/base/parallel.hpp"
#include "core/contract/view.hpp"

namespace gpuphys::serial {

template <class Real>
using Vec = std::array<Real, 3>;
template <class Real>
using Field = std::vector<Vec<Real>>;

template <class Real>
Vec<Real> operator-(const Vec<Real>& a, const Vec<Real>& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
template <class Real>
void add(Vec<Real>& sum, Real factor, const Vec<Real>& a) {
  for (std::size_t c = 0; c < 3; ++c) sum[c] += factor * a[c];
}
template <class Real>
Real dot(const Vec<Real>& a, const Vec<Real>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
template <class Real>
Vec<Real> cross(const Vec<Real>& a, const Vec<Real>& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

/// Lists of the particles within a distance (and a few just beyond it): particles sorted by cubic cells,
/// found by binary search.
class NeighbourLists {
 public:
  NeighbourLists(const std::vector<Vec<double>>& x, double h) : place_(x.size()) {
    const double reach = h * (1 + 1e-6), edge = 1.001 * h;
    std::vector<Entry> entries(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
      entries[i].index = static_cast<std::int32_t>(i);
      for (std::size_t c = 0; c < 3; ++c) {
        entries[i].cell[c] = static_cast<std::int32_t>(std::floor(x[i][c] / edge));
      }
    }
    std::sort(entries.begin(), entries.end(), before);
    std::vector<Vec<double>> at(x.size());  // in the order of the entries
    for (std::size_t k = 0; k < at.size(); ++k) at[k] = x[static_cast<std::size_t>(entries[k].index)];
    const auto count = static_cast<std::int64_t>(x.size());
    lists_.resize(static_cast<std::size_t>(pieces_of(count)));
    parallel_pieces(count, [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      std::vector<std::int32_t>& list = lists_[static_cast<std::size_t>(piece)];
      std::vector<Column> columns;
      for (auto k = static_cast<std::size_t>(begin); k < static_cast<std::size_t>(end); ++k) {
        const Entry& own = entries[k];
        if (k == static_cast<std::size_t>(begin) || own.cell != entries[k - 1].cell)
          columns = around(entries, own.cell);
        Place& place = place_[static_cast<std::size_t>(own.index)];
        place = {static_cast<std::size_t>(piece), list.size(), 0};
        for (const Column& column : columns) {
          for (std::size_t other = column.begin; other < column.end; ++other) {
            if (other == k) continue;
            const Vec<double> d = at[k] - at[other];
            if (dot(d, d) < reach * reach) list.push_back(entries[other].index);
          }
        }
        place.count = list.size() - place.begin;
      }
    });
  }

  /// The neighbours of particle i, without itself.
  std::span<const std::int32_t> of(std::size_t i) const {
    const Place& p = place_[i];
    return std::span<const std::int32_t>(lists_[p.piece]).subspan(p.begin, p.count);
  }

  /// Numbers of the particles in the order of their cells: near in the list, near in space.
  static std::vector<std::int32_t> spatial_order(const View<const float, 2>& x, double h) {
    std::vector<Entry> entries(static_cast<std::size_t>(x.shape[0]));
    for (std::size_t i = 0; i < entries.size(); ++i) {
      entries[i].index = static_cast<std::int32_t>(i);
      for (std::size_t c = 0; c < 3; ++c) {
        entries[i].cell[c] =
            static_cast<std::int32_t>(std::floor(static_cast<double>(x(i, c)) / (1.001 * h)));
      }
    }
    std::sort(entries.begin(), entries.end(), before);
    std::vector<std::int32_t> order;
    for (const Entry& e : entries) order.push_back(e.index);
    return order;
  }

 private:
  struct Entry {
    std::array<std::int32_t, 3> cell;
    std::int32_t index;
  };
  struct Place {
    std::size_t piece, begin, count;
  };
  struct Column {
    std::size_t begin, end;
  };
  static bool before(const Entry& a, const Entry& b) {
    return a.cell != b.cell ? a.cell < b.cell : a.index < b.index;
  }

  // The entries in the 27 cells around one, a range for every column of three.
  static std::vector<Column> around(const std::vector<Entry>& entries,
                                    const std::array<std::int32_t, 3>& cell) {
    std::vector<Column> columns;
    for (std::int32_t a = -1; a <= 1; ++a) {
      for (std::int32_t b = -1; b <= 1; ++b) {
        const Entry first{{cell[0] + a, cell[1] + b, cell[2] - 1}, 0};
        const Entry behind{{cell[0] + a, cell[1] + b, cell[2] + 2}, 0};
        const auto from = std::lower_bound(entries.begin(), entries.end(), first, before);
        const auto to = std::lower_bound(from, entries.end(), behind, before);
        columns.push_back({static_cast<std::size_t>(from - entries.begin()),
                           static_cast<std::size_t>(to - entries.begin())});
      }
    }
    return columns;
  }

  std::vector<Place> place_;
  std::vector<std::vector<std::int32_t>> lists_;
};

/// The two kernels and what a pair enters them with.
template <class Real>
struct FluidKernels {
  Real h, poly6, spiky;

  explicit FluidKernels(float reach)
      : h(reach),
        poly6(static_cast<Real>(315 / (64 * std::numbers::pi) / std::pow(static_cast<double>(reach), 3))),
        spiky(static_cast<Real>(45 / std::numbers::pi / std::pow(static_cast<double>(reach), 4))) {}

  /// 1 - r^2/h^2, and 0 from h on.
  Real depth(const Vec<Real>& d) const {
    const Real square = dot(d, d);
    return square < h * h ? 1 - square / (h * h) : Real(0);
  }
  Real w(const Vec<Real>& d) const {
    const Real u = depth(d);
    return poly6 * u * u * u;
  }
  /// grad W / spiky: the direction from i to j, weighted by (1 - r/h)^2.
  Vec<Real> pull(const Vec<Real>& d) const {
    const Real r = std::sqrt(dot(d, d));
    if (!(r > 0 && r < h)) return {0, 0, 0};
    const Real weight = (1 - r / h) * (1 - r / h);
    const Real factor = -weight / r;
    return {factor * d[0], factor * d[1], factor * d[2]};
  }
};

/// Particles in spatial order: positions x + shift, of which x stays as it came.
template <class Real>
struct Fluid {
  FluidKernels<Real> kernels;
  std::vector<std::int32_t> order;  ///< number in the input
  Field<float> x;
  Field<Real> shift;

  Fluid(const View<const float, 2>& positions, float h)
      : kernels(h), order(NeighbourLists::spatial_order(positions, static_cast<double>(h))) {
    x = gather<float>(positions);
    shift.assign(order.size(), {0, 0, 0});
  }

  template <class T>
  Field<T> gather(const View<const float, 2>& values) const {
    Field<T> mine(order.size());
    for (std::size_t i = 0; i < order.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) mine[i][c] = static_cast<T>(values(order[i], c));
    }
    return mine;
  }

  /// out = start + change, added once.
  void scatter(const View<Real, 2>& out, const Field<Real>& start, const Field<Real>& change) const {
    for (std::size_t i = 0; i < order.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) out(order[i], c) = start[i][c] + change[i][c];
    }
  }
  Field<Real> start() const {
    Field<Real> all(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) all[i][c] = static_cast<Real>(x[i][c]);
    }
    return all;
  }

  /// x_i - x_j where they are now.
  Vec<Real> between(std::size_t i, std::size_t j) const {
    Vec<Real> d;
    for (std::size_t c = 0; c < 3; ++c) {
      d[c] = static_cast<Real>(x[i][c]) - static_cast<Real>(x[j][c]) + (shift[i][c] - shift[j][c]);
    }
    return d;
  }
  NeighbourLists neighbours() const {
    std::vector<Vec<double>> now(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c)
        now[i][c] = static_cast<double>(x[i][c]) + static_cast<double>(shift[i][c]);
    }
    return NeighbourLists(now, static_cast<double>(kernels.h));
  }

  /// body(i) for every particle, body(i, j) below for its neighbours.
  template <class Body>
  void each(Body&& body) const {
    parallel_pieces(static_cast<std::int64_t>(x.size()),
                    [&](std::int64_t, std::int64_t begin, std::int64_t end) {
                      for (std::int64_t i = begin; i < end; ++i) body(static_cast<std::size_t>(i));
                    });
  }
};

template <class Real>
struct DensityConstraint {
  Real rho0, eps, k_corr, dq;
  std::int32_t iters;
};

/// Moves the particles by `iters` Jacobi iterations (solve_constraint_pbf.md).
template <class Real>
void solve_constraint(Fluid<Real>& fluid, const DensityConstraint<Real>& law) {
  const FluidKernels<Real>& kernels = fluid.kernels;
  const Real slope = kernels.spiky / law.rho0;
  const Real reference_depth = 1 - law.dq * law.dq;
  std::vector<Real> lambda(fluid.x.size());
  Field<Real> moved(fluid.x.size());
  for (std::int32_t iteration = 0; iteration < law.iters; ++iteration) {
    const NeighbourLists lists = fluid.neighbours();
    fluid.each([&](std::size_t i) {
      Real density = kernels.w({0, 0, 0}), squares = 0;
      Vec<Real> own{0, 0, 0};
      for (const std::int32_t j : lists.of(i)) {
        const Vec<Real> d = fluid.between(i, static_cast<std::size_t>(j));
        const Vec<Real> pull = kernels.pull(d);
        density += kernels.w(d);
        squares += dot(pull, pull);
        add(own, Real(1), pull);
      }
      const Real gradients = slope * slope * (squares + dot(own, own));
      lambda[i] = -(density / law.rho0 - 1) / (gradients + law.eps);
    });
    fluid.each([&](std::size_t i) {
      Vec<Real> step{0, 0, 0};
      for (const std::int32_t neighbour : lists.of(i)) {
        const auto j = static_cast<std::size_t>(neighbour);
        const Vec<Real> d = fluid.between(i, j);
        const Real ratio = kernels.depth(d) / reference_depth;
        const Real cube = ratio * ratio * ratio;
        const Real pressure = -law.k_corr * cube * cube * cube * cube;
        add(step, slope * (lambda[i] + lambda[j] + pressure), kernels.pull(d));
      }
      moved[i] = step;
    });
    for (std::size_t i = 0; i < moved.size(); ++i) add(fluid.shift[i], Real(1), moved[i]);
  }
}

/// Changes of velocity by vorticity confinement (vorticity_confinement_pbf.md).
template <class Real>
Field<Real> confinement(const Fluid<Real>& fluid, const NeighbourLists& lists, const Field<Real>& v,
                        Real epsilon, Real dt) {
  const FluidKernels<Real>& kernels = fluid.kernels;
  // Without the kernel's factor, which may be very large or small: omega = spiky curl, eta = spiky^2 rise.
  Field<Real> curl(v.size()), change(v.size());
  std::vector<Real> size(v.size());
  fluid.each([&](std::size_t i) {
    Vec<Real> sum{0, 0, 0};
    for (const std::int32_t neighbour : lists.of(i)) {
      const auto j = static_cast<std::size_t>(neighbour);
      // The gradient with respect to x_j is minus the one with respect to x_i.
      add(sum, Real(-1), cross(v[j] - v[i], kernels.pull(fluid.between(i, j))));
    }
    curl[i] = sum;
    size[i] = std::sqrt(dot(sum, sum));
  });
  const Real regulariser = Real(0x1p-20) / kernels.spiky / kernels.spiky;
  fluid.each([&](std::size_t i) {
    Vec<Real> rise{0, 0, 0};
    for (const std::int32_t neighbour : lists.of(i)) {
      const auto j = static_cast<std::size_t>(neighbour);
      add(rise, size[j] - size[i], kernels.pull(fluid.between(i, j)));
    }
    const Real length = std::sqrt(dot(rise, rise)) + regulariser;
    const Vec<Real> direction{rise[0] / length, rise[1] / length, rise[2] / length};
    const Vec<Real> turn = cross(direction, curl[i]);
    change[i] = {0, 0, 0};
    add(change[i], dt * epsilon * kernels.spiky, turn);
  });
  return change;
}

/// Changes of velocity by XSPH viscosity (viscosity_pbf.md).
template <class Real>
Field<Real> viscosity(const Fluid<Real>& fluid, const NeighbourLists& lists, const Field<Real>& v, Real c) {
  Field<Real> change(v.size());
  fluid.each([&](std::size_t i) {
    Vec<Real> sum{0, 0, 0};
    for (const std::int32_t neighbour : lists.of(i)) {
      const auto j = static_cast<std::size_t>(neighbour);
      add(sum, fluid.kernels.w(fluid.between(i, j)), v[j] - v[i]);
    }
    for (std::size_t a = 0; a < 3; ++a) change[i][a] = c * sum[a];
  });
  return change;
}

}  // namespace gpuphys::serial
