// When four moving points become coplanar: the triple product w . (u x v) of vectors that move linearly over
// the step is a cubic in time, here isolated into monotone pieces and bisected.
//
// Any lengths will do: vectors are brought to size 1 by powers of two, which round nothing, before they are
// multiplied, and so are the cubic's coefficients before they are squared. All lengths being as they are, a
// coordinate of 1e6 m would leave the range of float32 in the discriminant, and one of 1e-8 m likewise.
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

/// A vector from `start` at t = 0 that changes by `change` until t = 1.
struct Moving {
  float3 start, change;
  __device__ __forceinline__ float3 at(float t) const {
    return {start.x + t * change.x, start.y + t * change.y, start.z + t * change.z};
  }
};

/// The power of two that brings `largest` (not negative) into [1, 2).
__device__ __forceinline__ float to_unit(float largest) {
  const unsigned exponent = max(__float_as_uint(largest) >> 23, 1u);
  return __uint_as_float((254u - min(exponent, 253u)) << 23);
}
__device__ __forceinline__ float largest_coordinate(float3 a) {
  return fmaxf(fmaxf(fabsf(a.x), fabsf(a.y)), fabsf(a.z));
}

/// Where `to` is, seen from `from`: differences of given positions come first, then their change.
__device__ __forceinline__ Moving relative(float3 from0, float3 to0, float3 from1, float3 to1) {
  const float3 start = to0 - from0;
  return {start, (to1 - from1) - start};
}

/// Scales a vector, or what is larger, to a largest coordinate near 1 over the step; returns the factor, a
/// power of two.
__device__ __forceinline__ float normalise(Moving& v, float larger = 0.0f) {
  const float unit = to_unit(fmaxf(fmaxf(largest_coordinate(v.start), largest_coordinate(v.change)), larger));
  v = {{unit * v.start.x, unit * v.start.y, unit * v.start.z},
       {unit * v.change.x, unit * v.change.y, unit * v.change.z}};
  return unit;
}

/// c0 + c1 t + c2 t^2 + c3 t^3.
struct Cubic {
  float c0, c1, c2, c3;
  __device__ __forceinline__ float at(float t) const { return c0 + t * (c1 + t * (c2 + t * c3)); }
};

/// The cubic by a positive factor that makes its largest coefficient about 1.
__device__ __forceinline__ Cubic normalised(const Cubic& f) {
  const float unit = to_unit(fmaxf(fmaxf(fabsf(f.c0), fabsf(f.c1)), fmaxf(fabsf(f.c2), fabsf(f.c3))));
  return {unit * f.c0, unit * f.c1, unit * f.c2, unit * f.c3};
}

/// w(t) . (u(t) x v(t)) of normalised vectors, up to a factor that makes its largest coefficient about 1.
__device__ __forceinline__ Cubic triple_product(const Moving& w, const Moving& u, const Moving& v) {
  const float3 n0 = cross(u.start, v.start), n2 = cross(u.change, v.change);
  const float3 p = cross(u.start, v.change), q = cross(u.change, v.start);
  const float3 n1 = {p.x + q.x, p.y + q.y, p.z + q.z};
  Cubic f;
  f.c0 = dot(w.start, n0);
  f.c1 = dot(w.start, n1) + dot(w.change, n0);
  f.c2 = dot(w.start, n2) + dot(w.change, n1);
  f.c3 = dot(w.change, n2);
  return normalised(f);
}

/// Where three coplanar vectors satisfy w = s u + r v: s and r as numerators over |N|^2, N = u x v.
struct Fractions {
  float s, r, nn;
  bool parallel;
};
__device__ __forceinline__ Fractions fractions(float3 w, float3 u, float3 v) {
  const float3 n = cross(u, v);
  const float nn = dot(n, n);
  return {dot(cross(w, v), n), dot(cross(u, w), n), nn, !(nn > 1e-12f * (dot(u, u) * dot(v, v)))};
}

constexpr int kBisections = 30;

/// Where `before(t)`, true at `low` and false at `high`, changes.
template <class Before>
__device__ __forceinline__ float bisect(Before&& before, float low, float high) {
#pragma unroll 6
  for (int step = 0; step < kBisections; ++step) {
    const float middle = 0.5f * (low + high);
    const bool go_on = before(middle);
    low = go_on ? middle : low;
    high = go_on ? high : middle;
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
    const bool from_below = in_first ? below0 : in_second ? below1 : below2;
    const float t = bisect([&](float at) { return (f.at(at) < 0.0f) == from_below; }, low, high);
    if (accept(t)) {
      impact = t;
      break;
    }
    pieces &= pieces - 1u;
  }
  return impact;
}

}  // namespace gpuphys::collision
