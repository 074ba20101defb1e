// Springs as rows of their particles, from springs in random order: an entry of each end holds the other end
// and the rest length. A count, a scan, and a place for each entry by an atomic.
#pragma once

#include <cstdint>

#include "references/blocks/laplacian_rows.cuh"
#include "references/common/primitives.hpp"
#include "references/global_solve/displaced_particles.cuh"

namespace gpuphys::springs {

__global__ void __launch_bounds__(displaced::kThreads)
    count_ends(const int2* __restrict__ springs, const std::int32_t* __restrict__ number, int m,
               std::int32_t* __restrict__ count) {
  const int j = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (j >= m) return;
  const int2 ends = springs[j];
  if (ends.x == ends.y) return;
  atomicAdd(count + number[ends.x], 1);
  atomicAdd(count + number[ends.y], 1);
}

/// `next` has, in the beginning, where each row begins; in the end, where it ends.
__global__ void __launch_bounds__(displaced::kThreads)
    fill_rows(const int2* __restrict__ springs, const float* __restrict__ rest,
              const std::int32_t* __restrict__ number, int m, std::int32_t* __restrict__ next,
              std::int32_t* __restrict__ other, float* __restrict__ length) {
  const int j = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (j >= m) return;
  const int2 ends = springs[j];
  if (ends.x == ends.y) return;
  const int a = number[ends.x], b = number[ends.y];
  const float l = rest[j];
  const int at_a = atomicAdd(next + a, 1), at_b = atomicAdd(next + b, 1);
  other[at_a] = b;
  length[at_a] = l;
  other[at_b] = a;
  length[at_b] = l;
}

/// residual += kappa times the pull of the particle's springs, of a row by its lanes.
__global__ void __launch_bounds__(displaced::kThreads)
    add_pulls(rows::Rows rows, const float* __restrict__ length, displaced::Particles p, float kappa,
              float4* __restrict__ residual) {
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < rows.n;
  float sx = 0.0f, sy = 0.0f, sz = 0.0f;
  if (there) {
    const float4 x = p.position[i], u = p.moved[i];
    const int end = rows.first[i + 1];
    for (int e = rows.first[i] + lane; e < end; e += rows::kLanes) {
      const int j = rows.other[e];
      const float4 xj = p.position[j], uj = p.moved[j];
      const float dx = (x.x - xj.x) + (u.x - uj.x), dy = (x.y - xj.y) + (u.y - uj.y),
                  dz = (x.z - xj.z) + (u.z - uj.z);
      const float now = sqrtf(dx * dx + dy * dy + dz * dz);
      if (now == 0.0f) continue;
      const float pull = (length[e] - now) / now;
      sx += pull * dx;
      sy += pull * dy;
      sz += pull * dz;
    }
  }
  sx = rows::sum_lanes(sx);
  sy = rows::sum_lanes(sy);
  sz = rows::sum_lanes(sz);
  if (!there || lane != 0) return;
  const float4 r = residual[i];
  residual[i] = make_float4(r.x + kappa * sx, r.y + kappa * sy, r.z + kappa * sz, 0.0f);
}

class SpringRows {
 public:
  SpringRows() = default;
  SpringRows(int n, int m)
      : n_(n),
        m_(m),
        first_(static_cast<std::size_t>(n) + 1),
        next_(static_cast<std::size_t>(n) + 1),
        other_(2 * static_cast<std::size_t>(m)),
        length_(2 * static_cast<std::size_t>(m)),
        scratch_bytes_(primitives::exclusive_sum_bytes(n + 1)),
        scratch_(scratch_bytes_) {}

  void build(const std::int32_t* springs, const float* rest, const std::int32_t* number) const {
    const std::size_t bytes = sizeof(std::int32_t) * (static_cast<std::size_t>(n_) + 1);
    const int2* const ends = reinterpret_cast<const int2*>(springs);
    GPUPHYS_CUDA(cudaMemsetAsync(first_.get(), 0, bytes));
    count_ends<<<displaced::blocks_for(m_), displaced::kThreads>>>(ends, number, m_, first_.get());
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, first_.get(), first_.get(), n_ + 1);
    GPUPHYS_CUDA(cudaMemcpyAsync(next_.get(), first_.get(), bytes, cudaMemcpyDeviceToDevice));
    fill_rows<<<displaced::blocks_for(m_), displaced::kThreads>>>(ends, rest, number, m_, next_.get(),
                                                                  other_.get(), length_.get());
  }
  rows::Rows rows(float weight, const float* mass) const {
    return {n_, first_.get(), other_.get(), nullptr, weight, mass};
  }
  const float* length() const { return length_.get(); }

 private:
  int n_ = 0, m_ = 0;
  DeviceBuffer<std::int32_t> first_, next_, other_;
  DeviceBuffer<float> length_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::springs
