// Neo-Hookean elasticity of linear tetrahedra, FP32: energy density mu/2 (|F|^2 - 3) - mu ln J + lambda/2
// ln^2 J, stress P = mu (F - F^-T) + lambda ln J F^-T.
//
// Near rest, F - F^-T is a small difference of numbers near one. With G = F - I, which differences of edges
// give without loss, it is a sum of small terms:
//   j = det F - 1 = tr G + tr cof G + det G,   cof F = (1 + tr G) I - G^T + cof G,
//   (1 + j) (F - F^-T) = G + G^T + (j - tr G) I + j G - cof G.
// Where G is not small, that would lose what the plain formulas keep (det F near zero), and they take over.
#pragma once

#include <cmath>

namespace gpuphys::elastic {

/// Rows m[i]; edges of a tetrahedron are columns.
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

/// a b^T / divisor.
__device__ __forceinline__ Matrix3 over(const Matrix3& a, const Matrix3& b, float divisor) {
  const float inverse = 1.0f / divisor;
  Matrix3 c;
#pragma unroll
  for (int i = 0; i < 3; ++i) {
#pragma unroll
    for (int j = 0; j < 3; ++j)
      c.m[i][j] = (a.m[i][0] * b.m[j][0] + a.m[i][1] * b.m[j][1] + a.m[i][2] * b.m[j][2]) * inverse;
  }
  return c;
}

__device__ __forceinline__ float largest_entry(const Matrix3& a) {
  float largest = 0.0f;
#pragma unroll
  for (int i = 0; i < 9; ++i) largest = fmaxf(largest, fabsf(a.m[i / 3][i % 3]));
  return largest;
}

/// The stress where F = I + g is near rest.
__device__ __forceinline__ Matrix3 stress_near_rest(const Matrix3& g, float mu, float lambda) {
  const Matrix3 c = cofactors(g);
  const float trace = g.m[0][0] + g.m[1][1] + g.m[2][2];
  const float second = c.m[0][0] + c.m[1][1] + c.m[2][2] + determinant(g, c);  // j - tr G
  const float j = trace + second;
  const float inverse = 1.0f / (1.0f + j), pressure = lambda * log1pf(j);
  Matrix3 p;
#pragma unroll
  for (int a = 0; a < 3; ++a) {
#pragma unroll
    for (int b = 0; b < 3; ++b) {
      const float shear = g.m[a][b] + g.m[b][a] + (a == b ? second : 0.0f) + (j * g.m[a][b] - c.m[a][b]);
      const float cofactor = (a == b ? 1.0f + trace : 0.0f) - g.m[b][a] + c.m[a][b];
      p.m[a][b] = (mu * shear + pressure * cofactor) * inverse;
    }
  }
  return p;
}

/// The stress for any F with det F > 0.
__device__ __forceinline__ Matrix3 stress_far_from_rest(const Matrix3& f, float mu, float lambda) {
  const Matrix3 c = cofactors(f);
  const float j = determinant(f, c);
  const float inverse = 1.0f / j, pressure = lambda * logf(j);
  Matrix3 p;
#pragma unroll
  for (int a = 0; a < 3; ++a) {
#pragma unroll
    for (int b = 0; b < 3; ++b)
      p.m[a][b] = mu * (f.m[a][b] - c.m[a][b] * inverse) + pressure * (c.m[a][b] * inverse);
  }
  return p;
}

/// Edges now and at rest.
__device__ __forceinline__ Matrix3 stress(const Matrix3& edges, const Matrix3& rest,
                                          const Matrix3& rest_cofactors, float rest_determinant, float mu,
                                          float lambda) {
  constexpr float near = 0.25f;
  Matrix3 moved;
#pragma unroll
  for (int i = 0; i < 9; ++i) moved.m[i / 3][i % 3] = edges.m[i / 3][i % 3] - rest.m[i / 3][i % 3];
  const Matrix3 g = over(moved, rest_cofactors, rest_determinant);
  if (largest_entry(g) <= near) return stress_near_rest(g, mu, lambda);
  return stress_far_from_rest(over(edges, rest_cofactors, rest_determinant), mu, lambda);
}

/// Energy density; infinite where det F <= 0. Near rest, mu (tr G + |G|^2 / 2 - ln J) keeps what the plain
/// formula loses.
__device__ __forceinline__ float energy(const Matrix3& edges, const Matrix3& rest,
                                        const Matrix3& rest_cofactors, float rest_determinant, float mu,
                                        float lambda) {
  constexpr float near = 0.25f;
  Matrix3 moved;
#pragma unroll
  for (int i = 0; i < 9; ++i) moved.m[i / 3][i % 3] = edges.m[i / 3][i % 3] - rest.m[i / 3][i % 3];
  const Matrix3 g = over(moved, rest_cofactors, rest_determinant), c = cofactors(g);
  float square = 0.0f;
  if (largest_entry(g) <= near) {
    const float trace = g.m[0][0] + g.m[1][1] + g.m[2][2];
    const float log_j = log1pf(trace + (c.m[0][0] + c.m[1][1] + c.m[2][2] + determinant(g, c)));
#pragma unroll
    for (int i = 0; i < 9; ++i) square += g.m[i / 3][i % 3] * g.m[i / 3][i % 3];
    return mu * (0.5f * square + (trace - log_j)) + 0.5f * lambda * log_j * log_j;
  }
  const Matrix3 f = over(edges, rest_cofactors, rest_determinant);
  const float j = determinant(f, cofactors(f));
  if (!(j > 0.0f)) return INFINITY;
  const float log_j = logf(j);
#pragma unroll
  for (int i = 0; i < 9; ++i) square += f.m[i / 3][i % 3] * f.m[i / 3][i % 3];
  return mu * (0.5f * (square - 3.0f) - log_j) + 0.5f * lambda * log_j * log_j;
}

}  // namespace gpuphys::elastic
