// Checks of a force field whose components fx, fy, fz are three arrays but one quantity.
#pragma once

#include <string>

#include "core/judge/checks.hpp"

namespace gpuphys::force {

/// ||g - r|| / ||r|| with the norm over all three components: force_rel_l2.
Check relative_l2(double tolerance, const std::string& why);

/// The largest error of a component over the rms of a component: force_local.
Check local(double tolerance, const std::string& why);

}  // namespace gpuphys::force
