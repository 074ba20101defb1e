// Neighbour search of the serial baselines: cubic cells wherever there are points, found through a hash of
// their integer coordinates, each with a linked list of its points.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/contract/view.hpp"

namespace gpuphys::serial {

class CellLists {
 public:
  /// Lists the points `x` (n,3). Pairs closer than `cutoff` (> 0) lie in the same or in adjacent cells.
  CellLists(const View<const float, 2>& x, double cutoff) : n_(x.shape[0]) {
    // A little more than the cut-off, so that the rounding of a quotient cannot put a pair two cells apart.
    const double edge = 1.001 * cutoff;
    std::uint64_t buckets = 1;
    while (buckets < 2 * static_cast<std::uint64_t>(n_)) buckets *= 2;
    first_.assign(buckets, -1);
    next_.assign(static_cast<std::size_t>(n_), -1);
    cell_.resize(static_cast<std::size_t>(n_));
    for (std::int64_t i = 0; i < n_; ++i) {
      Cell& cell = cell_[static_cast<std::size_t>(i)];
      for (std::size_t c = 0; c < 3; ++c) {
        cell[c] = static_cast<std::int64_t>(std::floor(static_cast<double>(x(i, c)) / edge));
      }
    }
    // From the last to the first, so that lists run upwards.
    for (std::int64_t i = n_ - 1; i >= 0; --i) {
      std::int64_t& first = first_[bucket(cell_[static_cast<std::size_t>(i)])];
      next_[static_cast<std::size_t>(i)] = first;
      first = i;
    }
  }

  /// Calls body(i, j) once for every unordered pair in the same or in adjacent cells, i != j.
  template <class Body>
  void for_each_pair(Body&& body) const {
    for (std::int64_t i = 0; i < n_; ++i) {
      for (std::int64_t a = -1; a <= 1; ++a) {
        for (std::int64_t b = -1; b <= 1; ++b) {
          for (std::int64_t c = -1; c <= 1; ++c) {
            const Cell& own = cell_[static_cast<std::size_t>(i)];
            // Half of the neighbours; the pair meets again from the other side in the other half.
            if (std::array{a, b, c} < std::array<std::int64_t, 3>{0, 0, 0}) continue;
            const Cell other{own[0] + a, own[1] + b, own[2] + c};
            const bool same = a == 0 && b == 0 && c == 0;
            std::int64_t j = same ? next_[static_cast<std::size_t>(i)] : first_[bucket(other)];
            for (; j >= 0; j = next_[static_cast<std::size_t>(j)]) {
              if (cell_[static_cast<std::size_t>(j)] == other) body(i, j);
            }
          }
        }
      }
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;

  std::size_t bucket(const Cell& cell) const {
    std::uint64_t h = 0;
    for (const std::int64_t c : cell) h = (h ^ static_cast<std::uint64_t>(c)) * 0x9E3779B97F4A7C15ull;
    return static_cast<std::size_t>((h ^ (h >> 32)) & (first_.size() - 1));
  }

  std::int64_t n_;
  std::vector<std::int64_t> first_;  // of each bucket: its first point, or -1
  std::vector<std::int64_t> next_;   // of each point: the next one of its bucket, or -1
  std::vector<Cell> cell_;
};

}  // namespace gpuphys::serial
