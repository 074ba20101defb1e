// Sums of several floats at L2 in one reduction where the device has them (compute capability 9.0), one by
// one elsewhere. Spelled out, because atomicAdd(float4*) asks for the old value as well.
#pragma once

#include <cuda_runtime.h>

namespace gpuphys {

/// *sum += value; 16-byte alignment.
__device__ __forceinline__ void reduce_add(float4* sum, const float4& value) {
#if defined(GPUPHYS_EMULATED) || __CUDA_ARCH__ < 900
  atomicAdd(&sum->x, value.x);
  atomicAdd(&sum->y, value.y);
  atomicAdd(&sum->z, value.z);
  atomicAdd(&sum->w, value.w);
#else
  asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
               :
               : "l"(sum), "f"(value.x), "f"(value.y), "f"(value.z), "f"(value.w)
               : "memory");
#endif
}

/// *sum += value; 8-byte alignment.
__device__ __forceinline__ void reduce_add(float2* sum, const float2& value) {
#if defined(GPUPHYS_EMULATED) || __CUDA_ARCH__ < 900
  atomicAdd(&sum->x, value.x);
  atomicAdd(&sum->y, value.y);
#else
  asm volatile("red.global.add.v2.f32 [%0], {%1, %2};" : : "l"(sum), "f"(value.x), "f"(value.y) : "memory");
#endif
}

}  // namespace gpuphys
