// What the label of a module says: its role, and the lane that its results belong to. Nothing else does: no
// file is asked, so that none can claim to be a reference.
#pragma once

#include <string>

namespace gpuphys {

/// Labels of correct runs of the reference that round differently: other block sizes, a second run, the items
/// in another order.
inline constexpr const char* kOtherBlocks = "blocks";
inline constexpr const char* kRunAgain = "reference.again";
inline constexpr const char* kPermuted = "reference.permuted";
/// The reference built with --use_fast_math: judged and reported, not required to pass.
inline constexpr const char* kFastMath = "fast_math";

/// "reference", "fmad", "fast_math", "baseline", "mutant" or "user". Scalars that a sweep set
/// ("reference@tol=1e-4") change nothing.
std::string role_of(const std::string& label);
/// "cpu", "gpu" or "user" (whatever is not the suite's).
std::string lane_of(const std::string& label);
/// The label of the module that was run: "reference" for "reference.permuted" and "reference@tol=1e-4".
std::string module_of(const std::string& label);

}  // namespace gpuphys
