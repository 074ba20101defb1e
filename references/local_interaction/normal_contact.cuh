// The normal force of one contact: Hertz, damped, no tension.
#pragma once

#include <cuda_runtime.h>

#include "references/common/approximate.cuh"

namespace gpuphys::granular {

struct NormalLaw {
  float kn, cn;
};

/// What one grain meets in another. Where they do not touch, `push` is 0 and the rest is finite.
struct Contact {
  float3 normal;  // towards the grain
  float overlap;
  float separation;  // its speed
  float push;        // the force along the normal
};

/// Of the grain (sphere, motion) with another one. Neither the grain itself nor one with the same centre
/// pushes: a direction is missing.
__device__ __forceinline__ Contact normal_contact(const float4& sphere, const float4& motion,
                                                  const float4& other, const float4& other_motion,
                                                  NormalLaw law) {
  const float dx = sphere.x - other.x, dy = sphere.y - other.y, dz = sphere.z - other.z;
  float square = dx * dx + dy * dy + dz * dz;
  const float reach = sphere.w + other.w;
  // No branch: nine in ten that get here touch, and both loads of a record are to be under way together.
  const bool touch = square < reach * reach && square > 0.0f;
  if (!touch) square = 1.0f;  // anything finite
  const float inverse = approximate_rsqrt(square);
  float distance = square * inverse;
  distance += 0.5f * inverse * (square - distance * distance);  // the overlap is a small difference of it
  const float nx = dx * inverse, ny = dy * inverse, nz = dz * inverse;
  const float overlap = touch ? fmaxf(reach - distance, 0.0f) : 0.0f;
  const float separation =
      (motion.x - other_motion.x) * nx + (motion.y - other_motion.y) * ny + (motion.z - other_motion.z) * nz;
  const float reduced_radius = sphere.w * other.w * approximate_inverse(reach);
  const float spread = approximate_sqrt(reduced_radius * overlap);
  const float push = fmaxf(spread * (law.kn * overlap - law.cn * separation), 0.0f);
  return {{nx, ny, nz}, overlap, separation, push};
}

}  // namespace gpuphys::granular
