// What a build without CUDA has instead of the device: every entry point says so and skips.
#include "core/base/error.hpp"
#include "core/run/caller.hpp"
#include "core/run/gpu/ceilings.hpp"

namespace gpuphys {
namespace {

[[noreturn]] void skip() {
  throw Error(ExitCode::skipped, "no NVIDIA GPU: this build has no CUDA (nvcc was not found)");
}

}  // namespace

void require_gpu() {
  skip();
}

std::unique_ptr<Caller> make_device_caller() {
  skip();
}

GpuIdentity gpu_identity() {
  skip();
}

Ceilings measure_ceilings() {
  skip();
}

void bring_clocks_up() {
  skip();
}

}  // namespace gpuphys
