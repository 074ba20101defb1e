// The Arnold-Beltrami-Childress flow with equal amplitudes: a smooth, three-dimensional, divergence-free test
// velocity.
#pragma once

#include <array>

namespace gpuphys {

/// u = U (sin(kz z) + cos(ky y), sin(kx x) + cos(kz z), sin(ky y) + cos(kx x)). Its rms speed over a period
/// is sqrt(3) U. With equal wave numbers k its curl is k u (a Beltrami field), so viscosity scales it by
/// exp(-nu k^2 t).
struct AbcFlow {
  double amplitude = 1;                 ///< U
  std::array<double, 3> k = {1, 1, 1};  ///< wave number along each axis, radians per unit of length

  /// `periods` whole periods along each axis of a box of n[d] cells of unit size.
  static AbcFlow periodic(double amplitude, int periods, const std::array<double, 3>& n);

  /// The velocity at a point.
  std::array<double, 3> at(double x, double y, double z) const;
};

}  // namespace gpuphys
