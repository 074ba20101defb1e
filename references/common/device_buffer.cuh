// Owning buffers for the scratch memory of references. They allocate in allocate() and free when the solver
// goes.
#pragma once

#include <cstddef>
#include <utility>

#include "core/contract/module.hpp"

namespace gpuphys {

/// `count` elements of device memory, uninitialised. Never null, so that an empty problem has a valid
/// pointer.
template <class T>
class DeviceBuffer {
 public:
  DeviceBuffer() = default;
  explicit DeviceBuffer(std::size_t count) {
    GPUPHYS_CUDA(cudaMalloc(&data_, sizeof(T) * (count ? count : 1)));
  }
  DeviceBuffer(DeviceBuffer&& o) noexcept : data_(o.data_) { o.data_ = nullptr; }
  DeviceBuffer& operator=(DeviceBuffer&& o) noexcept {
    std::swap(data_, o.data_);
    return *this;
  }
  ~DeviceBuffer() { cudaFree(data_); }
  T* get() const { return data_; }

 private:
  T* data_ = nullptr;
};

/// The same in page-locked host memory.
template <class T>
class PinnedBuffer {
 public:
  PinnedBuffer() = default;
  explicit PinnedBuffer(std::size_t count) {
    GPUPHYS_CUDA(cudaMallocHost(&data_, sizeof(T) * (count ? count : 1)));
  }
  PinnedBuffer(PinnedBuffer&& o) noexcept : data_(o.data_) { o.data_ = nullptr; }
  PinnedBuffer& operator=(PinnedBuffer&& o) noexcept {
    std::swap(data_, o.data_);
    return *this;
  }
  ~PinnedBuffer() { cudaFreeHost(data_); }
  T* get() const { return data_; }

 private:
  T* data_ = nullptr;
};

}  // namespace gpuphys
