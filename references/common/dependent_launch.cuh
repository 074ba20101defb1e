// Launches that overlap with the end of the kernel before (programmatic dependent launch): blocks of the next
// kernel take their places on the device as soon as all blocks of the previous one have theirs, and the gap
// between the two kernels, 2 to 3 us, is gone.
//
// Every thread of a kernel launched by launch_dependent() calls wait_for_previous() before it touches what
// earlier kernels write, or writes what they read. It returns when the previous kernel is done, and with it
// all before, since they waited likewise: so no block may end without. What no kernel of the sequence writes
// may be read beforehand. The kernel before should call allow_next() early; otherwise nothing overlaps.
//
// Memory that an earlier kernel wrote must not be read through `const T* __restrict__`: such loads count as
// loads of constants, which compilers may move across the wait.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>

#include "core/contract/module.hpp"
#include "references/common/machine.cuh"

namespace gpuphys {

// Before compute capability 9.0 kernels run one after the other, as always.
__device__ __forceinline__ void allow_next() {
#if __CUDA_ARCH__ >= 900 || defined(GPUPHYS_EMULATED)
  asm volatile("griddepcontrol.launch_dependents;");
#endif
}

__device__ __forceinline__ void wait_for_previous() {
#if __CUDA_ARCH__ >= 900 || defined(GPUPHYS_EMULATED)
  asm volatile("griddepcontrol.wait;" ::: "memory");
#endif
}

/// kernel<<<blocks, threads, shared_bytes>>>(arguments...) on the default stream, behind a kernel of the same
/// sequence.
template <class... Parameters, class... Arguments>
void launch_dependent(void (*kernel)(Parameters...), unsigned blocks, unsigned threads,
                      std::size_t shared_bytes, const Arguments&... arguments) {
  cudaLaunchAttribute attribute{};
  attribute.id = cudaLaunchAttributeProgrammaticStreamSerialization;
  attribute.val.programmaticStreamSerializationAllowed = 1;
  cudaLaunchConfig_t config{};
  config.gridDim = dim3(blocks);
  config.blockDim = dim3(threads);
  config.dynamicSmemBytes = shared_bytes;
  config.attrs = &attribute;
  static const bool overlaps = device_attribute(cudaDevAttrComputeCapabilityMajor) >= 9;
  config.numAttrs = overlaps ? 1 : 0;
  GPUPHYS_CUDA(cudaLaunchKernelEx(&config, kernel, static_cast<Parameters>(arguments)...));
}

}  // namespace gpuphys
