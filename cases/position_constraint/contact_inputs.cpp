#include "cases/position_constraint/contact_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "core/base/error.hpp"
#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::position_constraint {
namespace {

// Random streams; attempt k > 0 of a particle takes 100 k more.
constexpr std::uint64_t kJitterStream = 0, kOrderStream = 99;

}  // namespace

void round_to_float(std::array<double, 3>& x) {
  for (double& c : x) c = static_cast<double>(static_cast<float>(c));
}

void fail_to_settle() {
  throw Error(ExitCode::internal, "contact_inputs: pairs at the search radius remain after 50 rounds");
}

std::vector<std::array<std::int32_t, 2>> near_pairs(const Positions& x, double radius) {
  using Cell = std::array<std::int64_t, 3>;
  std::vector<std::pair<Cell, std::int32_t>> sorted(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d)
      sorted[i].first[d] = static_cast<std::int64_t>(std::floor(x[i][d] / (1.0001 * radius)));
    sorted[i].second = static_cast<std::int32_t>(i);
  }
  std::sort(sorted.begin(), sorted.end());
  std::vector<std::array<std::int32_t, 2>> pairs;
  for (std::int64_t dx = -1; dx <= 1; ++dx) {
    for (std::int64_t dy = -1; dy <= 1; ++dy) {
      // Cells in order have their neighbours in order: `begin` only goes forward.
      std::size_t begin = 0;
      for (const auto& [cell, i] : sorted) {
        const Cell first{cell[0] + dx, cell[1] + dy, cell[2] - 1}, last{first[0], first[1], cell[2] + 1};
        while (begin < sorted.size() && sorted[begin].first < first) ++begin;
        for (std::size_t k = begin; k < sorted.size() && sorted[k].first <= last; ++k) {
          const std::int32_t j = sorted[k].second;
          if (j <= i) continue;
          double square = 0;
          for (std::size_t d = 0; d < 3; ++d) {
            const double e = x[static_cast<std::size_t>(i)][d] - x[static_cast<std::size_t>(j)][d];
            square += e * e;
          }
          if (square < radius * radius) pairs.push_back({i, j});
        }
      }
    }
  }
  return pairs;
}

Positions folded_sheet(const FoldedSheet& f, double radius, double thickness) {
  constexpr double turn = 2 * std::numbers::pi;
  const std::int64_t n = f.rows * f.columns;
  const std::vector<std::int32_t> order = random_order(f.seed, kOrderStream, n);
  return clear_of_radius(n, radius, 1e-5 * thickness, [&](std::int64_t i, int attempt) {
    const std::int64_t q = order[static_cast<std::size_t>(i)], a = q / f.columns, b = q % f.columns;
    const std::int64_t layer = a / f.width, along = a % f.width;
    const double l = static_cast<double>(layer);
    const double x = static_cast<double>(layer % 2 == 0 ? along : f.width - 1 - along);
    const double y = static_cast<double>(b) - 0.5 * static_cast<double>(f.columns - 1);
    const double z =
        f.gap * l + 0.5 * f.warp * std::sin(turn * f.periods * x / static_cast<double>(f.width) + 2.1 * l) *
                        std::cos(turn * f.periods * y / static_cast<double>(f.columns) + 1.3 * l);
    std::array<double, 3> p{x, y, z};
    for (std::size_t d = 0; d < 3; ++d)
      p[d] += f.jitter * uniform11(f.seed, kJitterStream + 100 * static_cast<std::uint64_t>(attempt),
                                   3 * static_cast<std::uint64_t>(q) + d);
    return p;
  });
}

Check left_in_place_check(double tolerance, const std::string& why) {
  return worst_over(
      {.name = "left_in_place",
       .kind = CheckKind::paper,
       .array = "x_new",
       .quantity = "largest |x_new - x| along an axis of particles that the truth leaves in place, m",
       .tolerance = tolerance,
       .why = why},
      [](const Judged& j) {
        const HostArray &x = input(j, "x"), &got = output(j, "x_new"), &expected = truth(j, "x_new");
        return Items{x.size(),
                     [&](std::int64_t i) {
                       const std::int64_t first = i / 3 * 3;
                       for (std::int64_t d = first; d < first + 3; ++d) {
                         if (expected.value(d) != x.value(d)) return 0.0;
                       }
                       return got.value(i) - x.value(i);
                     },
                     [&](std::int64_t i) {
                       return fmt::format("{}: from {:.9g} to {:.9g}", index_text(got, i), x.value(i),
                                          got.value(i));
                     }};
      });
}

Check within_units_check(const std::string& array, int exponent, double tolerance, const std::string& why) {
  return worst_over(
      {.name = "within_units",
       .kind = CheckKind::invariant,
       .array = array,
       .quantity = fmt::format("largest error of {} / unit in the last place at 2^{}", array, exponent),
       .tolerance = tolerance,
       .why = why},
      [array, exponent](const Judged& j) {
        const HostArray &got = output(j, array), &expected = truth(j, array);
        return Items{got.size(),
                     [&, exponent](std::int64_t i) {
                       const double e = static_cast<double>(static_cast<float>(expected.value(i)));
                       return (got.value(i) - e) * std::ldexp(1.0, 23 - exponent);
                     },
                     [&](std::int64_t i) {
                       return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, i), got.value(i),
                                          expected.value(i));
                     }};
      });
}

}  // namespace gpuphys::position_constraint
