// The suite's version, written into every file that leaves it. The single place where it is stated.
#pragma once

namespace gpuphys {

inline constexpr const char* kSuiteVersion = "0.1.0";

}  // namespace gpuphys
