// When four moving points become coplanar: the triple product w . (u x v) of vectors that move linearly over
// the step is a cubic in time, here isolated into monotone pieces and bisected.
#pragma once

#include <cuda_runtime.h>

namespace gpuphys::collision {

__device__ __forceinline__ float3 operator-(float3 a, float3 b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
__device__ __forceinline__ float dot(float3 a, float3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
__device__ __forceinline__ float3 cross(float3 a, float3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

__device__ __forceinline__ float3 operator*(float s, float3 a) {
  return {s * a.x, s * a.y, s * a.z};
}
__device__ __forceinline__ float largest_of(float3 a) {
  return fmaxf(fmaxf(fabsf(a.x), fabsf(a.y)), fabsf(a.z));
}

/// The power of two that brings a length to between 1 and 2 (nearer to it only, beyond 2^-100 and 2^100):
/// products of six lengths, and their squares, stay within float32.
__device__ __forceinline__ float scale_of(float length) {
  const int exponent = min(max(__float_as_int(length) >> 23, 27), 227);
  return __int_as_float((254 - exponent) << 23);
}

/// A vector from `start` at t = 0 that changes by `change` until t = 1.
struct Moving {
  float3 start, change;
  __device__ __forceinline__ float3 at(float t) const {
    return {start.x + t * change.x, start.y + t * change.y, start.z + t * change.z};
  }
  /// The same in a unit in which it is about 1 long.
  __device__ __forceinline__ Moving scaled() const {
    const float scale = scale_of(fmaxf(largest_of(start), largest_of(change)));
    return {scale * start, scale * change};
  }
};

/// c0 + c1 t + c2 t^2 + c3 t^3.
struct Cubic {
  float c0, c1, c2, c3;
  __device__ __forceinline__ float at(float t) const { return c0 + t * (c1 + t * (c2 + t * c3)); }
};

/// w(t) . (u(t) x v(t)), but for a positive factor.
__device__ __forceinline__ Cubic triple_product(const Moving& w_any, const Moving& u_any,
                                                const Moving& v_any) {
  const Moving w = w_any.scaled(), u = u_any.scaled(), v = v_any.scaled();
  const float3 n0 = cross(u.start, v.start), n2 = cross(u.change, v.change);
  const float3 p = cross(u.start, v.change), q = cross(u.change, v.start);
  const float3 n1 = {p.x + q.x, p.y + q.y, p.z + q.z};
  Cubic f;
  f.c0 = dot(w.start, n0);
  f.c1 = dot(w.start, n1) + dot(w.change, n0);
  f.c2 = dot(w.start, n2) + dot(w.change, n1);
  f.c3 = dot(w.change, n2);
  return f;
}

constexpr int kBisections = 30;

/// The change of sign of f in [low, high], on which it is monotone and whose ends differ in sign.
__device__ __forceinline__ float bisect(const Cubic& f, float low, float high, bool from_below) {
#pragma unroll 6
  for (int step = 0; step < kBisections; ++step) {
    const float middle = 0.5f * (low + high);
    const bool below = f.at(middle) < 0.0f;
    low = below == from_below ? middle : low;
    high = below == from_below ? high : middle;
  }
  return 0.5f * (low + high);
}

/// The first change of sign of f in [0, 1] that `accept(t)` takes; 1 if there is none. Zero counts as
/// positive.
template <class Accept>
__device__ __forceinline__ float first_crossing(const Cubic& f, Accept&& accept) {
  // Between its ends and the zeros of its derivative f is monotone. A zero outside (0, 1) moves to an end:
  // its piece is empty.
  float first = 1.0f, second = 1.0f;
  const float discriminant = f.c2 * f.c2 - 3.0f * (f.c3 * f.c1);
  if (discriminant > 0.0f) {
    const float q = -(f.c2 + copysignf(sqrtf(discriminant), f.c2));
    const float r0 = q / (3.0f * f.c3), r1 = f.c1 / q;  // an infinite one lies outside
    const float t0 = r0 > 0.0f && r0 < 1.0f ? r0 : 1.0f, t1 = r1 > 0.0f && r1 < 1.0f ? r1 : 1.0f;
    first = fminf(t0, t1);
    second = fmaxf(t0, t1);
  }
  // Pieces whose ends differ in sign, one bit each: only those are bisected, mostly one, and so the lanes of
  // a warp bisect together whichever piece it is.
  const bool below0 = f.c0 < 0.0f, below1 = f.at(first) < 0.0f;
  const bool below2 = f.at(second) < 0.0f, below3 = f.at(1.0f) < 0.0f;
  unsigned pieces =
      (below0 != below1 ? 1u : 0u) | (below1 != below2 ? 2u : 0u) | (below2 != below3 ? 4u : 0u);
  float impact = 1.0f;
#pragma unroll 1
  while (pieces != 0) {
    const bool in_first = (pieces & 1u) != 0, in_second = (pieces & 3u) == 2u;
    const float low = in_first ? 0.0f : in_second ? first : second;
    const float high = in_first ? first : in_second ? second : 1.0f;
    const float t = bisect(f, low, high, in_first ? below0 : in_second ? below1 : below2);
    if (accept(t)) {
      impact = t;
      break;
    }
    pieces &= pieces - 1u;
  }
  return impact;
}

}  // namespace gpuphys::collision
