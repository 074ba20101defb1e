// Jacobi projection of distance constraints over unordered topology, shared by the XPBD references.
//
// A spring appears twice, once in the list of each of its ends (a compressed row of half-springs a particle),
// and is evaluated twice: every particle gathers its own displacement, so that no iteration needs atomics and
// the result of an end depends on nothing but its row. Both evaluations of a multiplier take the same
// operations on operands that differ in sign only, so the two copies stay bitwise equal.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::springs {

/// One particle: 32 bytes, one sector, so that a random gather moves nothing else.
struct __align__(16) Particle {
  float4 base;  ///< position before the solve, m, and inverse mass, 1/kg
  float4 step;  ///< displacement so far, m, and number of half-springs
};

/// A spring as one of its ends sees it.
struct __align__(8) HalfSpring {
  std::int32_t other;  ///< the particle at the other end
  float rest;          ///< m
};

/// Change of a spring's multiplier in one iteration, before averaging (XPBD equation 18).
__device__ __forceinline__ float multiplier_step(float violation, float multiplier, float alpha,
                                                 float inv_mass_sum, float valence) {
  return -(violation + alpha * multiplier) / ((inv_mass_sum + alpha) * valence);
}

/// Square root and its reciprocal of a positive normal number, each within about one unit in the last place.
__device__ __forceinline__ void length_of(float square, float& length, float& inverse) {
  inverse = rsqrtf(square);
  length = square * inverse;
  length += 0.5f * inverse * (square - length * length);  // one Newton step
}

/// Numbers the half-springs at each particle: `rank[2 j + end]` is the place of spring j in the row of that
/// end. `count` must be zero before. A spring from a particle to itself gets no place (rank -1). Where
/// `number` is not null, it renumbers the particles, and `renumbered` receives the new ends.
__global__ void count_half_springs(const int2* __restrict__ ends, int m,
                                   const std::int32_t* __restrict__ number, int2* __restrict__ renumbered,
                                   int* __restrict__ count, int2* __restrict__ rank) {
  const int j = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (j >= m) return;
  int2 e = __ldcs(ends + j);
  if (number) {
    e.x = number[e.x];
    e.y = number[e.y];
    __stcs(renumbered + j, e);
  }
  int2 r{-1, -1};
  if (e.x != e.y) {
    r.x = atomicAdd(count + e.x, 1);
    r.y = atomicAdd(count + e.y, 1);
  }
  __stcs(rank + j, r);
}

/// Writes every spring into the rows of its two ends; row i begins at `begin[i]`.
__global__ void fill_half_springs(const int2* __restrict__ ends, const float* __restrict__ rest,
                                  const int2* __restrict__ rank, const int* __restrict__ begin, int m,
                                  HalfSpring* __restrict__ half) {
  const int j = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (j >= m) return;
  const int2 r = __ldcs(rank + j);
  if (r.x < 0) return;
  const int2 e = __ldcs(ends + j);
  const float length = __ldcs(rest + j);
  half[begin[e.x] + r.x] = {e.y, length};
  half[begin[e.y] + r.y] = {e.x, length};
}

/// Both buffers of the double-buffered iteration, at rest at the input positions. Where `order` is not null,
/// place i takes particle order[i].
__global__ void place_particles(const float* __restrict__ x, const float* __restrict__ inv_mass,
                                const std::uint32_t* __restrict__ order, const int* __restrict__ begin, int n,
                                Particle* __restrict__ a, Particle* __restrict__ b) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const int q = order ? static_cast<int>(order[i]) : i;
  Particle p;
  p.base = make_float4(x[3 * q], x[3 * q + 1], x[3 * q + 2], inv_mass[q]);
  p.step = make_float4(0.0f, 0.0f, 0.0f, static_cast<float>(begin[i + 1] - begin[i]));
  a[i] = p;
  b[i] = p;
}

/// x + displacement, rounded once, back in input order.
__global__ void write_positions(const Particle* __restrict__ particles,
                                const std::uint32_t* __restrict__ order, int n, float* __restrict__ x) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const int q = order ? static_cast<int>(order[i]) : i;
  const Particle p = particles[i];
  x[3 * q] = p.base.x + p.step.x;
  x[3 * q + 1] = p.base.y + p.step.y;
  x[3 * q + 2] = p.base.z + p.step.z;
}

/// One Jacobi iteration: `Lanes` threads a particle share its row, `Unroll` half-springs each at a time.
/// Reads the displacements of `now`, writes those of `next`. The first iteration takes all multipliers as
/// zero, the others read them.
template <int Lanes, int Unroll>
__global__ void project(const Particle* __restrict__ now, Particle* __restrict__ next,
                        const int* __restrict__ begin, const HalfSpring* __restrict__ half,
                        float* __restrict__ multiplier, int n, float alpha, bool first) {
  const int i = static_cast<int>((blockIdx.x * static_cast<unsigned>(blockDim.x) + threadIdx.x) / Lanes);
  const int lane = static_cast<int>(threadIdx.x) % Lanes;
  const bool live = i < n;
  const Particle self = now[live ? i : 0];
  const int row_end = live ? begin[i + 1] : 0;
  float3 sum = make_float3(0.0f, 0.0f, 0.0f);
  for (int row = live ? begin[i] + lane : 0; row < row_end; row += Lanes * Unroll) {
    HalfSpring spring[Unroll];
    float old[Unroll];
#pragma unroll
    for (int u = 0; u < Unroll; ++u) {
      const int at = row + u * Lanes;
      spring[u] = {i, 0.0f};  // past the end of the row: a particle's spring to itself, which does nothing
      old[u] = 0.0f;
      if (at < row_end) {
        const int2 loaded = __ldcs(reinterpret_cast<const int2*>(half) + at);
        spring[u] = {loaded.x, __int_as_float(loaded.y)};
        if (!first) old[u] = __ldcs(multiplier + at);
      }
    }
    Particle other[Unroll];
#pragma unroll
    for (int u = 0; u < Unroll; ++u) other[u] = now[spring[u].other];
#pragma unroll
    for (int u = 0; u < Unroll; ++u) {
      const int at = row + u * Lanes;
      const float dx = (self.base.x - other[u].base.x) + (self.step.x - other[u].step.x);
      const float dy = (self.base.y - other[u].base.y) + (self.step.y - other[u].step.y);
      const float dz = (self.base.z - other[u].base.z) + (self.step.z - other[u].step.z);
      const float square = dx * dx + dy * dy + dz * dz;
      const float inv_mass_sum = self.base.w + other[u].base.w;
      float change = 0.0f, per_metre = 0.0f;
      if (square > 0.0f && inv_mass_sum > 0.0f) {
        float length, inverse;
        length_of(square, length, inverse);
        const float valence = fmaxf(self.step.w, other[u].step.w);
        change = multiplier_step(length - spring[u].rest, old[u], alpha, inv_mass_sum, valence);
        per_metre = change * inverse;
      }
      sum.x += per_metre * dx;
      sum.y += per_metre * dy;
      sum.z += per_metre * dz;
      if (at < row_end) __stcs(multiplier + at, old[u] + change);
    }
  }
#pragma unroll
  for (int step = Lanes / 2; step > 0; step /= 2) {
    sum.x += __shfl_xor_sync(0xffffffffu, sum.x, step);
    sum.y += __shfl_xor_sync(0xffffffffu, sum.y, step);
    sum.z += __shfl_xor_sync(0xffffffffu, sum.z, step);
  }
  if (!live || lane != 0) return;
  const float w = self.base.w;
  next[i].step =
      make_float4(self.step.x + w * sum.x, self.step.y + w * sum.y, self.step.z + w * sum.z, self.step.w);
}

/// Rows of half-springs for up to `n` particles and `m` springs, in memory of its own.
class HalfSprings {
 public:
  HalfSprings() = default;
  /// `renumber`: build() will be given a numbering.
  HalfSprings(int n, int m, bool renumber)
      : begin_(static_cast<std::size_t>(n) + 1),
        rank_(static_cast<std::size_t>(m)),
        renumbered_(renumber ? static_cast<std::size_t>(m) : 0),
        half_(2 * static_cast<std::size_t>(m)),
        scratch_bytes_(primitives::exclusive_sum_bytes(n + 1)),
        scratch_(scratch_bytes_) {}

  /// Sorts the springs into rows, of particles renumbered by `number` unless it is null. `threads` is the
  /// block size.
  void build(const int2* ends, const float* rest, const std::int32_t* number, int n, int m,
             int threads) const {
    GPUPHYS_CUDA(cudaMemsetAsync(begin_.get(), 0, sizeof(int) * (static_cast<std::size_t>(n) + 1)));
    const auto blocks = static_cast<unsigned>((m + threads - 1) / threads);
    if (m > 0) {
      count_half_springs<<<blocks, threads>>>(ends, m, number, renumbered_.get(), begin_.get(), rank_.get());
    }
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, begin_.get(), begin_.get(), n + 1);
    if (m > 0) {
      fill_half_springs<<<blocks, threads>>>(number ? renumbered_.get() : ends, rest, rank_.get(),
                                             begin_.get(), m, half_.get());
    }
  }

  const int* begin() const { return begin_.get(); }       ///< (n+1): counts, then where each row begins
  const HalfSpring* half() const { return half_.get(); }  ///< (2m)

 private:
  DeviceBuffer<int> begin_;
  DeviceBuffer<int2> rank_, renumbered_;
  DeviceBuffer<HalfSpring> half_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::springs
