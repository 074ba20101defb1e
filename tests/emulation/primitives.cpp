// references/common/primitives.hpp on the CPU.
#include "references/common/primitives.hpp"

#include <algorithm>
#include <numeric>
#include <vector>

namespace gpuphys::primitives {

// Some scratch, so that one that is too small or not passed is seen.
std::size_t exclusive_sum_bytes(std::int64_t n) {
  return 16 + static_cast<std::size_t>(n) / 16;
}
std::size_t sort_pairs_bytes(std::int64_t n) {
  return 16 + 8 * static_cast<std::size_t>(n);
}

namespace {
void use(void* scratch, std::size_t bytes, std::size_t needed) {
  if (scratch == nullptr || bytes < needed) throw std::runtime_error("primitives: not enough scratch memory");
  ::emulation::poison(scratch, bytes);
}
}  // namespace

void exclusive_sum(void* scratch, std::size_t scratch_bytes, const std::int32_t* in, std::int32_t* out,
                   std::int64_t n, cudaStream_t) {
  use(scratch, scratch_bytes, exclusive_sum_bytes(n));
  std::uint32_t sum = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    const auto own = static_cast<std::uint32_t>(in[i]);
    out[i] = static_cast<std::int32_t>(sum);
    sum += own;
  }
}

void sort_pairs(void* scratch, std::size_t scratch_bytes, const std::uint32_t* keys_in,
                std::uint32_t* keys_out, const std::uint32_t* values_in, std::uint32_t* values_out,
                std::int64_t n, int begin_bit, int end_bit, cudaStream_t) {
  use(scratch, scratch_bytes, sort_pairs_bytes(n));
  const std::uint32_t width = static_cast<std::uint32_t>(end_bit - begin_bit);
  const std::uint32_t mask = width >= 32 ? 0xffffffffu : (1u << width) - 1u;
  std::vector<std::int64_t> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), std::int64_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::int64_t a, std::int64_t b) {
    return (keys_in[a] >> begin_bit & mask) < (keys_in[b] >> begin_bit & mask);
  });
  for (std::size_t i = 0; i < order.size(); ++i) {
    keys_out[i] = keys_in[order[i]];
    values_out[i] = values_in[order[i]];
  }
}

}  // namespace gpuphys::primitives
