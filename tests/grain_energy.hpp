// What time loops of grains weigh.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <numeric>
#include <vector>

#include "core/contract/view.hpp"

namespace gpuphys::testing {

/// kg, at a density in kg/m^3.
inline double grain_mass(double radius, double density = 1) {
  return 4.0 / 3.0 * std::numbers::pi * density * radius * radius * radius;
}

/// Of all contacts: their force kn sqrt(r*) overlap^1.5, integrated. Pairs are found by a sweep along x.
inline double elastic_energy(const View<const float, 2>& x, const View<const float, 1>& radius, double kn) {
  const std::int64_t n = radius.shape[0];
  std::vector<std::int64_t> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), std::int64_t{0});
  std::sort(order.begin(), order.end(), [&](auto a, auto b) { return x(a, 0) < x(b, 0); });
  const double largest = *std::max_element(radius.data, radius.data + n);
  double energy = 0;
  for (std::size_t a = 0; a < order.size(); ++a) {
    for (std::size_t b = a + 1; b < order.size(); ++b) {
      const std::int64_t i = order[a], j = order[b];
      std::array<double, 3> d;
      for (std::size_t c = 0; c < 3; ++c) {
        d[c] = static_cast<double>(x(i, c)) - static_cast<double>(x(j, c));
      }
      if (-d[0] > 2 * largest) break;
      const double ri = radius(i), rj = radius(j), overlap = ri + rj - std::hypot(d[0], d[1], d[2]);
      if (overlap > 0) energy += 0.4 * kn * std::sqrt(ri * rj / (ri + rj)) * std::pow(overlap, 2.5);
    }
  }
  return energy;
}

}  // namespace gpuphys::testing
