// Rows of a symmetric matrix diag(mass) + L, where L is a weighted graph Laplacian that elements in random
// order add to: L = sum of w_ij (e_i - e_j)(e_i - e_j)^T. Two ways to the rows:
//
//   pairs     every pair of every element makes an entry of each end; nothing is merged (springs: their
//   weight is one
//             number for all, and an entry carries data of its own, the rest length)
//   merged    entries of the same pair are added up (tetrahedra: six share an edge). A row has room for all
//   its
//             entries, in which it is an open hash table; the tables are then squeezed together.
//
// The matrix is applied in differences, (A x)_i = mass_i x_i + sum of w_ij (x_i - x_j), which loses nothing
// where x is smooth. What bounds the construction: atomics in the L2, one a pair and end to find a place, a
// second to add.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::rows {

/// The off-diagonal entries of row i are first[i] to first[i + 1] - 1.
struct Rows {
  int n;
  const std::int32_t* first;  ///< (n + 1)
  const std::int32_t* other;
  const float* weight;  ///< w of each entry, or null: `uniform` for all
  float uniform;
  const float* mass;  ///< (n)

  __device__ __forceinline__ float weight_of(int entry) const { return weight ? weight[entry] : uniform; }
};

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kLanes = 8;  // threads that share a row
#else
constexpr int kLanes = 4;
#endif

/// Sum over the lanes of a row; all threads of the warp call it.
__device__ __forceinline__ float sum_lanes(float own) {
#pragma unroll
  for (int offset = 1; offset < kLanes; offset *= 2) own += __shfl_xor_sync(0xffffffffu, own, offset);
  return own;
}

/// Hash tables in which entries of a row come together. `other` is kNone and `weight` and `used` are zero
/// before.
struct Tables {
  static constexpr std::int32_t kNone = -1;
  const std::int32_t* first;  ///< (n + 1): room of each row, at least its number of different entries
  std::int32_t* other;
  float* weight;
  std::int32_t* used;  ///< (n + 1): entries of each row

  /// w_ij += weight. To be called for both ends.
  __device__ __forceinline__ void add(int i, int j, float w) const {
    const int begin = first[i], room = first[i + 1] - begin;
    int at = static_cast<int>(static_cast<std::uint32_t>(j) * 2654435769u % static_cast<std::uint32_t>(room));
    for (;;) {
      std::int32_t* const place = other + begin + at;
      std::int32_t there = *reinterpret_cast<volatile std::int32_t*>(place);
      if (there == kNone) {
        there = atomicCAS(place, kNone, j);
        if (there == kNone) atomicAdd(used + i, 1);
      }
      if (there == kNone || there == j) {
        atomicAdd(weight + begin + at, w);
        return;
      }
      at = at + 1 == room ? 0 : at + 1;
    }
  }
};

/// Entries of the tables side by side; eight lanes a row.
__global__ void __launch_bounds__(256) squeeze(Tables tables, int n, const std::int32_t* __restrict__ first,
                                               std::int32_t* __restrict__ other, float* __restrict__ weight) {
  constexpr int lanes = 8;
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), i = thread / lanes,
            lane = thread % lanes;
  const bool there = i < n;
  const int begin = there ? tables.first[i] : 0, end = there ? tables.first[i + 1] : 0;
  int to = there ? first[i] : 0;
  const int group = static_cast<int>(threadIdx.x) % 32 / lanes * lanes;  // first lane of the row in the warp
  int longest = end - begin;
#pragma unroll
  for (int offset = 16; offset > 0; offset /= 2)
    longest = max(longest, __shfl_xor_sync(0xffffffffu, longest, offset));
  for (int from = 0; from < longest; from += lanes) {
    const int at = begin + from + lane;
    const std::int32_t entry = at < end ? tables.other[at] : Tables::kNone;
    const unsigned taken = __ballot_sync(0xffffffffu, entry != Tables::kNone) >> group & ((1u << lanes) - 1u);
    if (entry != Tables::kNone) {
      const int place = to + __popc(taken & ((1u << lane) - 1u));
      other[place] = entry;
      weight[place] = tables.weight[at];
    }
    to += __popc(taken);
  }
}

/// Merged rows of up to `n` rows and `entries` entries, counted for both ends and before merging.
class MergedRows {
 public:
  MergedRows() = default;
  MergedRows(int n, std::int64_t entries)
      : n_(n),
        entries_(entries),
        room_(static_cast<std::size_t>(n) + 1),
        used_(static_cast<std::size_t>(n) + 1),
        table_other_(static_cast<std::size_t>(entries)),
        other_(static_cast<std::size_t>(entries)),
        table_weight_(static_cast<std::size_t>(entries)),
        weight_(static_cast<std::size_t>(entries)),
        scratch_bytes_(primitives::exclusive_sum_bytes(n + 1)),
        scratch_(scratch_bytes_) {}

  /// (n + 1), zero: to be filled with the entries of each row before begin(); the last stays zero.
  std::int32_t* room() const {
    GPUPHYS_CUDA(cudaMemsetAsync(room_.get(), 0, sizeof(std::int32_t) * (static_cast<std::size_t>(n_) + 1)));
    return room_.get();
  }
  /// Tables to add to, in kernels.
  Tables begin() const {
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, room_.get(), room_.get(), n_ + 1);
    GPUPHYS_CUDA(
        cudaMemsetAsync(table_other_.get(), 0xff, sizeof(std::int32_t) * static_cast<std::size_t>(entries_)));
    GPUPHYS_CUDA(cudaMemsetAsync(table_weight_.get(), 0, sizeof(float) * static_cast<std::size_t>(entries_)));
    GPUPHYS_CUDA(cudaMemsetAsync(used_.get(), 0, sizeof(std::int32_t) * (static_cast<std::size_t>(n_) + 1)));
    return tables();
  }
  /// The rows, when all is added.
  Rows finish(const float* mass) const {
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, used_.get(), used_.get(), n_ + 1);
    constexpr int threads = 256;
    squeeze<<<static_cast<unsigned>((8ll * n_ + threads - 1) / threads), threads>>>(
        tables(), n_, used_.get(), other_.get(), weight_.get());
    return {n_, used_.get(), other_.get(), weight_.get(), 0.0f, mass};
  }

 private:
  Tables tables() const { return {room_.get(), table_other_.get(), table_weight_.get(), used_.get()}; }

  int n_ = 0;
  std::int64_t entries_ = 0;
  DeviceBuffer<std::int32_t> room_, used_, table_other_, other_;
  DeviceBuffer<float> table_weight_, weight_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::rows
