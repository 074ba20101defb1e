// What a build without CUDA has instead of the device backend: every entry point says so and skips.
#include "core/error.hpp"
#include "core/gpu/ceilings.hpp"
#include "core/gpu/device_backend.hpp"
#include "core/harness.hpp"
#include "core/host_info.hpp"

namespace gpuphys {
namespace {

[[noreturn]] void skip() {
  throw Error(ExitCode::skipped, "no NVIDIA GPU: this build has no CUDA (nvcc was not found)");
}

}  // namespace

std::unique_ptr<Backend> make_device_backend() {
  skip();
}

bool allocate_is_watched() {
  return false;
}

std::string device_name() {
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
