// Sampling a velocity on a staggered grid, for the serial baselines of the advection tasks.
//
// A point is held as an integer cell index plus an offset in cells, because a float32 index of 256 plus a
// fraction has only 1.5e-5 cells of resolution: the offset keeps the FP32 builds of the baselines meaningful.
// For FP64 it is harmless.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

#include "core/module.hpp"

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

template <class Real>
class MacVelocity {
 public:
  MacVelocity(View<const float, 3> ux, View<const float, 3> uy, View<const float, 3> uz) : u_{ux, uy, uz} {}

  /// All three components at a point.
  Vector<Real> at(const Point<Real>& p) const { return {component(0, p), component(1, p), component(2, p)}; }

  /// Trilinear interpolation of component c; outside the hull of its samples, the value at the nearest point
  /// of the hull.
  Real component(int c, const Point<Real>& p) const {
    const View<const float, 3>& u = u_[static_cast<std::size_t>(c)];
    std::array<std::int64_t, 3> low;
    std::array<Real, 3> weight;  // of the upper neighbour
    for (std::size_t d = 0; d < 3; ++d) {
      const Real shift = p.offset[d] - (static_cast<int>(d) == c ? Real(0) : Real(0.5));
      const auto last = static_cast<Real>(u.shape[d] - 1);
      const Real index = static_cast<Real>(p.cell[d]) + shift;
      if (!(index > 0)) {
        low[d] = 0;
        weight[d] = 0;
      } else if (index >= last) {
        low[d] = u.shape[d] - 1;
        weight[d] = 0;
      } else {
        const Real whole = std::floor(shift);
        low[d] = p.cell[d] + static_cast<std::int64_t>(whole);
        weight[d] = shift - whole;
      }
    }
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

 private:
  std::array<View<const float, 3>, 3> u_;
};

}  // namespace gpuphys::serial
