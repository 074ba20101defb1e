// The rotation nearest to a 3x3 matrix, FP32, for every finite matrix.
//
// R is the rotation (det +1) that maximises tr(R^T F): the orthogonal polar factor when det F > 0; with det F
// < 0 the direction of the smallest singular value is turned round.
//
// Two ways to it. Deformation gradients are near rotations nearly always: Newton's iteration
// X <- (X + X^-T) / 2 (Higham 1986) then takes three or four steps of some 45 instructions. Whatever it does
// not settle in six steps (inverted, flat, far too large or small) goes to Jacobi's eigenvalue method on the
// 4x4 symmetric matrix K with tr(R(q)^T F) = q^T K q (Horn 1987): its dominant eigenvector is the quaternion
// of R. That is backward stable and knows no special cases, at the cost of a few thousand instructions.
#pragma once

namespace gpuphys::polar {

struct Matrix3 {
  float m[3][3];
};

__device__ __forceinline__ Matrix3 cofactors(const Matrix3& a) {
  Matrix3 c;
#pragma unroll
  for (int i = 0; i < 3; ++i) {
    const int i1 = (i + 1) % 3, i2 = (i + 2) % 3;
#pragma unroll
    for (int j = 0; j < 3; ++j) {
      const int j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      c.m[i][j] = a.m[i1][j1] * a.m[i2][j2] - a.m[i1][j2] * a.m[i2][j1];
    }
  }
  return c;
}

__device__ __forceinline__ float determinant(const Matrix3& a, const Matrix3& cofactor) {
  return a.m[0][0] * cofactor.m[0][0] + a.m[0][1] * cofactor.m[0][1] + a.m[0][2] * cofactor.m[0][2];
}

/// Newton's iteration; false when it does not apply or does not settle.
__device__ __forceinline__ bool newton_rotation(const Matrix3& f, Matrix3& x) {
  constexpr float smallest_determinant = 0.1f;  // below, X^-T would carry too much of the rounding of F
  constexpr float settled = 4e-8f;              // the error after a step is half the square of the step
  x = f;
  for (int step = 0; step < 6; ++step) {
    const Matrix3 c = cofactors(x);
    const float det = determinant(x, c);
    if (!(det > smallest_determinant)) return false;
    const float half_inverse = 0.5f / det;
    float change = 0.0f;
#pragma unroll
    for (int i = 0; i < 3; ++i) {
#pragma unroll
      for (int j = 0; j < 3; ++j) {
        const float next = 0.5f * x.m[i][j] + half_inverse * c.m[i][j];
        const float d = next - x.m[i][j];
        change += d * d;
        x.m[i][j] = next;
      }
    }
    if (change < settled) return true;
  }
  return false;
}

/// A quaternion (w, x, y, z), not normalised, of the nearest rotation, by Jacobi's method. By value and out
/// of line: callers keep their matrices in registers.
__device__ __noinline__ float4 jacobi_rotation(float f00, float f01, float f02, float f10, float f11,
                                               float f12, float f20, float f21, float f22) {
  const float size =
      fmaxf(fmaxf(fmaxf(fabsf(f00), fabsf(f01)), fmaxf(fabsf(f02), fabsf(f10))),
            fmaxf(fmaxf(fabsf(f11), fabsf(f12)), fmaxf(fmaxf(fabsf(f20), fabsf(f21)), fabsf(f22))));
  if (!(size > 0.0f)) return make_float4(1.0f, 0.0f, 0.0f, 0.0f);  // F = 0: any rotation
  const float s = 1.0f / fmaxf(size, 1e-37f);
  f00 *= s, f01 *= s, f02 *= s, f10 *= s, f11 *= s, f12 *= s, f20 *= s, f21 *= s, f22 *= s;
  float a[4][4] = {{f00 + f11 + f22, f21 - f12, f02 - f20, f10 - f01},
                   {f21 - f12, f00 - f11 - f22, f01 + f10, f02 + f20},
                   {f02 - f20, f01 + f10, f11 - f00 - f22, f12 + f21},
                   {f10 - f01, f02 + f20, f12 + f21, f22 - f00 - f11}};
  float v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};  // columns are eigenvectors
  for (int sweep = 0; sweep < 10; ++sweep) {
    float off = 0.0f;
#pragma unroll
    for (int p = 0; p < 3; ++p) {
#pragma unroll
      for (int q = p + 1; q < 4; ++q) off += a[p][q] * a[p][q];
    }
    if (off < 1e-15f) break;
#pragma unroll
    for (int p = 0; p < 3; ++p) {
#pragma unroll
      for (int q = p + 1; q < 4; ++q) {
        if (fabsf(a[p][q]) < 1e-12f) continue;
        const float zeta = (a[q][q] - a[p][p]) / (2.0f * a[p][q]);
        const float t = copysignf(1.0f, zeta) / (fabsf(zeta) + sqrtf(1.0f + zeta * zeta));
        const float c = 1.0f / sqrtf(1.0f + t * t), sn = c * t;
        a[p][p] -= t * a[p][q];
        a[q][q] += t * a[p][q];
        a[p][q] = a[q][p] = 0.0f;
#pragma unroll
        for (int r = 0; r < 4; ++r) {
          if (r != p && r != q) {
            const float rp = a[r][p], rq = a[r][q];
            a[r][p] = a[p][r] = c * rp - sn * rq;
            a[r][q] = a[q][r] = sn * rp + c * rq;
          }
          const float vp = v[r][p], vq = v[r][q];
          v[r][p] = c * vp - sn * vq;
          v[r][q] = sn * vp + c * vq;
        }
      }
    }
  }
  float best = a[0][0];
  float4 q = make_float4(v[0][0], v[1][0], v[2][0], v[3][0]);
#pragma unroll
  for (int e = 1; e < 4; ++e) {
    if (a[e][e] > best) {
      best = a[e][e];
      q = make_float4(v[0][e], v[1][e], v[2][e], v[3][e]);
    }
  }
  return q;
}

/// The rotation of a quaternion of any length.
__device__ __forceinline__ Matrix3 matrix_of(const float4& quaternion) {
  const float w = quaternion.x, x = quaternion.y, y = quaternion.z, z = quaternion.w;
  const float s = 2.0f / (w * w + x * x + y * y + z * z);
  return {{{1.0f - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)},
           {s * (x * y + w * z), 1.0f - s * (x * x + z * z), s * (y * z - w * x)},
           {s * (x * z - w * y), s * (y * z + w * x), 1.0f - s * (x * x + y * y)}}};
}

__device__ __forceinline__ Matrix3 nearest_rotation(const Matrix3& f) {
  Matrix3 r;
  if (!newton_rotation(f, r)) {
    r = matrix_of(jacobi_rotation(f.m[0][0], f.m[0][1], f.m[0][2], f.m[1][0], f.m[1][1], f.m[1][2], f.m[2][0],
                                  f.m[2][1], f.m[2][2]));
  }
  return r;
}

}  // namespace gpuphys::polar
