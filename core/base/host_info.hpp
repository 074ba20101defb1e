// Names of the processors that results come from.
#pragma once

#include <string>

namespace gpuphys {

/// The host processor's model name, "unknown CPU" when the system does not tell.
std::string host_name();

}  // namespace gpuphys
