#include "references/common/primitives.hpp"

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>

#include "core/contract/module.hpp"

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

std::size_t sort_pairs_bytes(std::int64_t n) {
  std::size_t bytes = 0;
  GPUPHYS_CUDA(cub::DeviceRadixSort::SortPairs(
      nullptr, bytes, static_cast<const std::uint32_t*>(nullptr), static_cast<std::uint32_t*>(nullptr),
      static_cast<const std::uint32_t*>(nullptr), static_cast<std::uint32_t*>(nullptr), n));
  return bytes;
}

void sort_pairs(void* scratch, std::size_t scratch_bytes, const std::uint32_t* keys_in,
                std::uint32_t* keys_out, const std::uint32_t* values_in, std::uint32_t* values_out,
                std::int64_t n, int begin_bit, int end_bit, cudaStream_t stream) {
  GPUPHYS_CUDA(cub::DeviceRadixSort::SortPairs(scratch, scratch_bytes, keys_in, keys_out, values_in,
                                               values_out, n, begin_bit, end_bit, stream));
}

}  // namespace gpuphys::primitives
