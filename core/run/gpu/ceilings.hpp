// What this GPU can do at best, measured in the process that also measures a module, and who it is.
#pragma once

#include "core/run/gpu_facts.hpp"

namespace gpuphys {

/// Throws Error(skipped) with one line when there is no GPU.
void require_gpu();

/// The current device. Throws Error(skipped, "no NVIDIA GPU: <reason>") without one.
GpuIdentity gpu_identity();

/// Measures all of them, the clocks brought up first. Each is the best of several repetitions: a ceiling, not
/// a typical value. Takes about a second and 2 GiB of device memory. Throws Error(skipped) without a GPU.
Ceilings measure_ceilings();

/// Keeps the device busy until its clocks are up: at least 0.3 s the first time in a process (an idle H200
/// runs at 345 MHz, a busy one at 1980), later until a fixed piece of work is again as fast as it has been
/// (at most 0.5 s; about a millisecond when the clocks never went down).
void bring_clocks_up();

}  // namespace gpuphys
