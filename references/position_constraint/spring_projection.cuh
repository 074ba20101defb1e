// Jacobi projection of distance constraints over unordered topology, shared by the XPBD references.
//
// A spring appears twice, once in the list of each of its ends (a compressed row of half-springs a particle),
// and is evaluated twice: every particle gathers its own displacement, so that no iteration needs atomics and
// the result of an end depends on nothing but its row. Both evaluations of a multiplier take the same
// operations on operands that differ in sign only, so the two copies stay bitwise equal.
#pragma once

#include <cstdint>

#include "references/position_constraint/spring_rows.cuh"

namespace gpuphys::springs {

/// Squares of lengths below are taken as those of coincident ends: the hardware's reciprocals know no
/// subnormal numbers.
constexpr float kLeastSquare = 1.17549435e-38f;

/// 1/a and 1/sqrt(a) of normal numbers, each within about one unit in the last place; without the branches
/// that the library spends on subnormal ones.
__device__ __forceinline__ float reciprocal(float a) {
  float result;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(a));
  return result;
}
__device__ __forceinline__ float reciprocal_root(float a) {
  float result;
  asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(result) : "f"(a));
  return result;
}

/// Change of a spring's multiplier in one iteration, before averaging (XPBD equation 18).
__device__ __forceinline__ float multiplier_step(float violation, float multiplier, float alpha,
                                                 float inv_mass_sum, float valence) {
  return -(violation + alpha * multiplier) * reciprocal((inv_mass_sum + alpha) * valence);
}

/// Square root and its reciprocal of a positive normal number, each within about one unit in the last place.
__device__ __forceinline__ void length_of(float square, float& length, float& inverse) {
  inverse = reciprocal_root(square);
  length = square * inverse;
  length += 0.5f * inverse * (square - length * length);  // one Newton step
}

/// x + displacement, rounded once, back in input order. Random reads of whole sectors cost less than random
/// writes of three floats.
__global__ void write_positions(const Particle* __restrict__ particles,
                                const std::int32_t* __restrict__ number, int n, float* __restrict__ x) {
  const int q = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (q >= n) return;
  const Particle p = particles[number[q]];
  x[3 * q] = p.base.x + p.step.x;
  x[3 * q + 1] = p.base.y + p.step.y;
  x[3 * q + 2] = p.base.z + p.step.z;
}

/// One Jacobi iteration: `Lanes` threads a particle share its row, `Unroll` half-springs each at a time.
/// Reads the particles of `now`, writes those of `next`. The first iteration takes all multipliers as zero
/// instead of reading them, the last does not write them.
///
/// `backward`: the blocks go through the particles from the end. Iterations take turns, so that each begins
/// with what the L2 still holds of the one before.
///
/// Even lanes work on `base` and odd ones on `step`: a pair of lanes fetches both half-springs' other ends
/// one after the other, each a whole sector in one access, subtracts, and exchanges what the partner needs.
template <int Lanes, int Unroll>
__global__ void project(const Particle* __restrict__ now, Particle* __restrict__ next,
                        const int* __restrict__ begin, const HalfSpring* __restrict__ half,
                        float* __restrict__ multiplier, int n, float alpha, bool first, bool last,
                        bool backward) {
  static_assert(Lanes >= 2 && Lanes <= 32 && (Lanes & (Lanes - 1)) == 0, "pairs of lanes within a warp");
  constexpr unsigned all = 0xffffffffu;
  const unsigned block = backward ? gridDim.x - 1 - blockIdx.x : blockIdx.x;
  const int i = static_cast<int>((block * static_cast<unsigned>(blockDim.x) + threadIdx.x) / Lanes);
  const int lane = static_cast<int>(threadIdx.x) % Lanes;
  const int odd = lane & 1;
  const bool live = i < n;
  const int me = live ? i : 0;
  const float4* const part = reinterpret_cast<const float4*>(now) + odd;  // part[2 p]: of particle p
  const float4 self = part[2 * me];
  const float partner_w = __shfl_xor_sync(all, self.w, 1);
  const float inv_mass = odd ? partner_w : self.w, own_valence = odd ? self.w : partner_w;
  const int row_begin = live ? begin[me] : 0, row_end = live ? begin[me + 1] : 0;
  float3 sum = make_float3(0.0f, 0.0f, 0.0f);
  // The lanes of a warp go round together, for the longest of its rows: they exchange.
  for (int row = row_begin + lane; __any_sync(all, row - lane < row_end); row += Lanes * Unroll) {
    HalfSpring spring[Unroll];
    float old[Unroll];
#pragma unroll
    for (int u = 0; u < Unroll; ++u) {
      const int at = row + u * Lanes;
      spring[u] = {me, 0.0f};  // past the end of the row: a particle's spring to itself, which does nothing
      old[u] = 0.0f;
      if (at < row_end) {
        spring[u] = half[at];
        if (!first) old[u] = multiplier[at];
      }
    }
    float4 even_part[Unroll], odd_part[Unroll];
#pragma unroll
    for (int u = 0; u < Unroll; ++u) {
      const int partner_other = __shfl_xor_sync(all, spring[u].other, 1);
      even_part[u] = part[2 * (odd ? partner_other : spring[u].other)];
      odd_part[u] = part[2 * (odd ? spring[u].other : partner_other)];
    }
#pragma unroll
    for (int u = 0; u < Unroll; ++u) {
      const int at = row + u * Lanes;
      const float4 mine = odd ? odd_part[u] : even_part[u], yours = odd ? even_part[u] : odd_part[u];
      const float dx = (self.x - mine.x) + __shfl_xor_sync(all, self.x - yours.x, 1);
      const float dy = (self.y - mine.y) + __shfl_xor_sync(all, self.y - yours.y, 1);
      const float dz = (self.z - mine.z) + __shfl_xor_sync(all, self.z - yours.z, 1);
      const float received = __shfl_xor_sync(all, yours.w, 1);
      const float other_inv_mass = odd ? received : mine.w, other_valence = odd ? mine.w : received;
      const float square = dx * dx + dy * dy + dz * dz;
      const float inv_mass_sum = inv_mass + other_inv_mass;
      float change = 0.0f, per_metre = 0.0f;
      if (square >= kLeastSquare && inv_mass_sum > 0.0f) {
        float length, inverse;
        length_of(square, length, inverse);
        const float valence = fmaxf(own_valence, other_valence);
        change = multiplier_step(length - spring[u].rest, old[u], alpha, inv_mass_sum, valence);
        per_metre = change * inverse;
      }
      sum.x += per_metre * dx;
      sum.y += per_metre * dy;
      sum.z += per_metre * dz;
      if (!last && at < row_end) multiplier[at] = old[u] + change;
    }
  }
#pragma unroll
  for (int step = Lanes / 2; step > 0; step /= 2) {
    sum.x += __shfl_xor_sync(all, sum.x, step);
    sum.y += __shfl_xor_sync(all, sum.y, step);
    sum.z += __shfl_xor_sync(all, sum.z, step);
  }
  if (!live || lane > 1) return;
  // Two lanes write the particle's whole sector: the base too, or the L2 would have to read it first.
  const float w = odd ? inv_mass : 0.0f;
  reinterpret_cast<float4*>(next)[2 * i + odd] =
      make_float4(self.x + w * sum.x, self.y + w * sum.y, self.z + w * sum.z, self.w);
}

}  // namespace gpuphys::springs
