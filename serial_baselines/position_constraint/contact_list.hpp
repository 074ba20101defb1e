// Contacts of particles for the serial XPBD baselines: every pair nearer than a radius, by sorted cells; and
// the XPBD step of one contact.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace gpuphys::serial {

template <class Real>
using Vectors = std::vector<std::array<Real, 3>>;

/// Pairs (i, j), i < j, of particles with 0 < |difference(i, j)| < radius. `rough` has their positions; what
/// they are off by must be far below the radius, or 0.
template <class Real, class Difference>
std::vector<std::pair<std::int32_t, std::int32_t>> pairs_within(const Vectors<double>& rough, Real radius,
                                                                Difference&& difference) {
  using Cell = std::array<std::int64_t, 3>;
  // A little larger than the radius.
  const double edge = 1.001 * static_cast<double>(radius);
  std::vector<std::pair<Cell, std::int32_t>> sorted;
  for (std::size_t i = 0; i < rough.size(); ++i) {
    Cell cell;
    for (std::size_t d = 0; d < 3; ++d) cell[d] = static_cast<std::int64_t>(std::floor(rough[i][d] / edge));
    sorted.push_back({cell, static_cast<std::int32_t>(i)});
  }
  std::sort(sorted.begin(), sorted.end());
  std::vector<std::pair<std::int32_t, std::int32_t>> pairs;
  for (const auto& [cell, i] : sorted) {
    for (std::int64_t dx = -1; dx <= 1; ++dx) {
      for (std::int64_t dy = -1; dy <= 1; ++dy) {
        // Three cells along z stand one behind the other.
        const Cell first{cell[0] + dx, cell[1] + dy, cell[2] - 1}, last{first[0], first[1], cell[2] + 1};
        for (auto at = std::lower_bound(sorted.begin(), sorted.end(), std::pair{first, std::int32_t{0}});
             at != sorted.end() && at->first <= last; ++at) {
          const std::int32_t j = at->second;
          if (j <= i) continue;
          const std::array<Real, 3> d = difference(i, j);
          const Real square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
          if (square > 0 && square < radius * radius) pairs.push_back({i, j});
        }
      }
    }
  }
  return pairs;
}

/// What one contact does in a sweep.
template <class Real>
struct ContactLaw {
  Real thickness, alpha, relaxation;

  /// Advances `multiplier` for ends `d` apart; returns by what i moves for w = 1 (j moves by the opposite).
  std::array<Real, 3> advance(const std::array<Real, 3>& d, Real inv_mass_sum, Real& multiplier) const {
    const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    if (length == 0 || inv_mass_sum == 0) return {0, 0, 0};
    const Real violation = length - thickness;
    const Real full = (-violation - alpha * multiplier) / (inv_mass_sum + alpha);
    const Real after = std::max(Real(0), multiplier + relaxation * full);
    const Real step = after - multiplier;
    multiplier = after;
    return {step * (d[0] / length), step * (d[1] / length), step * (d[2] / length)};
  }
};

}  // namespace gpuphys::serial
