// A spatial numbering of particles that come in arbitrary order: by the Morton code of their cell, so that
// particles close in space are close in memory and their neighbours are found in the caches.
//
// Cells are 1/256 of the largest extent of the particles: three radix passes of eight bits. Nothing depends
// on the number of particles in a cell. What bounds it: the sort, 3 passes over 8 bytes a particle.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::spatial {

constexpr int kBitsPerAxis = 8;
constexpr int kBoundBlocks = 1056;  // eight a multiprocessor of an H200

/// Lowest and highest corner, in an encoding whose order as unsigned integers is that of the floats.
struct Bounds {
  std::uint32_t low[3], high[3];
};

__device__ __forceinline__ std::uint32_t encode(float f) {
  const std::uint32_t bits = __float_as_uint(f);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

__device__ __forceinline__ float decode(std::uint32_t code) {
  return __uint_as_float(code & 0x80000000u ? code & 0x7fffffffu : ~code);
}

/// Widens `bounds` (low all ones, high zero before) to hold all particles.
__global__ void find_bounds(const float* __restrict__ x, int n, Bounds* bounds) {
  std::uint32_t low[3] = {~0u, ~0u, ~0u}, high[3] = {0u, 0u, 0u};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < n; i += stride) {
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const std::uint32_t code = encode(x[3 * i + d]);
      low[d] = min(low[d], code);
      high[d] = max(high[d], code);
    }
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    low[d] = __reduce_min_sync(0xffffffffu, low[d]);
    high[d] = __reduce_max_sync(0xffffffffu, high[d]);
  }
  if (threadIdx.x % 32 != 0) return;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    atomicMin(&bounds->low[d], low[d]);
    atomicMax(&bounds->high[d], high[d]);
  }
}

/// The bits of `v` (below 2^8) with two zeros between each and the next.
__device__ __forceinline__ std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | v << 8) & 0x0000f00fu;
  v = (v | v << 4) & 0x000c30c3u;
  return (v | v << 2) & 0x00249249u;
}

/// Morton code of every particle's cell, and the numbers 0..n-1.
__global__ void make_keys(const float* __restrict__ x, int n, const Bounds* __restrict__ bounds,
                          std::uint32_t* __restrict__ key, std::uint32_t* __restrict__ index) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  float low[3], extent = 0.0f;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    low[d] = decode(bounds->low[d]);
    extent = fmaxf(extent, decode(bounds->high[d]) - low[d]);
  }
  constexpr float cells = 1 << kBitsPerAxis;
  const float per_metre = extent > 0.0f ? cells / extent : 0.0f;
  std::uint32_t code = 0;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const float cell = fminf((x[3 * i + d] - low[d]) * per_metre, cells - 1.0f);
    code |= spread_bits(static_cast<std::uint32_t>(cell)) << d;
  }
  key[i] = code;
  index[i] = static_cast<std::uint32_t>(i);
}

/// number[order[k]] = k.
__global__ void invert(const std::uint32_t* __restrict__ order, int n, std::int32_t* __restrict__ number) {
  const int k = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (k < n) number[order[k]] = k;
}

/// The numbering of up to `n` particles, in memory of its own.
class Order {
 public:
  Order() = default;
  explicit Order(int n)
      : bounds_(1),
        key_(static_cast<std::size_t>(n)),
        sorted_key_(static_cast<std::size_t>(n)),
        index_(static_cast<std::size_t>(n)),
        order_(static_cast<std::size_t>(n)),
        number_(static_cast<std::size_t>(n)),
        scratch_bytes_(primitives::sort_pairs_bytes(n)),
        scratch_(scratch_bytes_) {}

  void build(const float* x, int n, int threads) const {
    GPUPHYS_CUDA(cudaMemsetAsync(bounds_.get()->low, 0xff, sizeof bounds_.get()->low));
    GPUPHYS_CUDA(cudaMemsetAsync(bounds_.get()->high, 0, sizeof bounds_.get()->high));
    const int blocks = (n + threads - 1) / threads;
    find_bounds<<<static_cast<unsigned>(blocks < kBoundBlocks ? blocks : kBoundBlocks), threads>>>(
        x, n, bounds_.get());
    make_keys<<<static_cast<unsigned>(blocks), threads>>>(x, n, bounds_.get(), key_.get(), index_.get());
    primitives::sort_pairs(scratch_.get(), scratch_bytes_, key_.get(), sorted_key_.get(), index_.get(),
                           order_.get(), n, 0, 3 * kBitsPerAxis);
    invert<<<static_cast<unsigned>(blocks), threads>>>(order_.get(), n, number_.get());
  }

  const std::uint32_t* order() const { return order_.get(); }   ///< (n): the particle at each new place
  const std::int32_t* number() const { return number_.get(); }  ///< (n): the new place of each particle

 private:
  DeviceBuffer<Bounds> bounds_;
  DeviceBuffer<std::uint32_t> key_, sorted_key_, index_, order_;
  DeviceBuffer<std::int32_t> number_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::spatial
