// Quadratic B-spline weights and slopes of the three nodes around a point, FP32.
//
// With t in [-1/2, 1/2] the distance (in cells) of the point from the middle one of its three nodes:
//   w = (1/2 (1/2 - t)^2, 3/4 - t^2, 1/2 (1/2 + t)^2),   dw/dt = (t - 1/2, -2 t, t + 1/2).
// The outer weights are squares of differences, so that they keep all their digits where they vanish: a node
// whose whole mass is one such weight still gets an accurate velocity. (Expanded in powers of t they would
// not.)
#pragma once

namespace gpuphys::bspline {

struct Weights {
  float w[3];      ///< of the lower, middle and upper node
  float slope[3];  ///< dw/dt, per cell
};

__device__ __forceinline__ Weights quadratic(float t) {
  const float low = 0.5f - t, high = 0.5f + t;
  return {{0.5f * low * low, 0.75f - t * t, 0.5f * high * high}, {-low, -2.0f * t, high}};
}

}  // namespace gpuphys::bspline
