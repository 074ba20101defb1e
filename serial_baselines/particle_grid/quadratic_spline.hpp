// Quadratic B-spline weights on a line, for the serial baselines, from the specifications alone.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

namespace gpuphys::serial {

/// The three nodes that a point reaches along one axis: base, base + 1, base + 2.
template <class Real>
struct QuadraticSpline {
  std::int64_t base;
  std::array<Real, 3> weight;
  std::array<Real, 3> slope;  ///< dw/dg, per cell

  /// g: the coordinate in cells, a node at every whole number.
  explicit QuadraticSpline(Real g) {
    const Real lowest = std::floor(g - Real(0.5));
    base = static_cast<std::int64_t>(lowest);
    const Real f = g - lowest;
    weight = {Real(0.5) * (Real(1.5) - f) * (Real(1.5) - f), Real(0.75) - (f - 1) * (f - 1),
              Real(0.5) * (f - Real(0.5)) * (f - Real(0.5))};
    slope = {f - Real(1.5), -2 * (f - 1), f - Real(0.5)};
  }
};

}  // namespace gpuphys::serial
