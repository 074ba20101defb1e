// Samples of a MAC grid around particles, for the serial baselines, from the specifications alone.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/contract/view.hpp"

namespace gpuphys::serial {

/// o_c[d]: where component c's sample 0 sits along axis d, in cells.
template <class Real>
Real mac_offset(std::size_t c, std::size_t d) {
  return c == d ? Real(0) : Real(0.5);
}

/// The samples that a particle reaches along one axis.
template <class Real, std::size_t Count>
struct MacSamples {
  std::int64_t first;
  std::array<Real, Count> weight;
  std::array<Real, Count> distance;  ///< sample - particle, in cells
};

/// Whether a particle comes near the samples 0 .. count-1; far coordinates may not fit an integer.
template <class Real>
bool near_samples(float x, float dx, Real offset, std::int64_t count) {
  const Real g = static_cast<Real>(x) / static_cast<Real>(dx) - offset;
  return g > -2 && g < static_cast<Real>(count) + 1;
}

/// (x - (sample + offset) dx) / dx with the numerator rounded once.
template <class Real>
Real mac_distance(float x, float dx, std::int64_t sample, Real offset) {
  return std::fma(-(static_cast<Real>(sample) + offset), static_cast<Real>(dx), static_cast<Real>(x)) /
         static_cast<Real>(dx);
}

/// Hat weights.
template <class Real>
MacSamples<Real, 2> hat_samples(float x, float dx, Real offset) {
  const auto first =
      static_cast<std::int64_t>(std::floor(static_cast<Real>(x) / static_cast<Real>(dx) - offset));
  const Real t = mac_distance(x, dx, first, offset);
  return {first, {1 - t, t}, {-t, 1 - t}};
}

/// Quadratic B-spline weights.
template <class Real>
MacSamples<Real, 3> quadratic_samples(float x, float dx, Real offset) {
  const auto first = static_cast<std::int64_t>(
      std::floor(static_cast<Real>(x) / static_cast<Real>(dx) - offset - Real(0.5)));
  const Real t = mac_distance(x, dx, first + 1, offset);  // in [-1/2, 1/2)
  const Real low = Real(0.5) - t, high = Real(0.5) + t;
  return {first, {Real(0.5) * low * low, Real(0.75) - t * t, Real(0.5) * high * high}, {-1 - t, -t, 1 - t}};
}

/// The particles in the order of their cells, so that those that share samples follow each other: a counting
/// sort. Cells outside the box count with the nearest inside.
inline std::vector<std::uint32_t> order_by_cell(const View<const float, 2>& x, float dx,
                                                const std::array<std::int64_t, 3>& cells) {
  const std::int64_t particles = x.shape[0];
  std::vector<std::uint32_t> cell_of(static_cast<std::size_t>(particles));
  std::vector<std::uint32_t> begin(static_cast<std::size_t>(cells[0] * cells[1] * cells[2]) + 1);
  for (std::int64_t p = 0; p < particles; ++p) {
    std::int64_t cell = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      const double g = std::floor(static_cast<double>(x(p, d)) / static_cast<double>(dx));
      cell =
          cell * cells[d] + static_cast<std::int64_t>(std::clamp(g, 0.0, static_cast<double>(cells[d] - 1)));
    }
    cell_of[static_cast<std::size_t>(p)] = static_cast<std::uint32_t>(cell);
    ++begin[static_cast<std::size_t>(cell) + 1];
  }
  for (std::size_t c = 1; c < begin.size(); ++c) begin[c] += begin[c - 1];
  std::vector<std::uint32_t> order(static_cast<std::size_t>(particles));
  for (std::size_t p = 0; p < order.size(); ++p) order[begin[cell_of[p]]++] = static_cast<std::uint32_t>(p);
  return order;
}

}  // namespace gpuphys::serial
