// What a particle of a material point method does with the velocity and the velocity gradient at its place,
// FP32.
#pragma once

namespace gpuphys::particle_grid {

/// F' = (I + dt G) F, as F + (dt G) F: a small step does not pass through I. `step` = dt G, row by row: dt
/// dv_a/dx_b at step[a][b].
__device__ __forceinline__ void deform(const float (&step)[3][3], const float (&f)[9], float (&f_new)[9]) {
#pragma unroll
  for (int a = 0; a < 3; ++a) {
#pragma unroll
    for (int b = 0; b < 3; ++b)
      f_new[3 * a + b] = f[3 * a + b] + (step[a][0] * f[b] + step[a][1] * f[3 + b] + step[a][2] * f[6 + b]);
  }
}

/// x' = x + dt v.
__device__ __forceinline__ void move(const float (&x)[3], float dt, const float (&v)[3], float (&x_new)[3]) {
#pragma unroll
  for (int d = 0; d < 3; ++d) x_new[d] = x[d] + dt * v[d];
}

}  // namespace gpuphys::particle_grid
