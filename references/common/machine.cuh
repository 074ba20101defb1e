// What the hardware can do and CUDA C++ has no words for, each with a plain equivalent for the emulator.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

#include "core/module.hpp"

namespace gpuphys {

// ---- Copies to shared memory past the registers: a loop of these has all of them under way ----

/// 16 bytes; both addresses aligned to as many.
__device__ __forceinline__ void copy_async(float4* to, const float4* from) {
#ifdef GPUPHYS_EMULATED
  *to = *from;
#else
  asm volatile(
      "cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(static_cast<unsigned>(__cvta_generic_to_shared(to))),
      "l"(from)
      : "memory");
#endif
}
/// Likewise of the first `bytes` of the 16 only, and zeroes behind them.
__device__ __forceinline__ void copy_async(float* to, const float* from, unsigned bytes) {
#ifdef GPUPHYS_EMULATED
  for (unsigned w = 0; w < 4; ++w) to[w] = 4 * w < bytes ? from[w] : 0.0f;
#else
  asm volatile("cp.async.cg.shared.global [%0], [%1], 16, %2;" ::"r"(
                   static_cast<unsigned>(__cvta_generic_to_shared(to))),
               "l"(from), "r"(bytes)
               : "memory");
#endif
}
/// Until the thread's own copies have arrived.
__device__ __forceinline__ void wait_for_copies() {
#ifndef GPUPHYS_EMULATED
  asm volatile("cp.async.wait_all;" ::: "memory");
#endif
}

// ---- Order ----

/// Acquire and release for the device: weaker than __threadfence(), which is sequentially consistent.
__device__ __forceinline__ void fence_device() {
#ifdef GPUPHYS_EMULATED
  __threadfence();
#else
  asm volatile("fence.acq_rel.gpu;" ::: "memory");
#endif
}

// ---- Bits, registers, shared memory by address ----

/// The compiler does not know that this is k.
__device__ __forceinline__ int opaque(int k) {
#ifndef GPUPHYS_EMULATED
  asm volatile("" : "+r"(k));
#endif
  return k;
}

/// Number of the highest bit set (of at least one).
__device__ __forceinline__ int highest_bit(int bits) {
#ifdef GPUPHYS_EMULATED
  return 31 - __clz(bits);
#else
  int k;
  asm("bfind.u32 %0, %1;" : "=r"(k) : "r"(bits));
  return k;
#endif
}

// A place in shared memory by its address there, which the compiler would otherwise derive anew at every
// access, and wait for. Volatile: in this order.
#ifdef GPUPHYS_EMULATED
using SharedAddress = std::uintptr_t;
__device__ __forceinline__ SharedAddress shared_address(const void* p) {
  return reinterpret_cast<SharedAddress>(p);
}
__device__ __forceinline__ void store_shared(SharedAddress address, int2 entry) {
  *reinterpret_cast<int2*>(address) = entry;
}
__device__ __forceinline__ int2 load_shared(SharedAddress address) {
  return *reinterpret_cast<const int2*>(address);
}
#else
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
#endif

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
