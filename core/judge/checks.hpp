// The vocabulary that case files state their checks with. Each measure here is tested once for NaN, Inf,
// empty arrays and wrong shapes, so that no case file holds a loop over outputs of its own: a comparison that
// NaN slips through is then impossible to write.
//
//     count_where({.name = "mismatches", .array = "force", .quantity = "grains with a force on one side
//     only",
//                  .tolerance = 0.5, .why = "rounding decides none: ..."},
//                 [](const Judged& j) {
//                   const auto& force = output(j, "force");
//                   return Items{force.shape()[0], [&](std::int64_t i) { return ...; }};
//                 });
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/contract/task.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys {

/// What people read of a check, and its tolerance.
struct CheckText {
  std::string name;  ///< unique within the task, snake_case
  CheckKind kind = CheckKind::local;
  std::string array;     ///< the output that is looked at (or several, "x, v")
  std::string quantity;  ///< what is measured of it, with its unit
  double tolerance = 0;
  std::string why;  ///< where the tolerance comes from
  bool needs_truth = true;
};

/// The arrays of what is judged; throw Error(bad_input) when one is missing.
const HostArray& output(const Judged&, const std::string& name);
const HostArray& truth(const Judged&, const std::string& name);
const HostArray& input(const Judged&, const std::string& name);

/// One figure per item (a particle, a cell, an element of an array). `describe`, if given, says of an item
/// what a person would ask; it is called for one item only.
struct Items {
  std::int64_t count = 0;
  std::function<double(std::int64_t item)> value;
  std::function<std::string(std::int64_t item)> describe = {};
};
using ItemsOf = std::function<Items(const Judged&)>;

/// The largest |value| over the items; 0 without items. The first value that is not finite is the result.
Check worst_over(CheckText, ItemsOf);

/// The number of items whose value is not zero: return 1 for "wrong". NaN counts.
Check count_where(CheckText, ItemsOf);

/// One vector per item, of a quantity whose sum is known.
struct Terms {
  std::int64_t count = 0;
  std::function<std::array<double, 3>(std::int64_t item)> term;
  std::array<double, 3> expected = {0, 0, 0};
  /// What the difference is divided by; 0: the sum of the terms' lengths (nothing is divided if that is 0).
  double scale = 0;
};
using TermsOf = std::function<Terms(const Judged&)>;

/// |sum of the terms - expected| / scale, in FP64.
Check conserved_sum(CheckText, TermsOf);

/// Every element of an output is +0 or -0.
Check exactly_zero(const std::string& array, const std::string& why, const std::string& name = "");

/// The largest |output - known| / scale over the elements; `known` returns one value per element of `array`.
/// `scale` 0: the largest |known| (1 if that is 0).
Check equals_known(CheckText, std::function<std::vector<double>(const Judged&)> known, double scale = 0);

/// Every element lies in [low, high]: the largest distance to it.
Check within(const std::string& array, double low, double high, const std::string& why,
             const std::string& name = "");

/// Errors of a change: of (output - start) against (truth - start), where `start` is an input of the same
/// shape. The relative L2 norm is called <array>_change_rel_l2, the largest error over the rms
/// <array>_change_local.
Check relative_l2_of_change(const std::string& array, const std::string& start, double tolerance,
                            const std::string& why);
Check local_error_of_change(const std::string& array, const std::string& start, double tolerance,
                            const std::string& why);

/// As relative_l2_check() and local_error_check() under other names and kinds: for the tighter bounds of
/// small sets.
Check as_invariant(Check, const std::string& name, double tolerance, const std::string& why);

}  // namespace gpuphys
