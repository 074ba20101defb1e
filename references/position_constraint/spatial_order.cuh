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

__device__ __forceinline__ std::uint32_t encode(float f) {
  const std::uint32_t bits = __float_as_uint(f);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}

__device__ __forceinline__ float decode(std::uint32_t code) {
  return __uint_as_float(code & 0x80000000u ? code & 0x7fffffffu : ~code);
}

/// A box by its corners, in an encoding whose order as unsigned integers is that of the floats; of the lowest
/// one the complement, so that both grow from zero.
struct Bounds {
  std::uint32_t extremes[6];

  __device__ __forceinline__ float low(int d) const { return decode(~extremes[d]); }
  __device__ __forceinline__ float high(int d) const { return decode(extremes[3 + d]); }
};

__device__ __forceinline__ void include(Bounds& box, float x, float y, float z) {
  const float place[3] = {x, y, z};
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const std::uint32_t code = encode(place[d]);
    box.extremes[d] = max(box.extremes[d], ~code);
    box.extremes[3 + d] = max(box.extremes[3 + d], code);
  }
}

/// Widens a box in shared memory by those of all threads of the warp.
__device__ __forceinline__ void include(Bounds& shared, const Bounds& own) {
#pragma unroll
  for (int k = 0; k < 6; ++k) {
    const std::uint32_t most = __reduce_max_sync(0xffffffffu, own.extremes[k]);
    if (threadIdx.x % 32 == 0) atomicMax(shared.extremes + k, most);
  }
}

/// Widens `bounds` (zero before) to hold all particles.
__global__ void __launch_bounds__(kGridThreads)
    find_bounds(const float* __restrict__ x, int n, Bounds* __restrict__ bounds) {
  __shared__ Bounds box;
  if (threadIdx.x == 0) box = {};
  __syncthreads();
  Bounds most{};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
#pragma unroll 4
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < n; i += stride)
    include(most, x[3 * i], x[3 * i + 1], x[3 * i + 2]);
  include(box, most);
  __syncthreads();
  if (threadIdx.x < 6) atomicMax(bounds->extremes + threadIdx.x, box.extremes[threadIdx.x]);
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
      low[d] = bounds->low(d);
      extent[d] = bounds->high(d) - low[d];
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
      : cleared_(1),
        cell_and_place_(static_cast<std::size_t>(n)),
        scratch_bytes_(primitives::exclusive_sum_bytes(kCells)),
        scratch_(scratch_bytes_) {}

  void build(const float* x, int n) const {
    GPUPHYS_CUDA(cudaMemsetAsync(cleared_.get(), 0, sizeof(Cleared)));
    const int blocks = (n + kGridThreads - 1) / kGridThreads;
    const auto grid = static_cast<unsigned>(blocks < kGridBlocks ? blocks : kGridBlocks);
    Bounds* const bounds = &cleared_.get()->bounds;
    std::int32_t* const first = cleared_.get()->first;
    find_bounds<<<grid, kGridThreads>>>(x, n, bounds);
    find_cells<<<grid, kGridThreads>>>(x, n, bounds, first, cell_and_place_.get());
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, first, first, kCells);
  }

  const std::int32_t* first() const { return cleared_.get()->first; }   ///< (kCells)
  const int2* cell_and_place() const { return cell_and_place_.get(); }  ///< (n)

 private:
  struct Cleared {  // zero before a build, by one memset
    std::int32_t first[kCells];
    Bounds bounds;
  };

  DeviceBuffer<Cleared> cleared_;
  DeviceBuffer<int2> cell_and_place_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::spatial
