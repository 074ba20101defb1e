// Tetrahedra, given in random order, in the order of their lowest vertex, where vertices are numbered in
// space: the threads of a warp then share vertices, and what they read and add to is close in memory.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"
#include "references/global_solve/displaced_particles.cuh"
#include "references/local_interaction/neo_hookean.cuh"

namespace gpuphys::sorted_tets {

/// Differences from the first corner, as columns.
__device__ __forceinline__ elastic::Matrix3 edges(const float4* __restrict__ position,
                                                  const int (&corner)[4]) {
  const float4 origin = position[corner[0]];
  elastic::Matrix3 e;
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const float4 p = position[corner[k + 1]];
    e.m[0][k] = p.x - origin.x;
    e.m[1][k] = p.y - origin.y;
    e.m[2][k] = p.z - origin.z;
  }
  return e;
}

__global__ void __launch_bounds__(displaced::kThreads)
    place_rest(const float* __restrict__ rest, const std::int32_t* __restrict__ number, int n,
               float4* __restrict__ to) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  to[number[i]] = make_float4(rest[3 * i], rest[3 * i + 1], rest[3 * i + 2], 0.0f);
}

/// New numbers of the corners, the lowest as key; each corner may get three entries of the matrix.
__global__ void __launch_bounds__(displaced::kThreads)
    renumber(const int4* __restrict__ tets, const std::int32_t* __restrict__ number, int m,
             int4* __restrict__ renumbered, std::uint32_t* __restrict__ key,
             std::uint32_t* __restrict__ index, std::int32_t* __restrict__ room) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= m) return;
  const int4 old = tets[t];
  const int4 now = make_int4(number[old.x], number[old.y], number[old.z], number[old.w]);
  renumbered[t] = now;
  key[t] = static_cast<std::uint32_t>(min(min(now.x, now.y), min(now.z, now.w)));
  index[t] = static_cast<std::uint32_t>(t);
  atomicAdd(room + now.x, 3);
  atomicAdd(room + now.y, 3);
  atomicAdd(room + now.z, 3);
  atomicAdd(room + now.w, 3);
}

__global__ void __launch_bounds__(displaced::kThreads)
    gather(const int4* __restrict__ from, const std::uint32_t* __restrict__ index, int m,
           int4* __restrict__ to) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t < m) to[t] = from[index[t]];
}

class SortedTets {
 public:
  SortedTets() = default;
  SortedTets(int n, int m)
      : n_(n),
        m_(m),
        rest_(static_cast<std::size_t>(n)),
        renumbered_(static_cast<std::size_t>(m)),
        sorted_(static_cast<std::size_t>(m)),
        scratch_bytes_(primitives::sort_pairs_bytes(m)),
        scratch_(scratch_bytes_) {
    for (DeviceBuffer<std::uint32_t>& b : pairs_)
      b = DeviceBuffer<std::uint32_t>(static_cast<std::size_t>(m));
    while (bits_ < 31 && n > 1 << bits_) ++bits_;
  }

  /// Adds to room[i] three times the number of tetrahedra of vertex i.
  void build(const std::int32_t* tets, const float* rest, const std::int32_t* number,
             std::int32_t* room) const {
    place_rest<<<displaced::blocks_for(n_), displaced::kThreads>>>(rest, number, n_, rest_.get());
    const unsigned blocks = displaced::blocks_for(m_);
    renumber<<<blocks, displaced::kThreads>>>(reinterpret_cast<const int4*>(tets), number, m_,
                                              renumbered_.get(), pairs_[0].get(), pairs_[1].get(), room);
    primitives::sort_pairs(scratch_.get(), scratch_bytes_, pairs_[0].get(), pairs_[2].get(), pairs_[1].get(),
                           pairs_[3].get(), m_, 0, bits_);
    gather<<<blocks, displaced::kThreads>>>(renumbered_.get(), pairs_[3].get(), m_, sorted_.get());
  }

  const int4* tets() const { return sorted_.get(); }
  const float4* rest() const { return rest_.get(); }  ///< (n), in the new order

 private:
  int n_ = 0, m_ = 0, bits_ = 1;
  DeviceBuffer<float4> rest_;
  DeviceBuffer<int4> renumbered_, sorted_;
  DeviceBuffer<std::uint32_t> pairs_[4];
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::sorted_tets
