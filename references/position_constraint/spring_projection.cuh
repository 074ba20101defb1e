// Jacobi projection of distance constraints over unordered topology, shared by the XPBD references.
//
// A spring appears twice, once in the row of each of its ends (spring_tiles.cuh), and is evaluated twice:
// every particle gathers its own displacement, so that no iteration needs atomics and the result of an end
// depends on nothing but its row. Both evaluations of a multiplier take the same operations on operands that
// differ in sign only, so the two copies stay bitwise equal.
//
// The multiplier enters the constraint only together with the rest length, as -(|d| - (rest - alpha lambda)):
// what is kept of a spring is this shifted rest length, one number to read and one to write.
//
// In shared memory a particle takes 16 bytes (Held): integers instead of position and displacement apart, in
// a unit that suits the tile. A spring's end costs one random read of 16 bytes instead of two, which bound
// the iteration before. What integers do not resolve, springs short against the tile and particles that leave
// it far behind, is looked up in device memory, spring by spring: slower, and as exact as position and
// displacement are.
#pragma once

#include <cstdint>
#include <type_traits>

#include "references/common/approximate.cuh"
#include "references/position_constraint/spatial_order.cuh"
#include "references/position_constraint/spring_tiles.cuh"

namespace gpuphys::springs {

/// Squares of lengths below are taken as those of coincident ends: the hardware's reciprocals know no
/// subnormal numbers.
constexpr float kLeastSquare = 1.17549435e-38f;

/// Change of a spring's multiplier in one iteration, before averaging (XPBD equation 18).
/// `shifted_rest` is rest - alpha lambda.
__device__ __forceinline__ float multiplier_step(float length, float shifted_rest, float alpha,
                                                 float inv_mass_sum, float valence) {
  return -(length - shifted_rest) * approximate_inverse((inv_mass_sum + alpha) * valence);
}

/// Square root and its reciprocal of a positive normal number, each within about one unit in the last place.
__device__ __forceinline__ void length_of(float square, float& length, float& inverse) {
  inverse = approximate_rsqrt(square);
  length = square * inverse;
  length += 0.5f * inverse * (square - length * length);  // one Newton step
}

/// Positions back in input order. Random reads cost less than random writes of three floats.
__global__ void write_positions(const float4* __restrict__ positions, const std::int32_t* __restrict__ number,
                                int n, float* __restrict__ x) {
  const int q = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (q >= n) return;
  const float4 p = positions[number[q]];
  x[3 * q] = p.x;
  x[3 * q + 1] = p.y;
  x[3 * q + 2] = p.z;
}

/// Integer coordinates for a tile: of a unit so small that the tile's particles, and others up to the tile's
/// extent away from it, take a range of 2 kRange units.
struct __align__(16) Frame {
  static constexpr float kRange = 0.75f * (1 << 28);
  float centre[3];  ///< of the tile's bounding box, m
  float per_metre;  ///< units a metre, a power of two

  __device__ static Frame around(const spatial::Bounds& box) {
    Frame f;
    float extent = 1e-20f;
    for (int d = 0; d < 3; ++d) {
      const float low = box.low(d), high = box.high(d);
      f.centre[d] = 0.5f * low + 0.5f * high;
      // A unit far below the last place of the coordinates is of no use, and their integers would overflow.
      extent = fmaxf(fmaxf(extent, high - low), 0x1p-23f * fmaxf(fabsf(low), fabsf(high)));
    }
    f.per_metre = __int_as_float(__float_as_int(kRange / extent) & 0x7f800000);
    return f;
  }
};

/// A particle in shared memory: coordinates as integers, modulo 2^30, of the frame's unit, shifted left by
/// two, and below each two bits of the valence. Differences are exact: only the rounding to the unit is left,
/// wherever the tile lies. Displacements keep their own digits in device memory.
struct __align__(16) Held {
  int x, y, z;
  float inv_mass;  ///< 1/kg

  /// Instead of the valence: to be looked up in device memory, as are the coordinates.
  static constexpr int kLookUp = 63;
  static constexpr float kUnits = 4.0f;  ///< of difference(), in one of the frame
  /// Squares of shorter differences are looked up too: that of 2^21 units of the frame. The rounding of both
  /// ends changes longer ones by 2^-21 of themselves at most, and most of them by much less.
  static constexpr float kLeastSquare = 0x1p46f;

  __device__ __forceinline__ int valence() const {
    return (x & 3) | (y << 2 & 12) | (z << 4 & 48);
  }
};

/// a - b, in quarters of the frame's unit; that of exchanged particles is the same with the other sign.
__device__ __forceinline__ float3 difference(const Held& a, const Held& b) {
  return {static_cast<float>(((a.x | 3) - b.x) & ~3), static_cast<float>(((a.y | 3) - b.y) & ~3),
          static_cast<float>(((a.z | 3) - b.z) & ~3)};
}

/// Makes particles as they are held of those in device memory.
class Holder {
 public:
  __device__ __forceinline__ explicit Holder(const Frame& frame)
      : per_metre_(frame.per_metre), most_(Frame::kRange / frame.per_metre) {
    for (int d = 0; d < 3; ++d) centre_[d] = frame.centre[d];
  }
  __device__ __forceinline__ Held operator()(const float4& base, const float4& step) const {
    const float place[3] = {base.x, base.y, base.z}, moved[3] = {step.x, step.y, step.z};
    float furthest = 0.0f;
    int at[3];
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      // Of the differences that 30 bits hold, the frame takes three quarters and two displacements an eighth.
      furthest = fmaxf(fmaxf(furthest, fabsf(place[d] - centre_[d])), 6.0f * fabsf(moved[d]));
      // Modulo 2^32; the products are exact.
      at[d] = static_cast<int>(__float2ll_rn(place[d] * per_metre_)) + __float2int_rn(moved[d] * per_metre_);
    }
    int code = min(__float_as_int(step.w), Held::kLookUp);
    if (!(furthest <= most_)) code = Held::kLookUp;
    return {at[0] << 2 | (code & 3), at[1] << 2 | (code >> 2 & 3), at[2] << 2 | code >> 4, base.w};
  }

 private:
  float per_metre_, most_, centre_[3];
};

/// Shared memory of project, bytes: particles and two that are none, displacements of the tile's own, and
/// where slices begin.
template <class Shape>
constexpr std::size_t project_bytes() {
  return sizeof(Held) * (Shape::kHeld + 2) + sizeof(float4) * Shape::kParticles +
         sizeof(int) * Shape::kSlices;
}

/// What an iteration works on.
struct Iteration {
  const float4* base;    ///< (n): of Particles
  const float4* now;     ///< (n): `step` of Particles
  float4* next;          ///< (n): the same an iteration later; positions, m, in the last iteration
  float* shifted;        ///< (places): shifted rest lengths, from the second iteration on
  Frame* frame;          ///< (tiles): from the second iteration on
  unsigned char* exact;  ///< (tiles): whether springs of the tile had to be looked up in the first iteration
  float alpha;
  int n;
  bool last;
  bool backward;  ///< blocks go through the tiles from the end
};

/// The rows of the tile that begins with particle `low`: a warp a slice, `Unroll` half-springs a thread at a
/// time. `held` (shared) has the tile, its halo, and behind them one particle to look up and one that is
/// none, `steps` (shared) the tile's displacements so far; `metre` is what a difference of 1 is, m. Takes
/// from device memory springs too short for `held` and, with `LookUp`, those whose ends it has not; returns
/// whether there was any.
template <class Shape, int Threads, int Unroll, bool First, bool LookUp>
__device__ __forceinline__ bool project_rows(const Held* held, const float4* steps, const int* slice,
                                             const Tiles& springs, const Iteration& iteration, float metre,
                                             int low, int particles) {
  constexpr unsigned all = 0xffffffffu;
  constexpr int lanes = Shape::kLanes, rows = Shape::kRows, far = Shape::kHeld, none = Shape::kHeld + 1;
  float* const shifted = iteration.shifted;
  const float* const from = First ? springs.rest : shifted;
  const float alpha = iteration.alpha;
  const bool last = iteration.last;
  bool looked_up = false;
  const int tid = static_cast<int>(threadIdx.x), lane = tid % 32, row_lane = lane % lanes;
  for (int s = tid / 32; s * rows < particles; s += Threads / 32) {
    const int own = s * rows + lane / lanes;
    const bool live = own < particles;
    const int me = live ? own : s * rows;
    const Held self = held[me];
    int own_valence = self.valence();
    if (LookUp && own_valence == Held::kLookUp) own_valence = __float_as_int(steps[me].w);
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
        other[u] = none;  // past the end of the row
        shifted_rest[u] = 0.0f;
        if (k0 + u * lanes < length_of_row) {
          other[u] = __ldcs(springs.local + at);
          if (LookUp) other[u] = min(other[u], far);
          shifted_rest[u] = from[at];
        }
      }
      float3 d[Unroll];
      float inv_mass[Unroll], unit[Unroll];
      int valence[Unroll];
      // Any iteration may bring two ends together.
      bool look_up = LookUp && self.valence() == Held::kLookUp;
#pragma unroll
      for (int u = 0; u < Unroll; ++u) {
        const Held end = held[other[u]];
        d[u] = difference(self, end);
        inv_mass[u] = end.inv_mass;
        valence[u] = end.valence();
        unit[u] = metre;
        look_up = look_up || (LookUp && valence[u] == Held::kLookUp) ||
                  d[u].x * d[u].x + d[u].y * d[u].y + d[u].z * d[u].z < Held::kLeastSquare;
      }
      if (look_up) {
#pragma unroll
        for (int u = 0; u < Unroll; ++u) {
          if (k0 + u * lanes >= length_of_row) continue;
          looked_up = true;
          const int particle =
              other[u] == far ? springs.far[place + u * pitch]
              : other[u] < Shape::kParticles
                  ? low + other[u]
                  : springs.halo[(low >> Shape::kShift) * Shape::kHalo + other[u] - Shape::kParticles];
          const float4 base = iteration.base[low + me], other_base = iteration.base[particle];
          const float4 other_step = iteration.now[particle], before = steps[me];
          d[u] = {(base.x - other_base.x) + (before.x - other_step.x),
                  (base.y - other_base.y) + (before.y - other_step.y),
                  (base.z - other_base.z) + (before.z - other_step.z)};
          inv_mass[u] = other_base.w;
          valence[u] = __float_as_int(other_step.w);
          unit[u] = 1.0f;
        }
      }
#pragma unroll
      for (int u = 0; u < Unroll; ++u) {
        const float square = d[u].x * d[u].x + d[u].y * d[u].y + d[u].z * d[u].z;
        const float inv_mass_sum = self.inv_mass + inv_mass[u];
        float length, inverse;
        length_of(square, length, inverse);
        float change = multiplier_step(length * unit[u], shifted_rest[u], alpha, inv_mass_sum,
                                       static_cast<float>(max(own_valence, valence[u])));
        float per_unit = change * inverse;
        // Whatever came out for coincident or pinned ends is dropped here: cheaper than a branch.
        const bool acts = square >= kLeastSquare && inv_mass_sum > 0.0f;
        change = acts ? change : 0.0f;
        per_unit = acts ? per_unit : 0.0f;
        sum.x += per_unit * d[u].x;
        sum.y += per_unit * d[u].y;
        sum.z += per_unit * d[u].z;
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
    if (!live || row_lane > 0) continue;
    const float4 before = steps[me];
    float4 after = make_float4(before.x + self.inv_mass * sum.x, before.y + self.inv_mass * sum.y,
                               before.z + self.inv_mass * sum.z, before.w);
    if (last) {
      const float4 base = iteration.base[low + me];
      after = make_float4(base.x + after.x, base.y + after.y, base.z + after.z, 0.0f);
    }
    iteration.next[low + me] = after;
  }
  return looked_up;
}

/// One Jacobi iteration, a block a tile: the tile's particles and its halo come to shared memory, `Batch`
/// particles of a thread at a time. The first iteration (`First`) chooses the tile's
/// frame and finds out whether later ones need look anything up.
///
/// Iterations take turns in going backward, so that each begins with what the L2 still holds of the one
/// before.
template <class Shape, int Threads, int BlocksAtOnce, int Unroll, int Batch, bool First>
__global__ void __launch_bounds__(Threads, BlocksAtOnce)
    project(const __grid_constant__ Iteration iteration, const __grid_constant__ Tiles springs) {
  static_assert(Threads % 32 == 0);
  extern __shared__ int4 pool[];
  Held* const held = reinterpret_cast<Held*>(pool);
  float4* const steps = reinterpret_cast<float4*>(held + Shape::kHeld + 2);
  int* const slice = reinterpret_cast<int*>(steps + Shape::kParticles);
  const int tid = static_cast<int>(threadIdx.x);
  const int tile = static_cast<int>(iteration.backward ? gridDim.x - 1 - blockIdx.x : blockIdx.x);
  const int low = tile << Shape::kShift, particles = min(Shape::kParticles, iteration.n - low);
  constexpr int own_turns = (Shape::kParticles + Threads - 1) / Threads;
  constexpr int halo_turns = (Shape::kHalo + Threads - 1) / Threads;
  int outside_at[halo_turns];
#pragma unroll
  for (int j = 0; j < halo_turns; ++j)
    outside_at[j] = springs.halo[tile * Shape::kHalo + min(tid + j * Threads, Shape::kHalo - 1)];
  const int outside = springs.halo_count[tile];
  Frame frame;
  if constexpr (First) {
    __shared__ spatial::Bounds box;
    if (tid == 0) box = {};
    spatial::Bounds most{};
#pragma unroll
    for (int j = 0; j < own_turns; ++j) {
      const float4 p = iteration.base[low + min(tid + j * Threads, particles - 1)];
      spatial::include(most, p.x, p.y, p.z);
    }
    __syncthreads();
    spatial::include(box, most);
    __syncthreads();
    frame = Frame::around(box);
    if (tid == 0) iteration.frame[tile] = frame;
  } else {
    frame = iteration.frame[tile];
  }
  bool look_up = First || iteration.exact[tile] != 0;
  for (int k = tid; k < Shape::kSlices; k += Threads) slice[k] = springs.slice[tile * Shape::kSlices + k];
  if (tid == 0) {
    held[Shape::kHeld] = {3, 3, 3, 0.0f};  // kLookUp
    held[Shape::kHeld + 1] = {0, 0, 0, -__int_as_float(0x7f800000)};
  }
  const Holder hold(frame);
  // Of `count` particles the thread takes number tid + j Threads for j below `turns`: that is particle at(j).
  const auto load = [&](auto turns, int count, auto&& at, auto&& keep) {
#pragma unroll
    for (int j0 = 0; j0 < turns.value; j0 += Batch) {
      if (j0 * Threads >= count) break;
      float4 base[Batch], step[Batch];
#pragma unroll
      for (int j = 0; j < Batch && j0 + j < turns.value; ++j) {
        base[j] = iteration.base[at(j0 + j)];
        step[j] = iteration.now[at(j0 + j)];
      }
#pragma unroll
      for (int j = 0; j < Batch && j0 + j < turns.value; ++j) {
        const int k = tid + (j0 + j) * Threads;
        const Held p = hold(base[j], step[j]);
        if (k >= count) continue;
        look_up = look_up || p.valence() == Held::kLookUp;
        keep(k, p, step[j]);
      }
    }
  };
  load(
      std::integral_constant<int, own_turns>{}, particles,
      [&](int j) { return low + min(tid + j * Threads, particles - 1); },
      [&](int k, const Held& p, const float4& step) {
        held[k] = p;
        steps[k] = step;
      });
  load(
      std::integral_constant<int, halo_turns>{}, outside, [&](int j) { return outside_at[j]; },
      [&](int k, const Held& p, const float4&) { held[Shape::kParticles + k] = p; });
  look_up = __syncthreads_or(look_up) != 0;
  const float metre = 1.0f / (Held::kUnits * frame.per_metre);
  if constexpr (First) {
    const bool looked_up = project_rows<Shape, Threads, Unroll, First, true>(
        held, steps, slice, springs, iteration, metre, low, particles);
    const bool any = __syncthreads_or(looked_up) != 0;
    if (tid == 0) iteration.exact[tile] = any ? 1 : 0;
  } else if (look_up) {
    project_rows<Shape, Threads, Unroll, First, true>(held, steps, slice, springs, iteration, metre, low,
                                                      particles);
  } else {
    project_rows<Shape, Threads, Unroll, First, false>(held, steps, slice, springs, iteration, metre, low,
                                                       particles);
  }
}

}  // namespace gpuphys::springs
