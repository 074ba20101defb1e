// Kirchhoff stress of fixed corotated elasticity (Stomakhin et al. 2012), FP32.
//
// With F = V R, V symmetric, the stress needs (F - R) F^T = V^2 - V and det F. Near rotations it comes
// without R: G = F F^T - I is taken without cancellation, V = I + E is a polynomial in G by Cayley and
// Hamilton (Hoger and Carlson 1984), and its coefficients follow from the invariants of E, of which the trace
// t is a simple root of a quartic: two Newton steps. About 120 instructions without a branch, and fewer
// roundings than by R.
#pragma once

#include "references/common/polar3x3.cuh"

namespace gpuphys::elasticity {

struct SymmetricMatrix {
  float xx, yy, zz, xy, xz, yz;
};

/// V^2 - V, and det F - 1; false, with `expansion` valid all the same, when F is not near a rotation.
__device__ __forceinline__ bool strain_near_rotation(const polar::Matrix3& f, SymmetricMatrix& strain,
                                                     float& expansion) {
  constexpr float largest_square = 0.25f;  // of G: the trace is then good to 1e-8
  const auto entry = [&](int a, int b) {
    return f.m[a][0] * f.m[b][0] + (f.m[a][1] * f.m[b][1] + (f.m[a][2] * f.m[b][2] - (a == b ? 1.0f : 0.0f)));
  };
  const SymmetricMatrix g = {entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)};
  const float c0 = f.m[1][1] * f.m[2][2] - f.m[1][2] * f.m[2][1],
              c1 = f.m[1][2] * f.m[2][0] - f.m[1][0] * f.m[2][2],
              c2 = f.m[1][0] * f.m[2][1] - f.m[1][1] * f.m[2][0];
  const float j = f.m[0][0] * c0 + (f.m[0][1] * c1 + (f.m[0][2] * c2 - 1.0f));
  expansion = j;
  const SymmetricMatrix square = {
      g.xx * g.xx + g.xy * g.xy + g.xz * g.xz, g.xy * g.xy + g.yy * g.yy + g.yz * g.yz,
      g.xz * g.xz + g.yz * g.yz + g.zz * g.zz, g.xx * g.xy + g.xy * g.yy + g.xz * g.yz,
      g.xx * g.xz + g.xy * g.yz + g.xz * g.zz, g.xy * g.xz + g.yy * g.yz + g.yz * g.zz};
  const float trace = g.xx + g.yy + g.zz, square_trace = square.xx + square.yy + square.zz;

  // t^4 + 12 t^3 + p2 t^2 + p1 t + p0 = 0; the first guess is E = G / 2 - G^2 / 8.
  const float p2 = 48.0f - 2.0f * trace, p1 = 64.0f - 12.0f * trace - 8.0f * j,
              p0 = 2.0f * square_trace - trace * (trace + 20.0f) - 24.0f * j;
  float t = 0.5f * trace - 0.125f * square_trace;
#pragma unroll
  for (int step = 0; step < 2; ++step) {
    const float value = (((t + 12.0f) * t + p2) * t + p1) * t + p0;
    const float slope = ((4.0f * t + 36.0f) * t + 2.0f * p2) * t + p1;
    t -= __fdividef(value, slope);
  }
  const float e2 = t + 0.5f * (t * t - trace), e3 = j - t - e2;  // second invariant and determinant of E
  // E = (from_unit I + from_g G - G^2) / scale, and V^2 - V = G - E.
  const float from_unit = (4.0f + t) * e3, from_g = (4.0f + t) * t + (4.0f - e2);
  const float scale = (2.0f * t + 9.0f) * t + ((3.0f + t) * e2 + (8.0f - j));
  const float inverse = __fdividef(1.0f, scale), along_g = (scale - from_g) * inverse;
  strain = {along_g * g.xx + inverse * (square.xx - from_unit),
            along_g * g.yy + inverse * (square.yy - from_unit),
            along_g * g.zz + inverse * (square.zz - from_unit),
            along_g * g.xy + inverse * square.xy,
            along_g * g.xz + inverse * square.xz,
            along_g * g.yz + inverse * square.yz};
  return square_trace < largest_square && j > -0.5f;
}

/// (F - R) F^T for every F.
__device__ __forceinline__ SymmetricMatrix strain_by_rotation(const polar::Matrix3& f) {
  const polar::Matrix3 r = polar::nearest_rotation(f);
  polar::Matrix3 e;
#pragma unroll
  for (int a = 0; a < 3; ++a) {
#pragma unroll
    for (int b = 0; b < 3; ++b)
      e.m[a][b] = f.m[a][b] - r.m[a][b];  // before the product: no cancellation after it
  }
  const auto entry = [&](int a, int b) {
    return e.m[a][0] * f.m[b][0] + e.m[a][1] * f.m[b][1] + e.m[a][2] * f.m[b][2];
  };
  return {entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)};
}

/// tau = two_mu (F - R) F^T + lambda (J - 1) J I. The moduli may carry a common factor.
__device__ __forceinline__ SymmetricMatrix fixed_corotated(const polar::Matrix3& f, float two_mu,
                                                           float lambda) {
  SymmetricMatrix strain;
  float expansion;
  if (!strain_near_rotation(f, strain, expansion)) strain = strain_by_rotation(f);
  const float pressure = lambda * expansion * (expansion + 1.0f);
  return {two_mu * strain.xx + pressure,
          two_mu * strain.yy + pressure,
          two_mu * strain.zz + pressure,
          two_mu * strain.xy,
          two_mu * strain.xz,
          two_mu * strain.yz};
}

}  // namespace gpuphys::elasticity
