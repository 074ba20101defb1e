// A smooth divergence-free velocity made of random Fourier modes, sampled on a MAC grid.
#pragma once

#include <array>
#include <complex>
#include <cstdint>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys {

/// u(x) = U sqrt(6/M) sum_m a_m cos(2 pi k_m.x/L + phi_m) with integer wave vectors k_m drawn uniformly from
/// {-k_max..k_max}^3 without 0, unit amplitudes a_m in a random direction perpendicular to k_m, and uniform
/// phases. The mean over space and components of u^2 is U^2 whatever M (for distinct k_m).
struct FourierVelocity {
  struct Mode {
    std::array<int, 3> k;
    std::array<double, 3> amplitude;  ///< includes U sqrt(6/M)
    double phase;
  };
  double period = 1;  ///< L, in the unit of length of the grid spacing
  int k_max = 1;
  std::vector<Mode> modes;

  /// Random streams used: 0 wave vectors, 1 directions, 2 phases.
  static FourierVelocity random(std::uint64_t seed, int n_modes, int k_max, double rms, double period);

  /// Component c at a point.
  double at(int c, double x, double y, double z) const;

  /// Fills component c (0, 1, 2) of a MAC grid of cells of size dx: `array` has one more sample along axis c.
  /// Evaluated as a sum of products of per-axis complex exponentials, in FP64, rounded once to float32.
  void fill(int c, double dx, HostArray& array) const;
};

}  // namespace gpuphys
