#include "core/run/gpu/ceilings.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <chrono>
#include <limits>
#include <string>

#include "core/run/gpu/cuda_call.hpp"
#include "core/run/gpu/device_kernels.hpp"

// Free of fmt and JSON headers: nvcc has to read this file.

namespace gpuphys {

namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

int current_device() {
  int device = 0;
  GPUPHYS_CUDA_CALL(cudaGetDevice(&device));
  return device;
}

int attribute(cudaDeviceAttr which) {
  int value = 0;
  GPUPHYS_CUDA_CALL(cudaDeviceGetAttribute(&value, which, current_device()));
  return value;
}

std::string version_text(int version) {
  return std::to_string(version / 1000) + "." + std::to_string(version % 1000 / 10);
}

// The driver's own version number comes from its management library, which every driver installs; without it
// the CUDA version that the driver supports has to do.
std::string driver_release() {
  void* nvml = dlopen("libnvidia-ml.so.1", RTLD_NOW | RTLD_LOCAL);
  if (nvml == nullptr) return "";
  const auto init = reinterpret_cast<int (*)()>(dlsym(nvml, "nvmlInit_v2"));
  const auto version = reinterpret_cast<int (*)(char*, unsigned)>(dlsym(nvml, "nvmlSystemGetDriverVersion"));
  const auto shutdown = reinterpret_cast<int (*)()>(dlsym(nvml, "nvmlShutdown"));
  std::string release;
  if (init != nullptr && version != nullptr && shutdown != nullptr && init() == 0) {
    char text[96] = "";
    if (version(text, sizeof text) == 0) release = text;
    shutdown();
  }
  dlclose(nvml);
  return release;
}

// Milliseconds of `work` on the legacy stream.
template <class Work>
double device_ms(const DeviceEvent& start, const DeviceEvent& stop, Work&& work) {
  GPUPHYS_CUDA_CALL(cudaEventRecord(start.get()));
  work();
  GPUPHYS_CUDA_CALL(cudaEventRecord(stop.get()));
  GPUPHYS_CUDA_CALL(cudaEventSynchronize(stop.get()));
  float ms = 0;
  GPUPHYS_CUDA_CALL(cudaEventElapsedTime(&ms, start.get(), stop.get()));
  return static_cast<double>(ms);
}

template <class Work>
double best_ms(const DeviceEvent& start, const DeviceEvent& stop, int repetitions, Work&& work) {
  double best = std::numeric_limits<double>::infinity();
  for (int i = 0; i < repetitions; ++i) best = std::min(best, device_ms(start, stop, work));
  return best;
}

constexpr std::size_t kCopyBytes = std::size_t{1} << 30;  // read once and written once: 2.1e9 bytes moved
constexpr int kRepetitions = 20;
constexpr int kLaunches = 1000;
constexpr int kFlopRounds = 16384;

// One piece of clock work: about 0.25 ms at 1980 MHz on 132 multiprocessors.
constexpr int kClockRounds = 4096;
constexpr double kFirstBusySeconds = 0.3;
constexpr double kMaxBusySeconds = 0.5;
constexpr double kClockTolerance = 1.03;

}  // namespace

void require_gpu() {
  int count = 0;
  const cudaError_t status = cudaGetDeviceCount(&count);
  (void)cudaGetLastError();
  if (status != cudaSuccess)
    throw Error(ExitCode::skipped, std::string("no NVIDIA GPU: ") + cudaGetErrorString(status));
  if (count == 0) throw Error(ExitCode::skipped, "no NVIDIA GPU: the driver lists no device");
}

GpuIdentity gpu_identity() {
  GpuIdentity id;
  require_gpu();
  cudaDeviceProp properties;
  GPUPHYS_CUDA_CALL(cudaGetDeviceProperties(&properties, current_device()));
  id.device = properties.name;
  int driver = 0, runtime = 0;
  GPUPHYS_CUDA_CALL(cudaDriverGetVersion(&driver));
  GPUPHYS_CUDA_CALL(cudaRuntimeGetVersion(&runtime));
  const std::string release = driver_release();
  id.driver = (release.empty() ? "" : release + ", ") + "CUDA " + version_text(driver);
  id.toolkit = "nvcc " + std::to_string(__CUDACC_VER_MAJOR__) + "." + std::to_string(__CUDACC_VER_MINOR__) +
               "." + std::to_string(__CUDACC_VER_BUILD__) + ", runtime " + version_text(runtime);
  return id;
}

void bring_clocks_up() {
  static double best = std::numeric_limits<double>::infinity();
  static bool first = true;
  static const int multiprocessors = attribute(cudaDevAttrMultiProcessorCount);
  const DeviceEvent start, stop;
  const auto began = Clock::now();
  const double at_least = first ? kFirstBusySeconds : 0;
  for (;;) {
    const double ms =
        device_ms(start, stop, [] { device::multiply_add(multiprocessors, kClockRounds, nullptr); });
    const bool up = ms <= best * kClockTolerance;
    best = std::min(best, ms);
    const double busy = seconds_since(began);
    if ((up && busy >= at_least) || busy >= kMaxBusySeconds) break;
  }
  first = false;
}

Ceilings measure_ceilings() {
  require_gpu();
  Ceilings c;
  const DeviceMemory from(kCopyBytes, "measuring the copy bandwidth");
  const DeviceMemory to(kCopyBytes, "measuring the copy bandwidth");
  const DeviceEvent start, stop;
  // Written first: unwritten memory may be served without touching DRAM.
  GPUPHYS_CUDA_CALL(cudaMemset(from.data(), 0x5A, kCopyBytes));
  GPUPHYS_CUDA_CALL(cudaMemset(to.data(), 0x3C, kCopyBytes));
  const int multiprocessors = attribute(cudaDevAttrMultiProcessorCount);
  bring_clocks_up();

  const double by_runtime = best_ms(start, stop, kRepetitions, [&] {
    GPUPHYS_CUDA_CALL(cudaMemcpyAsync(to.data(), from.data(), kCopyBytes, cudaMemcpyDeviceToDevice));
  });
  const double by_kernel =
      best_ms(start, stop, kRepetitions, [&] { device::copy(to.data(), from.data(), kCopyBytes); });
  c.copy_GBps = 2.0 * kCopyBytes / (std::min(by_runtime, by_kernel) * 1e6);
  c.read_GBps =
      kCopyBytes / (1e6 * best_ms(start, stop, kRepetitions, [&] {
                      device::read_all(from.data(), kCopyBytes, reinterpret_cast<std::uint32_t*>(to.data()));
                    }));

  double flops = 0;
  const double fma_ms = best_ms(start, stop, kRepetitions,
                                [&] { flops = device::multiply_add(multiprocessors, kFlopRounds, nullptr); });
  c.fp32_TFLOPs = flops / (fma_ms * 1e9);

  double launch = std::numeric_limits<double>::infinity();
  for (int i = 0; i < kRepetitions; ++i) {
    const auto began = Clock::now();
    for (int l = 0; l < kLaunches; ++l) device::empty();
    GPUPHYS_CUDA_CALL(cudaDeviceSynchronize());
    launch = std::min(launch, seconds_since(began) / kLaunches);
  }
  c.launch_us = 1e6 * launch;
  c.l2_MiB = attribute(cudaDevAttrL2CacheSize) / 1048576.0;
  return c;
}

}  // namespace gpuphys
