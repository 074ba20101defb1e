// What this GPU can do at best, measured in the process that also measures a module, and who it is.
#pragma once

#include <map>
#include <string>

namespace gpuphys {

struct GpuIdentity {
  std::string device;   ///< "NVIDIA H200"
  std::string slug;     ///< "nvidia-h200", the folder of its records
  std::string driver;   ///< "580.159.04, CUDA 13.0"
  std::string toolkit;  ///< "nvcc 13.0.88, runtime 13.0"
};

/// The current device. Throws Error(skipped, "no NVIDIA GPU: <reason>") without one.
GpuIdentity gpu_identity();

struct Ceilings {
  double copy_GBps = 0;    ///< device-to-device copy, bytes read plus bytes written, 10^9 B/s
  double read_GBps = 0;    ///< reading alone
  double fp32_TFLOPs = 0;  ///< fused multiply-adds, two operations each
  double launch_us = 0;    ///< a launch of an empty kernel, back to back
  double l2_MiB = 0;       ///< size of the L2 cache: as much output need not reach memory within a call
};

/// As the "ceilings" object of a timing result. (In core/timing.cpp, which every build has.)
std::map<std::string, double> ceilings_map(const Ceilings&);

/// Measures all of them, the clocks brought up first. Each is the best of several repetitions: a ceiling, not
/// a typical value. Takes about a second and 2 GiB of device memory. Throws Error(skipped) without a GPU.
Ceilings measure_ceilings();

/// Keeps the device busy until its clocks are up: at least 0.3 s the first time in a process (an idle H200
/// runs at 345 MHz, a busy one at 1980), later until a fixed piece of work is again as fast as it has been
/// (at most 0.5 s; about a millisecond when the clocks never went down).
void bring_clocks_up();

}  // namespace gpuphys
