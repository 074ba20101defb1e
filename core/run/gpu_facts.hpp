// What is known of a GPU: who it is, and what it can do at best.
#pragma once

#include <string>

namespace gpuphys {

struct GpuIdentity {
  std::string device;   ///< "NVIDIA H200"
  std::string driver;   ///< "580.159.04, CUDA 13.0"
  std::string toolkit;  ///< "nvcc 13.0.88, runtime 13.0"
};

struct Ceilings {
  double copy_GBps = 0;    ///< device-to-device copy, bytes read plus bytes written, 10^9 B/s
  double read_GBps = 0;    ///< reading alone
  double fp32_TFLOPs = 0;  ///< fused multiply-adds, two operations each
  double launch_us = 0;    ///< a launch of an empty kernel, back to back
  double l2_MiB = 0;       ///< size of the L2 cache: as much output need not reach memory within a call
};

}  // namespace gpuphys
