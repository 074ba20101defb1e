// Forces of single springs and tetrahedra for the serial baselines, as the specifications write them.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "serial_baselines/particle_grid/elasticity.hpp"

namespace gpuphys::serial {

template <class Real>
using Vector3 = std::array<Real, 3>;  // Matrix3 has rows of these

/// a - b, of rows i and j of arrays of positions.
template <class Real, class Positions>
Vector3<Real> difference(const Positions& x, std::int64_t i, std::int64_t j) {
  Vector3<Real> d;
  for (std::size_t c = 0; c < 3; ++c) d[c] = static_cast<Real>(x(i, c)) - static_cast<Real>(x(j, c));
  return d;
}

/// The force, over the stiffness, that a spring exerts on the end at the head of d = x_a - x_b.
template <class Real>
Vector3<Real> spring_pull(const Vector3<Real>& d, Real rest) {
  const Real length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  if (length == 0) return {0, 0, 0};
  Vector3<Real> f;
  for (std::size_t c = 0; c < 3; ++c) f[c] = -(length - rest) * (d[c] / length);
  return f;
}

/// Cofactors: a^-T = cofactors(a) / det(a).
template <class Real>
Matrix3<Real> cofactors(const Matrix3<Real>& a) {
  Matrix3<Real> c;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const std::size_t i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      c[i][j] = a[i1][j1] * a[i2][j2] - a[i1][j2] * a[i2][j1];
    }
  }
  return c;
}

template <class Real>
Matrix3<Real> inverse(const Matrix3<Real>& a) {
  const Matrix3<Real> c = cofactors(a);
  const Real det = determinant(a);
  Matrix3<Real> inverse;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) inverse[i][j] = c[j][i] / det;
  }
  return inverse;
}

template <class Real>
Matrix3<Real> product(const Matrix3<Real>& a, const Matrix3<Real>& b) {
  Matrix3<Real> c;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) c[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
  }
  return c;
}

/// Edges of a tetrahedron from its first vertex, as columns.
template <class Real, class Positions, class Tets>
Matrix3<Real> edges(const Positions& x, const Tets& tets, std::int64_t t) {
  Matrix3<Real> d;
  for (std::size_t k = 0; k < 3; ++k) {
    const Vector3<Real> edge = difference<Real>(x, tets(t, k + 1), tets(t, 0));
    for (std::size_t c = 0; c < 3; ++c) d[c][k] = edge[c];
  }
  return d;
}

/// First Piola-Kirchhoff stress mu (F - F^-T) + lambda ln det F F^-T.
template <class Real>
Matrix3<Real> neo_hookean_stress(const Matrix3<Real>& f, Real mu, Real lambda) {
  const Matrix3<Real> cofactor = cofactors(f);
  const Real j = determinant(f), log_j = std::log(j);
  Matrix3<Real> stress;
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t b = 0; b < 3; ++b) {
      const Real inverse_transposed = cofactor[a][b] / j;
      stress[a][b] = mu * (f[a][b] - inverse_transposed) + lambda * log_j * inverse_transposed;
    }
  }
  return stress;
}

/// What a stress does to the four vertices: columns of -V P Dm^-T to the last three, minus their sum to the
/// first.
template <class Real>
std::array<Vector3<Real>, 4> tet_forces(const Matrix3<Real>& stress, const Matrix3<Real>& inverse_rest,
                                        Real volume) {
  std::array<Vector3<Real>, 4> force{};
  for (std::size_t k = 0; k < 3; ++k) {
    for (std::size_t c = 0; c < 3; ++c) {
      Real sum = 0;
      for (std::size_t b = 0; b < 3; ++b) sum += stress[c][b] * inverse_rest[k][b];
      force[k + 1][c] = -volume * sum;
      force[0][c] -= force[k + 1][c];
    }
  }
  return force;
}

}  // namespace gpuphys::serial
