// Rows of a few floats, one for each thread of a warp, from memory in whole lines to registers, by way of
// shared memory.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

namespace gpuphys {

/// Width floats of each of the rows first .. first+31 of n, in the order of memory: to be staged.
template <int Width>
__device__ __forceinline__ void load_rows(const float* __restrict__ rows, std::int64_t first, std::int64_t n,
                                          float (&in_flight)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const float* from = rows + Width * first + lane;
  if (first + 32 <= n) {
#pragma unroll
    for (int s = 0; s < Width; ++s) in_flight[s] = __ldcs(from + s * 32);
  } else {
    const std::int64_t left = Width * (n - first) - lane;
#pragma unroll
    for (int s = 0; s < Width; ++s) in_flight[s] = s * 32 < left ? __ldcs(from + s * 32) : 0.0f;
  }
}

/// The rows to shared memory: the lane's own begins at stage[lane * Width], from the next __syncwarp() on.
template <int Width>
__device__ __forceinline__ void stage_rows(float* __restrict__ stage, const float (&in_flight)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
#pragma unroll
  for (int s = 0; s < Width; ++s) stage[s * 32 + lane] = in_flight[s];
}

/// What load_rows() brought becomes the lane's own row.
template <int Width>
__device__ __forceinline__ void transpose_rows(float* __restrict__ stage, float (&values)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  stage_rows(stage, values);
  __syncwarp();
#pragma unroll
  for (int s = 0; s < Width; ++s) values[s] = stage[lane * Width + s];
}

/// Writes the lanes' own rows, of the rows first .. first+31 of n, in whole lines. `stage` is free from the
/// next
/// __syncwarp() on.
template <int Width>
__device__ __forceinline__ void store_rows(float* __restrict__ rows, std::int64_t first, std::int64_t n,
                                           float* __restrict__ stage, const float (&values)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
#pragma unroll
  for (int s = 0; s < Width; ++s) stage[lane * Width + s] = values[s];
  __syncwarp();
  const std::int64_t left = Width * (n - first) - lane;
  float* to = rows + Width * first + lane;
#pragma unroll
  for (int s = 0; s < Width; ++s) {
    if (s * 32 < left) __stcs(to + s * 32, stage[s * 32 + lane]);
  }
}

/// Writes the records of a warp, Quads float4 each, to their slots; a slot below 0 takes none. `packed` is
/// the warp's shared memory, record `lane` at packed[Quads * lane]; whole records leave together, Quads lanes
/// each.
template <int Quads>
__device__ __forceinline__ void write_records(const float4* __restrict__ packed, int slot,
                                              float4* __restrict__ records) {
  static_assert(32 % Quads == 0);
  constexpr int per_store = 32 / Quads;
  const int lane = static_cast<int>(threadIdx.x) % 32, part = lane % Quads;
#pragma unroll
  for (int s = 0; s < Quads; ++s) {
    const int item = s * per_store + lane / Quads;
    const int to = __shfl_sync(0xffffffffu, slot, item);
    if (to >= 0) records[static_cast<std::int64_t>(Quads) * to + part] = packed[Quads * item + part];
  }
}

}  // namespace gpuphys
