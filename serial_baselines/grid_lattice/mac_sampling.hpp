// Sampling a velocity on a staggered grid, for the serial baselines of the advection tasks.
//
// A point is held as an integer cell index plus an offset in cells, because a float32 index of 256 plus a
// fraction has only 1.5e-5 cells of resolution: the offset keeps the FP32 builds of the baselines meaningful.
// For FP64 it is harmless.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "core/contract/module.hpp"

namespace gpuphys::serial {

template <class Real>
using Vector = std::array<Real, 3>;

/// Position (cell[d] + offset[d]) dx along each axis d.
template <class Real>
struct Point {
  std::array<std::int64_t, 3> cell;
  std::array<Real, 3> offset;
};

/// Where sample (i,j,k) of component c sits: on the lower face normal to c of cell (i,j,k).
template <class Real>
Point<Real> face_centre(int c, std::int64_t i, std::int64_t j, std::int64_t k) {
  Point<Real> p{{i, j, k}, {Real(0.5), Real(0.5), Real(0.5)}};
  p.offset[static_cast<std::size_t>(c)] = 0;
  return p;
}

/// The point displaced by `scale` times a velocity (scale in cells per unit velocity).
template <class Real>
Point<Real> moved(Point<Real> p, const Vector<Real>& velocity, Real scale) {
  for (std::size_t d = 0; d < 3; ++d) p.offset[d] += scale * velocity[d];
  return p;
}

/// A vector field on the faces, with samples of type Sample.
template <class Real, class Sample = float>
class MacField {
 public:
  using Component = View<const Sample, 3>;
  MacField(Component x, Component y, Component z) : u_{x, y, z} {}

  /// All three components at a point.
  Vector<Real> at(const Point<Real>& p) const { return {component(0, p), component(1, p), component(2, p)}; }

  /// Trilinear interpolation of component c; outside the hull of its samples, the value at the nearest point
  /// of the hull.
  Real component(int c, const Point<Real>& p) const {
    const Component& u = u_[static_cast<std::size_t>(c)];
    const auto [low, weight] = locate(c, p);
    Real value = 0;
    for (int a = 0; a < 2; ++a) {
      for (int b = 0; b < 2; ++b) {
        for (int e = 0; e < 2; ++e) {
          const Real w = (a ? weight[0] : 1 - weight[0]) * (b ? weight[1] : 1 - weight[1]) *
                         (e ? weight[2] : 1 - weight[2]);
          if (w == 0) continue;  // also keeps the index inside the array on its last sample
          value += w * static_cast<Real>(u(low[0] + a, low[1] + b, low[2] + e));
        }
      }
    }
    return value;
  }

  /// The smallest and the largest of the eight samples around a point: along each axis the last one not
  /// beyond it and the next, or the two at the end of the axis.
  std::pair<Real, Real> range(int c, const Point<Real>& p) const {
    const Component& u = u_[static_cast<std::size_t>(c)];
    std::array<std::int64_t, 3> first = locate(c, p).low, last;
    for (std::size_t d = 0; d < 3; ++d) {
      first[d] = std::max<std::int64_t>(std::min(first[d], u.shape[d] - 2), 0);
      last[d] = std::min(first[d] + 1, u.shape[d] - 1);
    }
    Real low = u(first[0], first[1], first[2]), high = low;
    for (const std::int64_t i : {first[0], last[0]}) {
      for (const std::int64_t j : {first[1], last[1]}) {
        for (const std::int64_t k : {first[2], last[2]}) {
          low = std::min(low, static_cast<Real>(u(i, j, k)));
          high = std::max(high, static_cast<Real>(u(i, j, k)));
        }
      }
    }
    return {low, high};
  }

 private:
  struct Location {
    std::array<std::int64_t, 3> low;
    std::array<Real, 3> weight;  // of the upper neighbour
  };
  Location locate(int c, const Point<Real>& p) const {
    const Component& u = u_[static_cast<std::size_t>(c)];
    Location at;
    for (std::size_t d = 0; d < 3; ++d) {
      const Real shift = p.offset[d] - (static_cast<int>(d) == c ? Real(0) : Real(0.5));
      const auto last = static_cast<Real>(u.shape[d] - 1);
      const Real index = static_cast<Real>(p.cell[d]) + shift;
      if (!(index > 0)) {
        at.low[d] = 0;
        at.weight[d] = 0;
      } else if (index >= last) {
        at.low[d] = u.shape[d] - 1;
        at.weight[d] = 0;
      } else {
        const Real whole = std::floor(shift);
        at.low[d] = p.cell[d] + static_cast<std::int64_t>(whole);
        at.weight[d] = shift - whole;
      }
    }
    return at;
  }

  std::array<Component, 3> u_;
};

/// Sets every sample of the three components of a field to value(c, its face).
template <class Real, class Value>
void fill_faces(const std::array<View<Real, 3>, 3>& field, Value&& value) {
  for (int c = 0; c < 3; ++c) {
    const View<Real, 3>& u = field[static_cast<std::size_t>(c)];
    for (std::int64_t i = 0; i < u.shape[0]; ++i) {
      for (std::int64_t j = 0; j < u.shape[1]; ++j) {
        for (std::int64_t k = 0; k < u.shape[2]; ++k) u(i, j, k) = value(c, face_centre<Real>(c, i, j, k));
      }
    }
  }
}

/// The baseline of a semi-Lagrangian scheme: every component takes its value at the departure point of its
/// face, Trace::departure(velocity, face, step), `step` being the cells travelled per unit velocity.
template <class Real, class Trace>
class SemiLagrangian {
 public:
  template <class Inputs, class Outputs>
  void allocate(const Inputs&, const Outputs&) {}

  template <class Inputs, class Outputs>
  void compute(const Inputs& in, const Outputs& out) {
    const MacField<Real> velocity{in.ux, in.uy, in.uz};
    const Real step = static_cast<Real>(in.dt) / static_cast<Real>(in.dx);
    fill_faces<Real>({out.ux, out.uy, out.uz}, [&](int c, const Point<Real>& face) {
      return velocity.component(c, Trace::departure(velocity, face, step));
    });
  }
};

/// The point from which the midpoint rule reaches `from` in a step; with a negative step, the point it goes
/// to.
template <class Real>
Point<Real> midpoint_departure(const MacField<Real>& velocity, const Point<Real>& from, Real step) {
  const Vector<Real> k1 = velocity.at(from);
  const Point<Real> middle = moved(from, k1, -step / 2);
  const Vector<Real> k2 = velocity.at(middle);
  return moved(from, k2, -step);
}

}  // namespace gpuphys::serial
