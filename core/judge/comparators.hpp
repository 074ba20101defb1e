// The measures that judge. FP64 arithmetic throughout, no fast-math, and nothing that NaN can pass.
#pragma once

#include <string>

#include "core/contract/arrays.hpp"
#include "core/contract/task.hpp"

namespace gpuphys {

/// `error` passes `tolerance`: finite and not above it.
bool passes(double error, double tolerance);

/// Relative L2 error ||g - r|| / ||r|| of float32 `got` against truth rounded to float32; ||g - r|| when
/// ||r|| = 0. Returns NaN for non-finite values on either side, and throws Error(internal) when shapes
/// differ.
Measured relative_l2(const HostArray& got, const HostArray& truth);

/// As relative_l2() but against the unrounded FP64 truth: the error that the report plots.
double truth_gap(const HostArray& got, const HostArray& truth);

/// Largest |g - r| over the rms of r (over 1 when the rms is 0), with the worst index and both values in
/// `detail`.
Measured max_error_over_rms(const HostArray& got, const HostArray& truth);

/// Number of elements for which |g - r| > bound * rms(r). Non-finite elements count.
Measured count_above(const HostArray& got, const HostArray& truth, double bound);

/// Ready-made checks for one output array.
Check relative_l2_check(const std::string& array, double tolerance, const std::string& why);
Check local_error_check(const std::string& array, double tolerance, const std::string& why);

/// "ux[3,4,5]" for a flat index.
std::string index_text(const HostArray&, std::int64_t flat);

}  // namespace gpuphys
