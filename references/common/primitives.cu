#include "references/common/primitives.hpp"

#include <cub/device/device_scan.cuh>

#include "core/module.hpp"

namespace gpuphys::primitives {

std::size_t exclusive_sum_bytes(std::int64_t n) {
  std::size_t bytes = 0;
  GPUPHYS_CUDA(cub::DeviceScan::ExclusiveSum(nullptr, bytes, static_cast<const std::int32_t*>(nullptr),
                                             static_cast<std::int32_t*>(nullptr), n));
  return bytes;
}

void exclusive_sum(void* scratch, std::size_t scratch_bytes, const std::int32_t* in, std::int32_t* out,
                   std::int64_t n, cudaStream_t stream) {
  GPUPHYS_CUDA(cub::DeviceScan::ExclusiveSum(scratch, scratch_bytes, in, out, n, stream));
}

}  // namespace gpuphys::primitives
