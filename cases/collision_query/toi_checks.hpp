// What the collision tasks share besides their inputs: the checks of times of impact, and scenes put together
// by hand.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::toi {

/// Relative L2 error of toi - 1, truth rounded to float32 ("toi_minus_1_rel_l2").
Check minus_1_rel_l2(double tolerance);
/// Largest error of toi ("toi_local").
Check local(double tolerance, const std::string& why);
/// Primitives with times more than 1e-3 apart ("toi_mismatched_events"): none.
Check mismatched_events();
/// Every time within [0, 1].
Check within_the_step();
/// Every time equals what `expected` says of its primitive, within `tolerance`.
Check known_times(const std::string& name, double tolerance, const std::string& why,
                  std::function<double(std::int64_t)> expected);
/// Every time is 1.
Check no_events(const std::string& why);

/// A hard case whose times besides lie within the step.
InputSet hard(const std::string& stress, const std::string& about, std::function<Problem()> make,
              std::vector<Check> invariants, bool use_task_checks);

/// Sizes and sheets of the public and the hidden sets.
cloth_sheets::Parameters public_sheets(std::int64_t n, double jitter);
cloth_sheets::Parameters hidden_sheets(std::int64_t n, double jitter);

/// Fills x0, x1 and, with more than one corner, the array of primitives of a problem of this contract, and d.
Problem problem_from(const Contract& contract, const cloth_sheets::Mesh& mesh, double d = 0);

/// Adds a vertex; returns its number.
std::int32_t add_vertex(cloth_sheets::Mesh& mesh, const cloth_sheets::Point& start,
                        const cloth_sheets::Point& end);

/// Vertices that are drawn independently at both times, uniformly within `size` of the origin along each
/// axis: what they carry turns over. Ambiguous events removed.
void tumble(cloth_sheets::Mesh& mesh, std::int64_t vertices, double d, double size, std::uint64_t seed);

/// The mesh with all coordinates multiplied by a power of two.
cloth_sheets::Mesh scaled(cloth_sheets::Mesh mesh, double factor);

/// The sheets moved by `offset` along each axis, where positions are coarser: vertices of ambiguous pairs are
/// drawn anew within `shake`.
cloth_sheets::Mesh far_sheets(const cloth_sheets::Parameters&, int corners, double d, double offset,
                              double shake);

}  // namespace gpuphys::toi
