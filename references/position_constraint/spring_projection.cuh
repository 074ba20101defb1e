// Jacobi projection of distance constraints over unordered topology, shared by the XPBD references.
//
// A spring appears twice, once in the row of each of its ends (spring_tiles.cuh), and is evaluated twice:
// every particle gathers its own displacement, so that no iteration needs atomics and the result of an end
// depends on nothing but its row. Both evaluations of a multiplier take the same operations on operands that
// differ in sign only, so the two copies stay bitwise equal.
//
// The multiplier enters the constraint only together with the rest length, as -(|d| - (rest - alpha lambda)):
// what is kept of a spring is this shifted rest length, one number to read and one to write.
#pragma once

#include <cstdint>

#include "references/position_constraint/spring_tiles.cuh"

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
/// `shifted_rest` is rest - alpha lambda.
__device__ __forceinline__ float multiplier_step(float length, float shifted_rest, float alpha,
                                                 float inv_mass_sum, float valence) {
  return -(length - shifted_rest) * reciprocal((inv_mass_sum + alpha) * valence);
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

/// Shared memory of project, bytes. The displacements begin in other banks than the positions.
template <class Shape>
constexpr std::size_t project_bytes() {
  return sizeof(float4) * (2 * Shape::kHeld + 4) + sizeof(int) * Shape::kSlices;
}

/// One Jacobi iteration, a block a tile: particles of the tile and its halo come to shared memory, then a
/// warp a slice goes through its rows, `Unroll` half-springs a thread at a time. `shifted` has the shifted
/// rest lengths, from the second iteration on.
///
/// `backward`: the blocks go through the tiles from the end. Iterations take turns, so that each begins with
/// what the L2 still holds of the one before.
template <class Shape, int Threads, int BlocksAtOnce, int Unroll>
__global__ void __launch_bounds__(Threads, BlocksAtOnce)
    project(const Particle* __restrict__ now, Particle* __restrict__ next, const Tiles springs,
            float* __restrict__ shifted, int n, float alpha, bool first, bool last, bool backward) {
  constexpr unsigned all = 0xffffffffu;
  constexpr int lanes = Shape::kLanes, rows = Shape::kRows;
  extern __shared__ int4 pool[];
  float4* const base = reinterpret_cast<float4*>(pool);
  float4* const step = base + Shape::kHeld + 4;
  int* const slice = reinterpret_cast<int*>(step + Shape::kHeld);
  const int tid = static_cast<int>(threadIdx.x);
  const int tile = static_cast<int>(backward ? gridDim.x - 1 - blockIdx.x : blockIdx.x);
  const int low = tile << Shape::kShift, particles = min(Shape::kParticles, n - low);
  const float4* const part = reinterpret_cast<const float4*>(now);
#pragma unroll 4
  for (int k = tid; k < 2 * particles; k += Threads) (k & 1 ? step : base)[k / 2] = part[2 * low + k];
  for (int k = tid; k < Shape::kSlices; k += Threads) slice[k] = springs.slice[tile * Shape::kSlices + k];
  // Two threads fetch a particle of the halo, a whole sector in one access.
  const int outside = springs.halo_count[tile];
  const std::int32_t* const halo = springs.halo + tile * Shape::kHalo;
#pragma unroll 4
  for (int k = tid; k < 2 * outside; k += Threads)
    (k & 1 ? step : base)[Shape::kParticles + k / 2] = part[2 * halo[k / 2] + (k & 1)];
  __syncthreads();

  const float* const from = first ? springs.rest : shifted;
  const int lane = tid % 32, row_lane = lane % lanes;
  for (int s = tid / 32; s * rows < particles; s += Threads / 32) {
    const int own = s * rows + lane / lanes;
    const bool live = own < particles;
    const int me = live ? own : s * rows;
    const float4 own_base = base[me], own_step = step[me];
    const int own_valence = __float_as_int(own_step.w);
    const int length_of_row = live ? own_valence : 0;
    const int longest = static_cast<int>(__reduce_max_sync(all, static_cast<unsigned>(length_of_row)));
    const int code = slice[s];
    int place = code + lane, pitch = 32;  // of the row's half-spring `row_lane`; to the one `lanes` further
    if (code % 2 == 1) {                  // rows one after the other
      int through = row_lane == 0 ? length_of_row : 0;
#pragma unroll
      for (int d = 1; d < 32; d *= 2) {
        const int below = __shfl_up_sync(all, through, d);
        if (lane >= d) through += below;
      }
      place = code - 1 + through - length_of_row + row_lane;
      pitch = lanes;
    }
    float3 sum = make_float3(0.0f, 0.0f, 0.0f);
    for (int k0 = row_lane; k0 - row_lane < longest; k0 += lanes * Unroll, place += pitch * Unroll) {
      int other[Unroll];
      float shifted_rest[Unroll];
#pragma unroll
      for (int u = 0; u < Unroll; ++u) {
        const int at = place + u * pitch;
        other[u] = me;  // past the end of the row: a particle's spring to itself, which does nothing
        shifted_rest[u] = 0.0f;
        if (k0 + u * lanes < length_of_row) {
          other[u] = __ldcs(springs.local + at);
          shifted_rest[u] = from[at];
        }
      }
      float4 other_base[Unroll], other_step[Unroll];
      bool far = false;
#pragma unroll
      for (int u = 0; u < Unroll; ++u) {
        const bool away = other[u] == kFar;
        const int held = away ? me : other[u];
        other_base[u] = base[held];
        other_step[u] = step[held];
        far |= away;
      }
      if (far) {
#pragma unroll
        for (int u = 0; u < Unroll; ++u) {
          if (other[u] != kFar) continue;
          const int particle = springs.far[place + u * pitch];
          other_base[u] = part[2 * particle];
          other_step[u] = part[2 * particle + 1];
        }
      }
#pragma unroll
      for (int u = 0; u < Unroll; ++u) {
        const float dx = (own_base.x - other_base[u].x) + (own_step.x - other_step[u].x);
        const float dy = (own_base.y - other_base[u].y) + (own_step.y - other_step[u].y);
        const float dz = (own_base.z - other_base[u].z) + (own_step.z - other_step[u].z);
        const float square = dx * dx + dy * dy + dz * dz;
        const float inv_mass_sum = own_base.w + other_base[u].w;
        float length, inverse;
        length_of(square, length, inverse);
        const auto valence = static_cast<float>(max(own_valence, __float_as_int(other_step[u].w)));
        float change = multiplier_step(length, shifted_rest[u], alpha, inv_mass_sum, valence);
        float per_metre = change * inverse;
        // Whatever came out for coincident or pinned ends is dropped here: cheaper than a branch.
        const bool acts = square >= kLeastSquare && inv_mass_sum > 0.0f;
        change = acts ? change : 0.0f;
        per_metre = acts ? per_metre : 0.0f;
        sum.x += per_metre * dx;
        sum.y += per_metre * dy;
        sum.z += per_metre * dz;
        if (!last && k0 + u * lanes < length_of_row)
          shifted[place + u * pitch] = shifted_rest[u] - alpha * change;
      }
    }
#pragma unroll
    for (int d = lanes / 2; d > 0; d /= 2) {
      sum.x += __shfl_xor_sync(all, sum.x, d);
      sum.y += __shfl_xor_sync(all, sum.y, d);
      sum.z += __shfl_xor_sync(all, sum.z, d);
    }
    if (!live || row_lane > 1) continue;
    // Two threads write the particle's whole sector: the base too, or the L2 would have to read it first.
    const bool odd = row_lane == 1;
    const float4 self = odd ? own_step : own_base;
    const float w = odd ? own_base.w : 0.0f;
    reinterpret_cast<float4*>(next)[2 * (low + own) + (odd ? 1 : 0)] =
        make_float4(self.x + w * sum.x, self.y + w * sum.y, self.z + w * sum.z, self.w);
  }
}

}  // namespace gpuphys::springs
