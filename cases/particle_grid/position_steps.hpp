// Positions after a small move, judged in units of their own rounding.
#pragma once

#include <string>

#include "core/contract/task.hpp"

namespace gpuphys::position_steps {

/// The largest |x' - truth| over (one step of float32 at the larger of |x| and |x'|, plus `share` of the rms
/// displacement). `start` is the input that positions move from. The check is called <array>_steps.
Check steps_check(const std::string& array, const std::string& start, double share, double tolerance,
                  const std::string& why);

}  // namespace gpuphys::position_steps
