// Kirchhoff stress of fixed corotated elasticity (Stomakhin et al. 2012), FP32.
#pragma once

#include "references/common/polar3x3.cuh"

namespace gpuphys::elasticity {

struct SymmetricMatrix {
  float xx, yy, zz, xy, xz, yz;
};

/// tau = two_mu (F - R) F^T + lambda (J - 1) J I. The moduli may carry a common factor.
__device__ __forceinline__ SymmetricMatrix fixed_corotated(const polar::Matrix3& f, float two_mu,
                                                           float lambda) {
  const polar::Matrix3 r = polar::nearest_rotation(f);
  polar::Matrix3 e;
#pragma unroll
  for (int a = 0; a < 3; ++a) {
#pragma unroll
    for (int b = 0; b < 3; ++b)
      e.m[a][b] = f.m[a][b] - r.m[a][b];  // before the product: no cancellation after it
  }
  const auto entry = [&](int a, int b) {
    return two_mu * (e.m[a][0] * f.m[b][0] + e.m[a][1] * f.m[b][1] + e.m[a][2] * f.m[b][2]);
  };
  const float volume = polar::determinant(f, polar::cofactors(f));
  const float pressure = lambda * (volume - 1.0f) * volume;
  SymmetricMatrix stress;
  stress.xx = entry(0, 0) + pressure;
  stress.yy = entry(1, 1) + pressure;
  stress.zz = entry(2, 2) + pressure;
  stress.xy = entry(0, 1);
  stress.xz = entry(0, 2);
  stress.yz = entry(1, 2);
  return stress;
}

}  // namespace gpuphys::elasticity
