// A spatial numbering of particles that come in arbitrary order: by the Morton code of their cell, so that
// particles close in space are close in memory, and consecutive numbers make a compact tile.
//
// The bounding box is halved 18 times, each time across its longest side; a bit of the code says in which
// half the particle lies. So cells are nearly cubes whatever the shape of the box (a long roll of cloth). A
// counting sort numbers the particles: an atomic on the cell's counter gives a particle its place in the
// cell, a scan the cell's first number. Nothing depends on the number of particles in a cell; which of a
// cell's particles comes first is not reproducible. What bounds it: one returning atomic a particle.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::spatial {

constexpr int kHalvings = 18;
constexpr std::int64_t kCells = std::int64_t{1} << kHalvings;
constexpr int kPlaceBytes = 3, kPlaceBits = 8 * kPlaceBytes;  // of a coordinate in the box
constexpr int kGridBlocks = 264;                              // two a multiprocessor of an H200
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

/// Cell of every particle and its place among the particles of the cell; `count` (kCells, zero before) has
/// the particles of each cell in the end. The bits of a coordinate are spread by a table, a byte at a time.
__global__ void __launch_bounds__(kGridThreads)
    find_cells(const float* __restrict__ x, int n, const Bounds* __restrict__ bounds,
               std::int32_t* __restrict__ count, int2* __restrict__ cell_and_place) {
  __shared__ float low[3], scale[3];
  __shared__ int step_of[3 * kPlaceBits];  // [side][how often halved before]: the step that halves it; or -1
  __shared__ std::uint32_t
      spread[3 * kPlaceBytes * 256];  // [side][byte of the coordinate][its value]: bits of the code
  const int tid = static_cast<int>(threadIdx.x);
  if (tid < 3 * kPlaceBits) step_of[tid] = -1;
  __syncthreads();
  if (tid == 0) {
    float extent[3];
    int halved[3] = {0, 0, 0};
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      low[d] = decode(~bounds->low_complement[d]);
      extent[d] = decode(bounds->high[d]) - low[d];
      scale[d] = extent[d] > 0.0f ? (1 << kPlaceBits) / extent[d] : 0.0f;
    }
    for (int s = 0; s < kHalvings; ++s) {
      const int d = extent[0] >= extent[1] && extent[0] >= extent[2] ? 0 : extent[1] >= extent[2] ? 1 : 2;
#pragma unroll
      for (int a = 0; a < 3; ++a) {
        if (a != d) continue;
        step_of[a * kPlaceBits + halved[a]++] = s;
        extent[a] *= 0.5f;
      }
    }
  }
  __syncthreads();
  for (int entry = tid; entry < 3 * kPlaceBytes * 256; entry += static_cast<int>(blockDim.x)) {
    const int* const steps = step_of + entry / 256 * 8;  // of the eight bits of this byte
    std::uint32_t bits = 0;
#pragma unroll
    for (int b = 0; b < 8; ++b) {
      if (steps[b] >= 0 && (entry >> (7 - b) & 1)) bits |= 1u << (kHalvings - 1 - steps[b]);
    }
    spread[entry] = bits;
  }
  __syncthreads();
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
#pragma unroll 4
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < n; i += stride) {
    std::uint32_t code = 0;
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      const float f = fminf((x[3 * i + d] - low[d]) * scale[d], static_cast<float>((1 << kPlaceBits) - 1));
      const auto place = static_cast<std::uint32_t>(f);  // in units of 2^-24 of the side
#pragma unroll
      for (int byte = 0; byte < kPlaceBytes; ++byte) {
        code |= spread[(d * kPlaceBytes + byte) * 256 + (place >> (kPlaceBits - 8 - 8 * byte) & 255u)];
      }
    }
    cell_and_place[i] = int2{static_cast<std::int32_t>(code), atomicAdd(count + code, 1)};
  }
}

/// The numbering of up to `n` particles, in memory of its own: particle i, the k-th of cell c, gets the
/// number first()[c] + k.
class Order {
 public:
  Order() = default;
  explicit Order(int n)
      : bounds_(1),
        first_(static_cast<std::size_t>(kCells)),
        cell_and_place_(static_cast<std::size_t>(n)),
        scratch_bytes_(primitives::exclusive_sum_bytes(kCells)),
        scratch_(scratch_bytes_) {}

  void build(const float* x, int n) const {
    GPUPHYS_CUDA(cudaMemsetAsync(bounds_.get(), 0, sizeof(Bounds)));
    GPUPHYS_CUDA(cudaMemsetAsync(first_.get(), 0, sizeof(std::int32_t) * static_cast<std::size_t>(kCells)));
    const int blocks = (n + kGridThreads - 1) / kGridThreads;
    const auto grid = static_cast<unsigned>(blocks < kGridBlocks ? blocks : kGridBlocks);
    find_bounds<<<grid, kGridThreads>>>(x, n, bounds_.get());
    find_cells<<<grid, kGridThreads>>>(x, n, bounds_.get(), first_.get(), cell_and_place_.get());
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, first_.get(), first_.get(), kCells);
  }

  const std::int32_t* first() const { return first_.get(); }            ///< (kCells)
  const int2* cell_and_place() const { return cell_and_place_.get(); }  ///< (n)

 private:
  DeviceBuffer<Bounds> bounds_;
  DeviceBuffer<std::int32_t> first_;
  DeviceBuffer<int2> cell_and_place_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::spatial
