#include "core/run/gpu/cuda_call.hpp"

#include <fmt/format.h>

#include <string_view>
#include <utility>

namespace gpuphys {

std::string cuda_error_text(cudaError_t status) {
  return fmt::format("{}: {}", cudaGetErrorName(status), cudaGetErrorString(status));
}

void check_cuda(cudaError_t status, const char* call, const char* file, int line) {
  if (status == cudaSuccess) return;
  (void)cudaGetLastError();
  // The path below the repository root is enough, and the same on every machine.
  std::string_view where(file);
  if (const std::size_t at = where.rfind("/core/"); at != std::string_view::npos) where.remove_prefix(at + 1);
  throw Error(status == cudaErrorMemoryAllocation ? ExitCode::out_of_memory : ExitCode::cuda_error,
              fmt::format("{} failed with {} ({}:{})", call, cuda_error_text(status), where, line));
}

DeviceMemory::DeviceMemory(std::size_t bytes, const std::string& what) : bytes_(bytes) {
  void* memory = nullptr;
  const cudaError_t status = cudaMalloc(&memory, bytes);
  if (status == cudaErrorMemoryAllocation) {
    (void)cudaGetLastError();
    std::size_t free = 0, total = 0;
    (void)cudaMemGetInfo(&free, &total);
    throw Error(ExitCode::out_of_memory,
                fmt::format("{}: {} MiB of device memory asked for, {} of {} MiB are free", what,
                            (bytes + (1u << 20) - 1) >> 20, free >> 20, total >> 20));
  }
  check_cuda(status, "cudaMalloc", __FILE__, __LINE__);
  data_ = static_cast<unsigned char*>(memory);
}

DeviceMemory::~DeviceMemory() {
  // Fails when a module's fault has destroyed the context; then there is nothing left to free.
  if (data_ != nullptr) (void)cudaFree(data_);
}

DeviceMemory::DeviceMemory(DeviceMemory&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}

DeviceMemory& DeviceMemory::operator=(DeviceMemory&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

DeviceEvent::DeviceEvent() {
  GPUPHYS_CUDA_CALL(cudaEventCreate(&event_));
}

DeviceEvent::~DeviceEvent() {
  (void)cudaEventDestroy(event_);
}

}  // namespace gpuphys
