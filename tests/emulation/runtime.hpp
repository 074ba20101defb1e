// CUDA's runtime for kernels that run on the CPU. Everything happens at once: streams and events exist, but
// there is nothing to wait for.
//
// Environment: GPUPHYS_EMULATED_SEED (0: blocks and threads in order, 1: backwards, more: shuffled),
// GPUPHYS_EMULATED_SMS (4), GPUPHYS_EMULATED_SHARED_KB (227, opt-in shared memory of a block),
// GPUPHYS_EMULATED_CAPABILITY (90).
#pragma once

#include <link.h>

#include <cstdlib>
#include <map>
#include <tuple>
#include <utility>

#include "tests/emulation/builtins.hpp"

// ---- Types ----

enum cudaError_t {
  cudaSuccess = 0,
  cudaErrorInvalidValue = 1,
  cudaErrorMemoryAllocation = 2,
  cudaErrorInvalidConfiguration = 9,
  cudaErrorNotReady = 600,
  cudaErrorNotSupported = 801
};
using cudaStream_t = struct EmulatedStream*;
using cudaEvent_t = struct EmulatedEvent*;
enum cudaMemcpyKind {
  cudaMemcpyHostToHost,
  cudaMemcpyHostToDevice,
  cudaMemcpyDeviceToHost,
  cudaMemcpyDeviceToDevice,
  cudaMemcpyDefault
};
enum cudaDeviceAttr {
  cudaDevAttrMaxThreadsPerBlock = 1,
  cudaDevAttrMaxSharedMemoryPerBlock = 8,
  cudaDevAttrWarpSize = 10,
  cudaDevAttrClockRate = 13,
  cudaDevAttrMultiProcessorCount = 16,
  cudaDevAttrL2CacheSize = 38,
  cudaDevAttrMaxThreadsPerMultiProcessor = 39,
  cudaDevAttrComputeCapabilityMajor = 75,
  cudaDevAttrComputeCapabilityMinor = 76,
  cudaDevAttrMaxSharedMemoryPerMultiprocessor = 81,
  cudaDevAttrCooperativeLaunch = 95,
  cudaDevAttrMaxSharedMemoryPerBlockOptin = 97,
  cudaDevAttrReservedSharedMemoryPerBlock = 111
};
enum cudaFuncAttribute {
  cudaFuncAttributeMaxDynamicSharedMemorySize = 8,
  cudaFuncAttributePreferredSharedMemoryCarveout = 9,
  cudaFuncAttributeNonPortableClusterSizeAllowed = 14
};
enum {
  cudaSharedmemCarveoutDefault = -1,
  cudaSharedmemCarveoutMaxShared = 100,
  cudaSharedmemCarveoutMaxL1 = 0
};
enum { cudaStreamDefault = 0, cudaStreamNonBlocking = 1, cudaEventDefault = 0, cudaEventDisableTiming = 2 };
enum { cudaHostAllocDefault = 0 };
struct cudaDeviceProp {
  char name[256] = "emulated";
  std::size_t totalGlobalMem = std::size_t{16} << 30, sharedMemPerBlock = 48 << 10,
              sharedMemPerBlockOptin = 0;
  std::size_t sharedMemPerMultiprocessor = 228 << 10;
  int major = 9, minor = 0, multiProcessorCount = 4, maxThreadsPerBlock = 1024,
      maxThreadsPerMultiProcessor = 2048;
  int warpSize = 32, l2CacheSize = 50 << 20, maxBlocksPerMultiProcessor = 32, regsPerBlock = 65536;
};
struct cudaFuncAttributes {
  std::size_t sharedSizeBytes = 0, localSizeBytes = 0;
  int numRegs = 64, maxThreadsPerBlock = 1024, maxDynamicSharedSizeBytes = 48 << 10;
};
enum cudaLaunchAttributeID {
  cudaLaunchAttributeIgnore = 0,
  cudaLaunchAttributeCooperative = 2,
  cudaLaunchAttributeClusterDimension = 4,
  cudaLaunchAttributeProgrammaticStreamSerialization = 6
};
struct cudaLaunchAttribute {
  cudaLaunchAttributeID id = cudaLaunchAttributeIgnore;
  struct {
    int programmaticStreamSerializationAllowed = 0, cooperative = 0;
    struct {
      unsigned x = 1, y = 1, z = 1;
    } clusterDim;
  } val;
};
struct cudaLaunchConfig_t {
  dim3 gridDim, blockDim;
  std::size_t dynamicSmemBytes = 0;
  cudaStream_t stream = nullptr;
  cudaLaunchAttribute* attrs = nullptr;
  unsigned numAttrs = 0;
};

namespace emulation {

inline long setting(const char* name, long otherwise) {
  const char* text = std::getenv(name);
  return text && *text ? std::strtol(text, nullptr, 10) : otherwise;
}
inline int processors() {
  static const auto n = static_cast<int>(setting("GPUPHYS_EMULATED_SMS", 4));
  return n;
}
inline std::size_t shared_limit() {
  static const auto n = static_cast<std::size_t>(setting("GPUPHYS_EMULATED_SHARED_KB", 227)) * 1024;
  return n;
}
inline int capability() {
  static const auto n = static_cast<int>(setting("GPUPHYS_EMULATED_CAPABILITY", 90));
  return n;
}

// ---- Memory: a band of known bytes on either side, looked at after every launch ----

constexpr std::size_t kBand = 256;
inline std::map<void*, std::size_t>& allocations() {
  static auto* all = new std::map<void*, std::size_t>;  // buffers may be freed when the process ends
  return *all;
}
inline void* allocate(std::size_t bytes) {
#if defined(__SANITIZE_ADDRESS__)
  void* p = std::aligned_alloc(256, (bytes + 255) / 256 * 256);  // redzones do the rest, to 256 bytes
  if (p) poison(p, bytes);
  return p;
#else
  auto* raw = static_cast<char*>(std::aligned_alloc(256, (bytes + 2 * kBand + 255) / 256 * 256));
  if (!raw) return nullptr;
  std::memset(raw, 0x5a, kBand);
  poison(raw + kBand, bytes);
  std::memset(raw + kBand + bytes, 0x5a, kBand);
  allocations()[raw + kBand] = bytes;
  return raw + kBand;
#endif
}
inline void release(void* p) {
  if (!p) return;
#if defined(__SANITIZE_ADDRESS__)
  std::free(p);
#else
  allocations().erase(p);
  std::free(static_cast<char*>(p) - kBand);
#endif
}
inline void check_bands() {
  static const std::vector<char> band(kBand, 0x5a);
  for (const auto& [p, bytes] : allocations()) {
    const char* at = static_cast<const char*>(p);
    if (std::memcmp(at - kBand, band.data(), kBand) != 0 || std::memcmp(at + bytes, band.data(), kBand) != 0)
      throw std::runtime_error("wrote beyond an allocation of " + std::to_string(bytes) + " bytes");
  }
}

// ---- Shared memory ----

inline thread_local char shared_anchor;  // so that the module has a segment for __shared__ at all

struct Segment {
  char* data = nullptr;
  std::size_t bytes = 0;
};
/// The segment of thread-local variables of this module: its static __shared__ variables.
inline Segment static_shared() {
  static const Segment segment = [] {
    volatile char* touch = &shared_anchor;  // it exists from the first access on
    *touch = 0;
    Segment found;
    dl_iterate_phdr(
        [](dl_phdr_info* info, std::size_t, void* out) {
          const auto here = reinterpret_cast<std::uintptr_t>(&kPoison);
          bool ours = false;
          std::size_t bytes = 0;
          for (int i = 0; i < info->dlpi_phnum; ++i) {
            const auto& h = info->dlpi_phdr[i];
            const auto begin = info->dlpi_addr + h.p_vaddr;
            if (h.p_type == PT_LOAD && here >= begin && here < begin + h.p_memsz) ours = true;
            if (h.p_type == PT_TLS) bytes = h.p_memsz;
          }
          if (!ours) return 0;
          *static_cast<Segment*>(out) = {static_cast<char*>(info->dlpi_tls_data), bytes};
          return 1;
        },
        &found);
    if (found.data == nullptr) throw std::runtime_error("emulation: no segment of shared variables");
    return found;
  }();
  return segment;
}

struct DynamicShared {
  char* data = nullptr;
  std::size_t bytes = 0, capacity = 0;
};
inline DynamicShared dynamic;
template <class T>
T* dynamic_shared() {
  return reinterpret_cast<T*>(dynamic.data);
}
// Exactly as large as asked for, at the end of what there is: with AddressSanitizer nothing follows it, else
// a band.
inline void prepare_shared(std::size_t bytes) {
  if (dynamic.data == nullptr || dynamic.bytes != bytes) {
    release(dynamic.data);
    dynamic = {static_cast<char*>(allocate(bytes ? bytes : 1)), bytes, bytes};
  }
}
inline void poison_shared() {
  const Segment s = static_shared();
  poison(s.data, s.bytes);
  poison(dynamic.data, dynamic.bytes);
}

// Addresses of 32 bits in shared memory: static variables from 2^24 on, dynamic memory from 2^25 on.
constexpr std::size_t kStaticAddress = std::size_t{1} << 24, kDynamicAddress = std::size_t{1} << 25;
inline std::size_t shared_address(const void* p) {
  const auto at = reinterpret_cast<std::uintptr_t>(p);
  const Segment s = static_shared();
  const auto base = reinterpret_cast<std::uintptr_t>(s.data);
  const auto dynamic_base = reinterpret_cast<std::uintptr_t>(dynamic.data);
  // One past the end is an address, too.
  if (at - dynamic_base <= dynamic.bytes) return kDynamicAddress + (at - dynamic_base);
  if (at - base <= s.bytes) return kStaticAddress + base % 256 + (at - base);
  throw std::runtime_error("not in shared memory");
}
/// The pointer that shared_address() made an address of.
template <class T>
T* shared_pointer(std::size_t address) {
  const Segment s = static_shared();
  char* p = nullptr;
  if (address - kDynamicAddress < dynamic.bytes) {
    p = dynamic.data + (address - kDynamicAddress);
  } else if (const std::size_t o = address - kStaticAddress - reinterpret_cast<std::uintptr_t>(s.data) % 256;
             o < s.bytes) {
    p = s.data + o;
  } else {
    throw std::runtime_error("not an address in shared memory");
  }
  require_alignment(reinterpret_cast<T*>(p));
  return reinterpret_cast<T*>(p);
}

}  // namespace emulation

template <class T>
std::size_t __cvta_generic_to_shared(const T* p) {
  return ::emulation::shared_address(p);
}

namespace emulation {

// ---- Launches ----

// By cudaFuncSetAttribute. Which kernel a kernel<<<>>> names is known to the compiler alone where arguments
// are deduced: then any of them counts (key null holds the largest).
inline std::map<const void*, std::size_t>& shared_opt_in() {
  static std::map<const void*, std::size_t> all;
  return all;
}

struct Config {
  dim3 grid, block;
  std::size_t shared = 0;
  const char* file = "";
  int line = 0;
};
inline Config config(dim3 grid, dim3 block, std::size_t shared = 0, cudaStream_t = nullptr,
                     const char* file = __builtin_FILE(), int line = __builtin_LINE()) {
  return {grid, block, shared, file, line};
}

inline Block& the_block() {
  static auto* block = new Block;
  return *block;
}

template <class Body>
void launch(const Config& c, const void* kernel, const Body& body) {
  const auto fail = [&](const std::string& why) {
    const char* slash = std::strrchr(c.file, '/');
    throw std::runtime_error("kernel launched at " + std::string(slash ? slash + 1 : c.file) + ":" +
                             std::to_string(c.line) + ": " + why);
  };
  const std::uint64_t threads = std::uint64_t{c.block.x} * c.block.y * c.block.z;
  if (threads == 0 || threads > 1024 || c.block.z > 64)
    fail("a block of " + std::to_string(threads) + " threads");
  if (c.grid.x == 0 || c.grid.y == 0 || c.grid.z == 0 || c.grid.x > 0x7fffffffu || c.grid.y > 65535u ||
      c.grid.z > 65535u)
    fail("a grid of " + std::to_string(c.grid.x) + " x " + std::to_string(c.grid.y) + " x " +
         std::to_string(c.grid.z) + " blocks");
  const auto opted = shared_opt_in().find(kernel);
  const std::size_t limit =
      opted == shared_opt_in().end() ? 48 * 1024 : std::max<std::size_t>(opted->second, 48 * 1024);
  if (c.shared > limit)
    fail(std::to_string(c.shared) + " bytes of dynamic shared memory, " + std::to_string(limit) +
         " are allowed");
  prepare_shared(c.shared);
  gridDim = c.grid;
  const Order order{static_cast<std::uint64_t>(setting("GPUPHYS_EMULATED_SEED", 0))};
  const std::uint64_t blocks = std::uint64_t{c.grid.x} * c.grid.y * c.grid.z;
  if (blocks > 0x7fffffffu) fail("too many blocks for an emulation");
  const std::vector<int> shuffled = order.of(static_cast<int>(blocks), 17);
  for (const int b : shuffled) {
    const auto u = static_cast<unsigned>(b);
    blockIdx = {u % c.grid.x, u / c.grid.x % c.grid.y, u / c.grid.x / c.grid.y};
    poison_shared();
    try {
      the_block().run(c.block, body, order, u);
      if (b == shuffled.back()) check_bands();
    } catch (const std::exception& e) {
      fail("block (" + std::to_string(blockIdx.x) + ", " + std::to_string(blockIdx.y) + ", " +
           std::to_string(blockIdx.z) + "): " + e.what());
    }
  }
}

/// Of a kernel<<<...>>>(...): the kernel waits for its arguments.
template <class Kernel>
struct Bound {
  Kernel kernel;
  Config config;

  template <class... A>
  void operator()(A&&... arguments) const {
    const std::tuple<std::decay_t<A>...> kept(std::forward<A>(arguments)...);
    launch(config, nullptr, [&] { std::apply(kernel, kept); });
  }
};
template <class Kernel>
Bound<Kernel> operator<<(const Config& c, Kernel kernel) {
  return {std::move(kernel), c};
}

}  // namespace emulation

template <class... P, class... A>
cudaError_t cudaLaunchKernelEx(const cudaLaunchConfig_t* c, void (*kernel)(P...), A&&... arguments) {
  for (unsigned i = 0; i < c->numAttrs; ++i) {
    const auto& a = c->attrs[i];
    if (a.id == cudaLaunchAttributeClusterDimension &&
        a.val.clusterDim.x * a.val.clusterDim.y * a.val.clusterDim.z > 1)
      throw std::runtime_error("emulation: clusters are not supported");
    if (a.id == cudaLaunchAttributeCooperative && a.val.cooperative)
      throw std::runtime_error("emulation: cooperative launches are not supported");
  }
  const std::tuple<std::remove_cv_t<P>...> kept(std::forward<A>(arguments)...);
  emulation::launch(emulation::config(c->gridDim, c->blockDim, c->dynamicSmemBytes),
                    reinterpret_cast<const void*>(kernel), [&] { std::apply(kernel, kept); });
  return cudaSuccess;
}

// ---- Calls ----

inline const char* cudaGetErrorString(cudaError_t e) {
  switch (e) {
    case cudaSuccess:
      return "no error";
    case cudaErrorInvalidValue:
      return "invalid argument";
    case cudaErrorMemoryAllocation:
      return "out of memory";
    case cudaErrorInvalidConfiguration:
      return "invalid configuration argument";
    default:
      return "not supported by the emulation";
  }
}
inline const char* cudaGetErrorName(cudaError_t e) {
  return cudaGetErrorString(e);
}
inline cudaError_t cudaGetLastError() {
  return cudaSuccess;  // a launch that fails throws
}
inline cudaError_t cudaPeekAtLastError() {
  return cudaSuccess;
}
template <class T>
cudaError_t cudaMalloc(T** p, std::size_t bytes) {
  *p = static_cast<T*>(emulation::allocate(bytes));
  return *p ? cudaSuccess : cudaErrorMemoryAllocation;
}
inline cudaError_t cudaFree(void* p) {
  emulation::release(p);
  return cudaSuccess;
}
template <class T>
cudaError_t cudaMallocAsync(T** p, std::size_t bytes, cudaStream_t) {
  return cudaMalloc(p, bytes);
}
inline cudaError_t cudaFreeAsync(void* p, cudaStream_t) {
  return cudaFree(p);
}
template <class T>
cudaError_t cudaMallocHost(T** p, std::size_t bytes, unsigned = 0) {
  return cudaMalloc(p, bytes);
}
template <class T>
cudaError_t cudaHostAlloc(T** p, std::size_t bytes, unsigned) {
  return cudaMalloc(p, bytes);
}
inline cudaError_t cudaFreeHost(void* p) {
  return cudaFree(p);
}
inline cudaError_t cudaMemset(void* p, int value, std::size_t bytes) {
  if (bytes) std::memset(p, value, bytes);
  return cudaSuccess;
}
inline cudaError_t cudaMemsetAsync(void* p, int value, std::size_t bytes, cudaStream_t = nullptr) {
  return cudaMemset(p, value, bytes);
}
inline cudaError_t cudaMemset2D(void* p, std::size_t pitch, int value, std::size_t width,
                                std::size_t height) {
  for (std::size_t i = 0; i < height; ++i) std::memset(static_cast<char*>(p) + i * pitch, value, width);
  return cudaSuccess;
}
inline cudaError_t cudaMemset2DAsync(void* p, std::size_t pitch, int value, std::size_t width,
                                     std::size_t height, cudaStream_t = nullptr) {
  return cudaMemset2D(p, pitch, value, width, height);
}
inline cudaError_t cudaMemcpy(void* to, const void* from, std::size_t bytes, cudaMemcpyKind) {
  if (bytes) std::memcpy(to, from, bytes);
  return cudaSuccess;
}
inline cudaError_t cudaMemcpyAsync(void* to, const void* from, std::size_t bytes, cudaMemcpyKind kind,
                                   cudaStream_t = nullptr) {
  return cudaMemcpy(to, from, bytes, kind);
}
inline cudaError_t cudaMemcpy2D(void* to, std::size_t to_pitch, const void* from, std::size_t from_pitch,
                                std::size_t width, std::size_t height, cudaMemcpyKind) {
  for (std::size_t i = 0; i < height; ++i)
    std::memcpy(static_cast<char*>(to) + i * to_pitch, static_cast<const char*>(from) + i * from_pitch,
                width);
  return cudaSuccess;
}
inline cudaError_t cudaMemcpy2DAsync(void* to, std::size_t to_pitch, const void* from, std::size_t from_pitch,
                                     std::size_t width, std::size_t height, cudaMemcpyKind kind,
                                     cudaStream_t = nullptr) {
  return cudaMemcpy2D(to, to_pitch, from, from_pitch, width, height, kind);
}
template <class T>
cudaError_t cudaMemcpyToSymbol(T& to, const void* from, std::size_t bytes, std::size_t offset = 0,
                               cudaMemcpyKind = cudaMemcpyHostToDevice) {
  std::memcpy(const_cast<char*>(reinterpret_cast<const volatile char*>(&to)) + offset, from, bytes);
  return cudaSuccess;
}
template <class T>
cudaError_t cudaMemcpyToSymbolAsync(T& to, const void* from, std::size_t bytes, std::size_t offset = 0,
                                    cudaMemcpyKind kind = cudaMemcpyHostToDevice, cudaStream_t = nullptr) {
  return cudaMemcpyToSymbol(to, from, bytes, offset, kind);
}
template <class T>
cudaError_t cudaMemcpyFromSymbol(void* to, const T& from, std::size_t bytes, std::size_t offset = 0,
                                 cudaMemcpyKind = cudaMemcpyDeviceToHost) {
  std::memcpy(to, reinterpret_cast<const char*>(&from) + offset, bytes);
  return cudaSuccess;
}
template <class T>
cudaError_t cudaGetSymbolAddress(void** p, const T& symbol) {
  *p = const_cast<void*>(static_cast<const void*>(&symbol));
  return cudaSuccess;
}
inline cudaError_t cudaMemGetInfo(std::size_t* free, std::size_t* total) {
  *free = *total = std::size_t{16} << 30;
  return cudaSuccess;
}
inline cudaError_t cudaGetDevice(int* device) {
  *device = 0;
  return cudaSuccess;
}
inline cudaError_t cudaSetDevice(int) {
  return cudaSuccess;
}
inline cudaError_t cudaGetDeviceCount(int* count) {
  *count = 1;
  return cudaSuccess;
}
inline cudaError_t cudaDeviceSynchronize() {
  return cudaSuccess;
}
inline cudaError_t cudaDeviceGetAttribute(int* value, cudaDeviceAttr attribute, int) {
  switch (attribute) {
    case cudaDevAttrMaxThreadsPerBlock:
      *value = 1024;
      break;
    case cudaDevAttrMaxSharedMemoryPerBlock:
      *value = 48 << 10;
      break;
    case cudaDevAttrWarpSize:
      *value = 32;
      break;
    case cudaDevAttrClockRate:
      *value = 1'000'000;
      break;
    case cudaDevAttrMultiProcessorCount:
      *value = emulation::processors();
      break;
    case cudaDevAttrL2CacheSize:
      *value = 50 << 20;
      break;
    case cudaDevAttrMaxThreadsPerMultiProcessor:
      *value = 2048;
      break;
    case cudaDevAttrComputeCapabilityMajor:
      *value = emulation::capability() / 10;
      break;
    case cudaDevAttrComputeCapabilityMinor:
      *value = emulation::capability() % 10;
      break;
    case cudaDevAttrMaxSharedMemoryPerMultiprocessor:
      *value = static_cast<int>(emulation::shared_limit()) + 1024;
      break;
    case cudaDevAttrCooperativeLaunch:
      *value = 0;
      break;
    case cudaDevAttrMaxSharedMemoryPerBlockOptin:
      *value = static_cast<int>(emulation::shared_limit());
      break;
    case cudaDevAttrReservedSharedMemoryPerBlock:
      *value = 1024;
      break;
  }
  return cudaSuccess;
}
inline cudaError_t cudaGetDeviceProperties(cudaDeviceProp* p, int) {
  *p = {};
  p->multiProcessorCount = emulation::processors();
  p->sharedMemPerBlockOptin = emulation::shared_limit();
  p->sharedMemPerMultiprocessor = emulation::shared_limit() + 1024;
  p->major = emulation::capability() / 10, p->minor = emulation::capability() % 10;
  return cudaSuccess;
}
template <class T>
cudaError_t cudaFuncSetAttribute(T* kernel, cudaFuncAttribute attribute, int value) {
  if (attribute == cudaFuncAttributeMaxDynamicSharedMemorySize) {
    if (value < 0 || static_cast<std::size_t>(value) > emulation::shared_limit())
      return cudaErrorInvalidValue;
    const auto bytes = static_cast<std::size_t>(value);
    emulation::shared_opt_in()[reinterpret_cast<const void*>(kernel)] = bytes;
    std::size_t& largest = emulation::shared_opt_in()[nullptr];
    largest = std::max(largest, bytes);
  }
  return cudaSuccess;
}
template <class T>
cudaError_t cudaFuncGetAttributes(cudaFuncAttributes* attributes, T*) {
  *attributes = {};
  return cudaSuccess;
}
template <class T>
cudaError_t cudaOccupancyMaxActiveBlocksPerMultiprocessor(int* blocks, T*, int threads, std::size_t shared) {
  const std::size_t by_shared = (emulation::shared_limit() + 1024) / (shared + 1024);
  *blocks = static_cast<int>(
      std::min<std::size_t>({by_shared, static_cast<std::size_t>(2048 / std::max(threads, 1)), 32}));
  return cudaSuccess;
}
inline cudaError_t cudaStreamCreate(cudaStream_t* s) {
  *s = nullptr;
  return cudaSuccess;
}
inline cudaError_t cudaStreamCreateWithFlags(cudaStream_t* s, unsigned) {
  return cudaStreamCreate(s);
}
inline cudaError_t cudaStreamCreateWithPriority(cudaStream_t* s, unsigned, int) {
  return cudaStreamCreate(s);
}
inline cudaError_t cudaStreamDestroy(cudaStream_t) {
  return cudaSuccess;
}
inline cudaError_t cudaStreamSynchronize(cudaStream_t) {
  return cudaSuccess;
}
inline cudaError_t cudaStreamQuery(cudaStream_t) {
  return cudaSuccess;
}
inline cudaError_t cudaStreamWaitEvent(cudaStream_t, cudaEvent_t, unsigned = 0) {
  return cudaSuccess;
}
inline cudaError_t cudaEventCreate(cudaEvent_t* e) {
  *e = nullptr;
  return cudaSuccess;
}
inline cudaError_t cudaEventCreateWithFlags(cudaEvent_t* e, unsigned) {
  return cudaEventCreate(e);
}
inline cudaError_t cudaEventDestroy(cudaEvent_t) {
  return cudaSuccess;
}
inline cudaError_t cudaEventRecord(cudaEvent_t, cudaStream_t = nullptr) {
  return cudaSuccess;
}
inline cudaError_t cudaEventSynchronize(cudaEvent_t) {
  return cudaSuccess;
}
inline cudaError_t cudaEventQuery(cudaEvent_t) {
  return cudaSuccess;
}
inline cudaError_t cudaEventElapsedTime(float* ms, cudaEvent_t, cudaEvent_t) {
  *ms = 1.0f;
  return cudaSuccess;
}
