// Input sets and invariants shared by the semi-Lagrangian advection tasks.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/task.hpp"

namespace gpuphys::mac_advection {

struct Grid {
  std::int64_t nx, ny, nz;
};

/// The task's contract.
Contract contract();

/// The public, hidden and smoke sets, and the hard cases that hold for every trace. Hard cases whose answer
/// depends on the scheme (the linear field) are the task's own.
std::vector<InputSet> input_sets();

/// A problem on `grid` with dx = 2^-8 m, dt = 2^-7 s and every component given by `value(c, i, j, k)`.
Problem problem_from(Grid grid,
                     const std::function<double(int, std::int64_t, std::int64_t, std::int64_t)>& value);

/// A linear velocity field u = A (x - centre) on a cube of `n` cells with |dt A| small enough that interior
/// points stay inside, and the check that interior faces equal A P(-dt A)(x - centre), where P(z) = sum_s
/// coefficients[s] z^s is the stability polynomial of the trace.
InputSet linear_field_set(std::int64_t n, std::vector<double> coefficients);

/// The paper's checks of ux, uy, uz with its tolerance, and the suite's local check of each.
std::vector<Check> checks(double tolerance, double local_tolerance, const std::string& why,
                          const std::string& local_why);

}  // namespace gpuphys::mac_advection
