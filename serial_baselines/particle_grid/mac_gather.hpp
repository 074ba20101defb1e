// Samples of a MAC grid around a particle, indices clamped to the array, for the serial baselines of
// grid-to-particle transfers, from cases/particle_grid/mac_particles.md alone.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace gpuphys::serial {

/// Count samples along one axis: 2 for the hat, 3 for the quadratic B-spline.
template <class Real, std::size_t Count>
struct ClampedSamples {
  std::array<std::int64_t, Count> index;
  std::array<Real, Count> weight;
  std::array<Real, Count> distance;  ///< sample - particle, in cells, of the index before it is clamped

  /// `offset`: where sample 0 sits, in cells; `n`: samples along the axis.
  ClampedSamples(float position, float spacing, Real offset, std::int64_t n) {
    const auto x = static_cast<Real>(position), dx = static_cast<Real>(spacing);
    constexpr Real middle = Count == 3 ? 1 : 0;  // the sample that the fraction is counted from
    // (x - (i + offset) dx) / dx with the numerator rounded once.
    const auto from = [&](Real i) { return std::fma(-(i + offset), dx, x) / dx; };
    Real lowest = std::floor(x / dx - offset - middle / 2);
    // Where the quotient was rounded across a sample, the hat has a kink.
    if (Count == 2) lowest += std::floor(from(lowest));
    Real t = from(lowest + middle);
    const auto reach = static_cast<Real>(Count);
    if (!(lowest >= -reach && lowest <= static_cast<Real>(n))) {
      // All indices are clamped to the same sample, here as there. Such coordinates may fit no integer.
      lowest = x < 0 ? -reach : static_cast<Real>(n);
      t = 0;
    }
    for (std::size_t o = 0; o < Count; ++o) {
      const auto i = static_cast<std::int64_t>(lowest) + static_cast<std::int64_t>(o);
      index[o] = i < 0 ? 0 : i > n - 1 ? n - 1 : i;
      distance[o] = static_cast<Real>(o) - middle - t;
    }
    if constexpr (Count == 2) {
      weight = {1 - t, t};
    } else {
      const Real low = Real(0.5) - t, high = Real(0.5) + t;
      weight = {Real(0.5) * low * low, Real(0.75) - t * t, Real(0.5) * high * high};
    }
  }
};

}  // namespace gpuphys::serial
