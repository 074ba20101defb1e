// Velocity and velocity gradient at a particle from the nodes of a collocated grid, for the serial baselines,
// from cases/particle_grid/node_gather.md alone.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "core/contract/view.hpp"

namespace gpuphys::serial {

/// The three nodes of a particle along one axis, indices clamped to the array, and their weights and slopes.
template <class Real>
struct ClampedSpline {
  std::array<std::int64_t, 3> node;
  std::array<Real, 3> weight;
  std::array<Real, 3> slope;  ///< dw/dx, per metre

  /// `n`: nodes along the axis.
  ClampedSpline(Real x, Real dx, std::int64_t n) {
    Real lowest = std::floor(x / dx - Real(0.5));
    // From the middle node, in cells. The numerator is rounded once.
    Real t = std::fma(-(lowest + 1), dx, x) / dx;
    // Farther out all three indices are clamped to the same node. Such coordinates may fit no integer.
    const auto highest = static_cast<Real>(n);
    if (lowest < -3 || lowest > highest) {
      lowest = lowest < -3 ? Real(-3) : highest;
      t = 0;
    }
    const auto base = static_cast<std::int64_t>(lowest);
    for (std::int64_t o = 0; o < 3; ++o) {
      const std::int64_t i = base + o;
      node[static_cast<std::size_t>(o)] = i < 0 ? 0 : i > n - 1 ? n - 1 : i;
    }
    const Real low = Real(0.5) - t, high = Real(0.5) + t;
    weight = {Real(0.5) * low * low, Real(0.75) - t * t, Real(0.5) * high * high};
    slope = {-low / dx, -2 * t / dx, high / dx};
  }
};

/// The same without clamping, for transfers to the nodes: nodes first, first + 1, first + 2, in the array or
/// not.
template <class Real>
struct UnclampedSpline {
  std::int64_t first = 0;
  std::array<Real, 3> weight{};
  std::array<Real, 3> slope{};  ///< dw/dx, per metre

  UnclampedSpline() = default;
  UnclampedSpline(Real x, Real dx) {
    const Real lowest = std::floor(x / dx - Real(0.5));
    first = static_cast<std::int64_t>(lowest);
    const Real t = std::fma(-(lowest + 1), dx, x) / dx;
    const Real low = Real(0.5) - t, high = Real(0.5) + t;
    weight = {Real(0.5) * low * low, Real(0.75) - t * t, Real(0.5) * high * high};
    slope = {-low / dx, -2 * t / dx, high / dx};
  }
};

template <class Real>
struct Gathered {
  std::array<Real, 3> v{};                 ///< sum w u
  std::array<std::array<Real, 3>, 3> g{};  ///< sum u_a dw/dx_b
};

template <class Real, class Sample = float>
Gathered<Real> gather_from_nodes(const std::array<View<const Sample, 3>, 3>& u, const std::array<Real, 3>& x,
                                 Real dx) {
  const ClampedSpline<Real> along_x(x[0], dx, u[0].shape[0]), along_y(x[1], dx, u[0].shape[1]),
      along_z(x[2], dx, u[0].shape[2]);
  std::array<Real, 3> middle;
  for (std::size_t a = 0; a < 3; ++a)
    middle[a] = static_cast<Real>(u[a](along_x.node[1], along_y.node[1], along_z.node[1]));
  Gathered<Real> sum;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) {
        const std::int64_t at = u[0].offset(along_x.node[i], along_y.node[j], along_z.node[k]);
        const Real w = along_x.weight[i] * along_y.weight[j] * along_z.weight[k];
        const std::array<Real, 3> gradient{along_x.slope[i] * along_y.weight[j] * along_z.weight[k],
                                           along_x.weight[i] * along_y.slope[j] * along_z.weight[k],
                                           along_x.weight[i] * along_y.weight[j] * along_z.slope[k]};
        for (std::size_t a = 0; a < 3; ++a) {
          const Real difference = static_cast<Real>(u[a].data[at]) - middle[a];
          sum.v[a] += w * difference;
          for (std::size_t b = 0; b < 3; ++b) sum.g[a][b] += difference * gradient[b];
        }
      }
    }
  }
  for (std::size_t a = 0; a < 3; ++a) sum.v[a] += middle[a];
  return sum;
}

}  // namespace gpuphys::serial
