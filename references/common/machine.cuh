// What the hardware can do and CUDA C++ has no words for. (tests/emulation/ptx.hpp does the same on the CPU.)
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

#include "core/contract/module.hpp"

namespace gpuphys {

// ---- Copies to shared memory past the registers: a loop of these has all of them under way ----

/// 16 bytes; both addresses aligned to as many.
__device__ __forceinline__ void copy_async(float4* to, const float4* from) {
  asm volatile(
      "cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(static_cast<unsigned>(__cvta_generic_to_shared(to))),
      "l"(from)
      : "memory");
}
/// Likewise of the first `bytes` of the 16 only, and zeroes behind them.
__device__ __forceinline__ void copy_async(float* to, const float* from, unsigned bytes) {
  asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;" ::"r"(
                   static_cast<unsigned>(__cvta_generic_to_shared(to))),
               "l"(from), "r"(bytes)
               : "memory");
}
/// Until the thread's own copies have arrived.
__device__ __forceinline__ void wait_for_copies() {
  asm volatile("cp.async.wait_all;" ::: "memory");
}

// ---- Order ----

/// Acquire and release for the device: weaker than __threadfence(), which is sequentially consistent.
__device__ __forceinline__ void fence_device() {
  asm volatile("fence.acq_rel.gpu;" ::: "memory");
}

// ---- Bits, registers, shared memory by address ----

/// The compiler does not know that this is k.
__device__ __forceinline__ int opaque(int k) {
  asm volatile("" : "+r"(k));
  return k;
}

/// Number of the highest bit set (of at least one).
__device__ __forceinline__ int highest_bit(int bits) {
  int k;
  asm("bfind.u32 %0, %1;" : "=r"(k) : "r"(bits));
  return k;
}

// A place in shared memory by its address there, which the compiler would otherwise derive anew at every
// access, and wait for. Volatile: in this order.
using SharedAddress = unsigned;
__device__ __forceinline__ SharedAddress shared_address(const void* p) {
  return static_cast<unsigned>(opaque(static_cast<int>(__cvta_generic_to_shared(p))));
}
__device__ __forceinline__ void store_shared(SharedAddress address, int2 entry) {
  asm volatile("st.shared.v2.b32 [%0], {%1, %2};" ::"r"(address), "r"(entry.x), "r"(entry.y));
}
__device__ __forceinline__ int2 load_shared(SharedAddress address) {
  int2 entry;
  asm volatile("ld.shared.v2.b32 {%0, %1}, [%2];" : "=r"(entry.x), "=r"(entry.y) : "r"(address));
  return entry;
}

// ---- What this device has (asked on the host) ----

inline int device_attribute(cudaDeviceAttr attribute) {
  int device = 0, value = 0;
  GPUPHYS_CUDA(cudaGetDevice(&device));
  GPUPHYS_CUDA(cudaDeviceGetAttribute(&value, attribute, device));
  return value;
}
inline int multiprocessors() {
  return device_attribute(cudaDevAttrMultiProcessorCount);
}
/// Bytes of shared memory that a block may have, static and dynamic together.
inline int most_shared_bytes() {
  return device_attribute(cudaDevAttrMaxSharedMemoryPerBlockOptin);
}

}  // namespace gpuphys
