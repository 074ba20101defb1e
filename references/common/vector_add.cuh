// Atomic addition of three numbers at once.
#pragma once

namespace gpuphys {

/// sum.xyz += (x, y, z); sum.w stays as it is. One request for one sector of the L2 where the hardware adds
/// vectors (compute capability 9.0 and later), three elsewhere.
__device__ __forceinline__ void add_vector(float4* sum, float x, float y, float z) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
  asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(sum), "f"(x), "f"(y), "f"(z), "f"(0.0f)
               : "memory");
#else
  atomicAdd(&sum->x, x);
  atomicAdd(&sum->y, y);
  atomicAdd(&sum->z, z);
#endif
}

}  // namespace gpuphys
