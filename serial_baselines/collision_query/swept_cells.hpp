// Broad phase of the serial collision baselines: boxes swept over the step, entered in every cell of a
// uniform grid that they touch.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/contract/view.hpp"

namespace gpuphys::serial {

/// Axis-aligned box; both sides belong to it.
struct SweptBox {
  std::array<float, 3> low, high;
};

/// The box of the vertices `v` at t = 0 and t = 1; positions are (n,3).
template <class Vertices>
SweptBox swept_box(View<const float, 2> x0, View<const float, 2> x1, const Vertices& vertices) {
  SweptBox box;
  for (std::size_t d = 0; d < 3; ++d) {
    box.low[d] = box.high[d] = x0(vertices[0], d);
    for (const std::int32_t v : vertices) {
      box.low[d] = std::min({box.low[d], x0(v, d), x1(v, d)});
      box.high[d] = std::max({box.high[d], x0(v, d), x1(v, d)});
    }
  }
  return box;
}

/// The box, wider on each side by `margin`.
inline SweptBox widened(SweptBox box, float margin) {
  for (std::size_t d = 0; d < 3; ++d) {
    box.low[d] -= margin;
    box.high[d] += margin;
  }
  return box;
}

/// Finds pairs of boxes that overlap.
class SweptCells {
 public:
  explicit SweptCells(std::vector<SweptBox> boxes) : boxes_(std::move(boxes)) {
    if (boxes_.empty()) return;
    double mean = 0;
    std::array<double, 3> high{};
    for (std::size_t d = 0; d < 3; ++d) {
      low_[d] = high[d] = boxes_[0].low[d];
      for (const SweptBox& b : boxes_) {
        low_[d] = std::min(low_[d], static_cast<double>(b.low[d]));
        high[d] = std::max(high[d], static_cast<double>(b.high[d]));
      }
    }
    for (const SweptBox& b : boxes_) {
      double extent = 0;
      for (std::size_t d = 0; d < 3; ++d)
        extent = std::max(extent, static_cast<double>(b.high[d]) - b.low[d]);
      mean += extent / static_cast<double>(boxes_.size());
    }
    // Cells of the mean extent, but no more of them than a few for each box.
    size_ = mean > 0 ? mean : 1;
    const double most = 2.0 * static_cast<double>(boxes_.size()) + 64;
    while (std::floor((high[0] - low_[0]) / size_ + 1) * std::floor((high[1] - low_[1]) / size_ + 1) *
               std::floor((high[2] - low_[2]) / size_ + 1) >
           most) {
      size_ *= 1.25;
    }
    for (std::size_t d = 0; d < 3; ++d) n_[d] = cell(high[d], d) + 1;
    first_.assign(static_cast<std::size_t>(n_[0] * n_[1] * n_[2] + 1), 0);
    for (const SweptBox& b : boxes_) each_cell(b, [&](std::size_t c) { ++first_[c + 1]; });
    for (std::size_t c = 1; c < first_.size(); ++c) first_[c] += first_[c - 1];
    items_.resize(static_cast<std::size_t>(first_.back()));
    std::vector<std::int64_t> next(first_);
    for (std::size_t i = 0; i < boxes_.size(); ++i) {
      each_cell(boxes_[i], [&](std::size_t c) {
        items_[static_cast<std::size_t>(next[c]++)] = static_cast<std::int64_t>(i);
      });
    }
  }

  /// Calls visit(i, j), i < j, once for every pair of boxes that overlap; with `groups` > 0 only for i <
  /// groups <= j.
  template <class Visit>
  void each_overlap(Visit&& visit, std::int64_t groups = 0) const {
    for (std::size_t c = 0; c + 1 < first_.size(); ++c) {
      for (std::int64_t p = first_[c]; p < first_[c + 1]; ++p) {
        for (std::int64_t q = p + 1; q < first_[c + 1]; ++q) {
          // Items of a cell are in order.
          const std::int64_t i = items_[static_cast<std::size_t>(p)], j = items_[static_cast<std::size_t>(q)];
          if (groups > 0 && (i >= groups || j < groups)) continue;
          const SweptBox &a = boxes_[static_cast<std::size_t>(i)], &b = boxes_[static_cast<std::size_t>(j)];
          std::array<double, 3> corner{};  // the lower corner of what they share
          bool overlap = true;
          for (std::size_t d = 0; d < 3; ++d) {
            corner[d] = std::max(a.low[d], b.low[d]);
            overlap = overlap && corner[d] <= std::min(a.high[d], b.high[d]);
          }
          // A pair meets in many cells; the one that holds the corner reports it.
          if (overlap && flat(cell(corner[0], 0), cell(corner[1], 1), cell(corner[2], 2)) == c) visit(i, j);
        }
      }
    }
  }

 private:
  std::int64_t cell(double x, std::size_t d) const {
    return static_cast<std::int64_t>(std::floor((x - low_[d]) / size_));
  }
  std::size_t flat(std::int64_t i, std::int64_t j, std::int64_t k) const {
    return static_cast<std::size_t>((i * n_[1] + j) * n_[2] + k);
  }
  template <class F>
  void each_cell(const SweptBox& b, F&& f) const {
    for (std::int64_t i = cell(b.low[0], 0); i <= cell(b.high[0], 0); ++i) {
      for (std::int64_t j = cell(b.low[1], 1); j <= cell(b.high[1], 1); ++j) {
        for (std::int64_t k = cell(b.low[2], 2); k <= cell(b.high[2], 2); ++k) f(flat(i, j, k));
      }
    }
  }

  std::vector<SweptBox> boxes_;
  std::array<double, 3> low_{};
  double size_ = 1;
  std::array<std::int64_t, 3> n_{};
  std::vector<std::int64_t> first_, items_;
};

}  // namespace gpuphys::serial
