// CUDA runtime calls whose failure reaches the user as one line: the call, what went wrong, where.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <string>

#include "core/base/error.hpp"

namespace gpuphys {

/// Throws Error(cuda_error), or Error(out_of_memory) for a failed allocation, unless `status` is success. The
/// runtime's own record of the error is cleared.
void check_cuda(cudaError_t status, const char* call, const char* file, int line);
#define GPUPHYS_CUDA_CALL(call) ::gpuphys::check_cuda((call), #call, __FILE__, __LINE__)

/// "cudaErrorIllegalAddress: an illegal memory access was encountered".
std::string cuda_error_text(cudaError_t);

/// Device memory that frees itself. Contents are undefined after construction.
class DeviceMemory {
 public:
  DeviceMemory() = default;
  /// Throws Error(out_of_memory) saying for what, how much was asked and how much is free.
  DeviceMemory(std::size_t bytes, const std::string& what);
  ~DeviceMemory();
  DeviceMemory(DeviceMemory&& other) noexcept;
  DeviceMemory& operator=(DeviceMemory&& other) noexcept;

  unsigned char* data() const { return data_; }
  std::size_t bytes() const { return bytes_; }

 private:
  unsigned char* data_ = nullptr;
  std::size_t bytes_ = 0;
};

/// A pair-wise timer needs events that free themselves.
class DeviceEvent {
 public:
  DeviceEvent();
  ~DeviceEvent();
  DeviceEvent(const DeviceEvent&) = delete;
  DeviceEvent& operator=(const DeviceEvent&) = delete;
  cudaEvent_t get() const { return event_; }

 private:
  cudaEvent_t event_ = nullptr;
};

}  // namespace gpuphys
