// The hardware's square root and inverses, each within about one unit in the last place, without the branches
// that the library spends on subnormal numbers: these count as zero, as arguments and as results.
#pragma once

namespace gpuphys {

/// sqrt(a) for a >= 0; 0 for 0.
__device__ __forceinline__ float approximate_sqrt(float a) {
  float root;
  asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(root) : "f"(a));
  return root;
}

/// 1/sqrt(a) for a > 0.
__device__ __forceinline__ float approximate_rsqrt(float a) {
  float root;
  asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(root) : "f"(a));
  return root;
}

/// 1/a.
__device__ __forceinline__ float approximate_inverse(float a) {
  float inverse;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(inverse) : "f"(a));
  return inverse;
}

}  // namespace gpuphys
