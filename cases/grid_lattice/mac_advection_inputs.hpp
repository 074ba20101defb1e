// Input sets and invariants shared by the semi-Lagrangian advection tasks.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/contract/task.hpp"

namespace gpuphys::mac_advection {

struct Grid {
  std::int64_t nx, ny, nz;
};

/// The task's contract.
Contract contract();

/// What the inputs and invariants of a task depend on.
struct Scheme {
  int velocity_evaluations;  ///< a face; each adds its rounding to the departure point
  /// P(z), lowest power first: in a linear field u = A x, where interpolation is exact, the scheme yields
  /// A P(-dt A) x.
  std::vector<double> polynomial;
  bool limited = false;  ///< by the samples around the departure point: not continuous in that point
};

/// A problem on `grid` with dx = 2^-8 m, dt = 2^-7 s and every component given by `value(c, i, j, k)`.
Problem problem_from(Grid grid,
                     const std::function<double(int, std::int64_t, std::int64_t, std::int64_t)>& value);

/// A task with the family's contract and inputs: the public, hidden and smoke sets, and the hard cases.
/// Title, checks and target are left to the task.
Task family_task(const std::string& name, int paper_number, const Scheme& scheme);

/// The same with the checks of the schemes that only interpolate at a departure point: the paper's of ux, uy,
/// uz and the suite's local check of each. Title and target are left to the task.
Task semi_lagrangian_task(const std::string& name, int paper_number, const Scheme& scheme);

}  // namespace gpuphys::mac_advection
