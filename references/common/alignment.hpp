// Arrays that kernels read by 16 bytes: the module interface promises the alignment of their elements only.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <string>

namespace gpuphys {

/// Throws, naming `task` and `array`, unless `data` is aligned to 16 bytes.
inline void require_aligned(const char* task, const char* array, const void* data) {
  if (reinterpret_cast<std::uintptr_t>(data) % 16 != 0)
    throw std::runtime_error(std::string(task) + ": " + array + " is not aligned to 16 bytes");
}

}  // namespace gpuphys
