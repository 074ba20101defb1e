// Particles in contact for the XPBD tasks: a folded sheet, and checks that the contact tasks share.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/contract/task.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::position_constraint {

using Positions = std::vector<std::array<double, 3>>;

/// A sheet of `rows` x `columns` particles at unit spacing, folded like a fan into layers of `width` rows
/// each, one above the other; the columns run along y, which is centred.
struct FoldedSheet {
  std::int64_t rows = 1024, columns = 1024, width = 128;
  double gap = 0.70;     ///< mean distance of the layers, m
  double warp = 0.35;    ///< height of the waves in them, m
  double periods = 3;    ///< of the waves, along both sides of a layer
  double jitter = 0.02;  ///< largest random displacement along each axis, m
  std::uint64_t seed = 1;
};

/// The sheet's particles in random order, rounded to float32. Those of pairs whose distance is within 1e-5
/// `thickness` of `radius` are drawn anew, and others likewise.
Positions folded_sheet(const FoldedSheet&, double radius, double thickness);

/// Draws positions with `draw(particle, attempt)`, rounds them to float32, and draws again one particle of
/// each pair whose distance is within `clear` of `radius`, until there is none. Throws Error(internal) if
/// that does not end.
template <class Draw>
Positions clear_of_radius(std::int64_t n, double radius, double clear, Draw&& draw);

/// Pairs (i, j), i < j, of positions nearer than `radius`.
std::vector<std::array<std::int32_t, 2>> near_pairs(const Positions&, double radius);

/// Largest |x_new - x| along an axis, m, of the particles that the truth leaves where they are.
Check left_in_place_check(double tolerance, const std::string& why);
/// Largest error of a coordinate of `array` in units of the last place of float32 at 2^`exponent`.
Check within_units_check(const std::string& array, int exponent, double tolerance, const std::string& why);

// ---- implementation ----

void round_to_float(std::array<double, 3>&);
[[noreturn]] void fail_to_settle();

template <class Draw>
Positions clear_of_radius(std::int64_t n, double radius, double clear, Draw&& draw) {
  Positions x(static_cast<std::size_t>(n));
  std::vector<int> attempt(static_cast<std::size_t>(n), 0);
  std::vector<std::int32_t> bad(static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < bad.size(); ++i) bad[i] = static_cast<std::int32_t>(i);
  for (int round = 0; round < 50; ++round) {
    for (const std::int32_t i : bad) {
      const auto at = static_cast<std::size_t>(i);
      x[at] = draw(static_cast<std::int64_t>(i), attempt[at]++);
      round_to_float(x[at]);
    }
    bad.clear();
    for (const auto& [i, j] : near_pairs(x, radius + clear)) {
      double square = 0;
      for (std::size_t d = 0; d < 3; ++d) {
        const double e = x[static_cast<std::size_t>(i)][d] - x[static_cast<std::size_t>(j)][d];
        square += e * e;
      }
      if (square > (radius - clear) * (radius - clear)) bad.push_back(i);
    }
    if (bad.empty()) return x;
  }
  fail_to_settle();
}

}  // namespace gpuphys::position_constraint
