// Running sum over the threads of a block.
#pragma once

namespace gpuphys {

/// Sum of `own` over the threads of the block before this one. All threads call it. `warps` (one a warp) is
/// shared, and must not be in use: a barrier lies between two calls.
template <int Threads>
__device__ __forceinline__ int sum_before(int own, int* warps) {
  static_assert(Threads % 32 == 0 && Threads <= 1024);
  const int lane = static_cast<int>(threadIdx.x) % 32, warp = static_cast<int>(threadIdx.x) / 32;
  int sum = own;
#pragma unroll
  for (int offset = 1; offset < 32; offset *= 2) {
    const int below = __shfl_up_sync(0xffffffffu, sum, offset);
    if (lane >= offset) sum += below;
  }
  if (lane == 31) warps[warp] = sum;
  __syncthreads();
  int before = sum - own;
#pragma unroll
  for (int w = 0; w < Threads / 32; ++w) before += w < warp ? warps[w] : 0;
  return before;
}

}  // namespace gpuphys
