// A spatial numbering of particles that come in arbitrary order: by a Morton code, so that particles close in
// space are close in memory and their neighbours are found in the caches.
//
// The bounding box is halved 24 times, each time across its longest side; a bit of the code says in which
// half the particle lies. So cells are nearly cubes whatever the shape of the box (a long roll of cloth), and
// three radix passes of eight bits sort them. Nothing depends on the number of particles in a cell. What
// bounds it: the sort, 3 passes over 8 bytes a particle.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::spatial {

constexpr int kKeyBits = 24, kKeyBytes = kKeyBits / 8;
constexpr int kGridBlocks = 264;  // two a multiprocessor of an H200
constexpr int kGridThreads = 1024;

/// Corners in an encoding whose order as unsigned integers is that of the floats; of the lowest one the
/// complement, so that both grow from zero.
struct Bounds {
  std::uint32_t low_complement[3], high[3];
};

__device__ __forceinline__ std::uint32_t encode(float f) {
  const std::uint32_t bits = __float_as_uint(f);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

__device__ __forceinline__ float decode(std::uint32_t code) {
  return __uint_as_float(code & 0x80000000u ? code & 0x7fffffffu : ~code);
}

/// Widens `bounds` (zero before) to hold all particles.
__global__ void __launch_bounds__(kGridThreads)
    find_bounds(const float* __restrict__ x, int n, Bounds* __restrict__ bounds) {
  __shared__ std::uint32_t block_bounds[6];
  if (threadIdx.x < 6) block_bounds[threadIdx.x] = 0;
  __syncthreads();
  std::uint32_t most[6] = {0, 0, 0, 0, 0, 0};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
#pragma unroll 4
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < n; i += stride) {
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const std::uint32_t code = encode(x[3 * i + d]);
      most[d] = max(most[d], ~code);
      most[3 + d] = max(most[3 + d], code);
    }
  }
#pragma unroll
  for (int k = 0; k < 6; ++k) {
    most[k] = __reduce_max_sync(0xffffffffu, most[k]);
    if (threadIdx.x % 32 == 0) atomicMax(block_bounds + k, most[k]);
  }
  __syncthreads();
  if (threadIdx.x < 3) atomicMax(bounds->low_complement + threadIdx.x, block_bounds[threadIdx.x]);
  if (threadIdx.x >= 3 && threadIdx.x < 6)
    atomicMax(bounds->high + threadIdx.x - 3, block_bounds[threadIdx.x]);
}

/// Morton code of every particle's cell, and the numbers 0..n-1. The bits of a place are spread by a table, a
/// byte at a time.
__global__ void __launch_bounds__(kGridThreads)
    make_keys(const float* __restrict__ x, int n, const Bounds* __restrict__ bounds,
              std::uint32_t* __restrict__ key, std::uint32_t* __restrict__ index) {
  __shared__ float low[3], scale[3];
  __shared__ int step_of[3 * kKeyBits];  // [side][how often halved before]: the step that halves it; or -1
  __shared__ std::uint32_t
      spread[3 * kKeyBytes * 256];  // [side][byte of the place][its value]: bits of the code
  const int tid = static_cast<int>(threadIdx.x);
  if (tid < 3 * kKeyBits) step_of[tid] = -1;
  __syncthreads();
  if (tid == 0) {
    float extent[3];
    int halved[3] = {0, 0, 0};
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      low[d] = decode(~bounds->low_complement[d]);
      extent[d] = decode(bounds->high[d]) - low[d];
      scale[d] = extent[d] > 0.0f ? (1 << kKeyBits) / extent[d] : 0.0f;
    }
    for (int s = 0; s < kKeyBits; ++s) {
      const int d = extent[0] >= extent[1] && extent[0] >= extent[2] ? 0 : extent[1] >= extent[2] ? 1 : 2;
#pragma unroll
      for (int a = 0; a < 3; ++a) {
        if (a != d) continue;
        step_of[a * kKeyBits + halved[a]++] = s;
        extent[a] *= 0.5f;
      }
    }
  }
  __syncthreads();
  for (int entry = tid; entry < 3 * kKeyBytes * 256; entry += static_cast<int>(blockDim.x)) {
    const int* const steps = step_of + entry / 256 * 8;  // of the eight bits of this byte
    std::uint32_t bits = 0;
#pragma unroll
    for (int b = 0; b < 8; ++b) {
      if (steps[b] >= 0 && (entry >> (7 - b) & 1)) bits |= 1u << (kKeyBits - 1 - steps[b]);
    }
    spread[entry] = bits;
  }
  __syncthreads();
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < n; i += stride) {
    std::uint32_t code = 0;
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const float f = fminf((x[3 * i + d] - low[d]) * scale[d], static_cast<float>((1 << kKeyBits) - 1));
      const auto place = static_cast<std::uint32_t>(f);  // in units of 2^-24 of the side
#pragma unroll
      for (int byte = 0; byte < kKeyBytes; ++byte) {
        code |= spread[(d * kKeyBytes + byte) * 256 + (place >> (kKeyBits - 8 - 8 * byte) & 255u)];
      }
    }
    key[i] = code;
    index[i] = static_cast<std::uint32_t>(i);
  }
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
    GPUPHYS_CUDA(cudaMemsetAsync(bounds_.get(), 0, sizeof(Bounds)));
    const int blocks = (n + threads - 1) / threads;
    const int grid = (n + kGridThreads - 1) / kGridThreads;
    find_bounds<<<static_cast<unsigned>(grid < kGridBlocks ? grid : kGridBlocks), kGridThreads>>>(
        x, n, bounds_.get());
    make_keys<<<static_cast<unsigned>(grid < kGridBlocks ? grid : kGridBlocks), kGridThreads>>>(
        x, n, bounds_.get(), key_.get(), index_.get());
    primitives::sort_pairs(scratch_.get(), scratch_bytes_, key_.get(), sorted_key_.get(), index_.get(),
                           order_.get(), n, 0, kKeyBits);
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
