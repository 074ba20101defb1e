#include "core/run/poison.hpp"

#include <algorithm>

#include "core/contract/module_abi.h"

namespace gpuphys {
namespace {

template <class T>
void fill(void* data, std::int64_t n, T pattern) {
  std::fill_n(static_cast<T*>(data), n, pattern);
}
template <class T>
std::int64_t count(const void* data, std::int64_t n, T pattern) {
  return std::count(static_cast<const T*>(data), static_cast<const T*>(data) + n, pattern);
}

}  // namespace

void fill_poison(void* data, std::int64_t n, std::int32_t dtype) {
  if (dtype == GPUPHYS_F64) return fill(data, n, kPoison64);
  if (dtype == GPUPHYS_BOOL) return fill(data, n, kPoisonByte);
  fill(data, n, kPoison32);
}

std::int64_t count_poison(const void* data, std::int64_t n, std::int32_t dtype) {
  if (dtype == GPUPHYS_F64) return count(data, n, kPoison64);
  if (dtype == GPUPHYS_BOOL) return count(data, n, kPoisonByte);
  return count(data, n, kPoison32);
}

}  // namespace gpuphys
