// Sees what a module asks of the device while its allocate() runs.
#pragma once

#include <string>

namespace gpuphys {

/// Counts driver-API calls that launch kernels, copy or set memory, on any thread, from start() to stop().
/// Uses CUPTI's callback interface, loaded at run time; nothing of it is active outside the two.
class AllocateWatch {
 public:
  /// False when CUPTI was not there at build time, cannot be loaded, or another tool occupies it.
  static bool available();

  /// Starts counting; returns whether it could.
  bool start();
  /// Stops counting. Returns "" when nothing was called, else e.g. "2 x cuLaunchKernel, 1 x cuMemsetD8_v2".
  std::string stop();

 private:
  void* subscriber_ = nullptr;
};

}  // namespace gpuphys
