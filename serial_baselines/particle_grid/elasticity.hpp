// Rotation and stress of fixed corotated elasticity for the serial baselines, from the specifications alone.
#pragma once

#include <array>
#include <cmath>
#include <utility>

namespace gpuphys::serial {

template <class Real>
using Matrix3 = std::array<std::array<Real, 3>, 3>;

template <class Real>
Real determinant(const Matrix3<Real>& f) {
  return f[0][0] * (f[1][1] * f[2][2] - f[1][2] * f[2][1]) -
         f[0][1] * (f[1][0] * f[2][2] - f[1][2] * f[2][0]) +
         f[0][2] * (f[1][0] * f[2][1] - f[1][1] * f[2][0]);
}

/// The rotation (det +1) that maximises tr(R^T F): one-sided Jacobi (Hestenes) makes the columns of F V
/// orthogonal; R = U V^T with U's third column, that of the smallest singular value, set to the cross product
/// of the other two.
template <class Real>
Matrix3<Real> nearest_rotation(const Matrix3<Real>& f) {
  Matrix3<Real> a, v;  // columns as rows: a[j] is column j of F V
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t r = 0; r < 3; ++r) {
      a[j][r] = f[r][j];
      v[j][r] = r == j ? Real(1) : Real(0);
    }
  }
  const auto dot = [](const std::array<Real, 3>& x, const std::array<Real, 3>& y) {
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
  };
  constexpr Real precision = sizeof(Real) == 8 ? Real(1e-15) : Real(1e-7);
  for (int sweep = 0; sweep < 30; ++sweep) {
    bool rotated = false;
    for (std::size_t p = 0; p < 2; ++p) {
      for (std::size_t q = p + 1; q < 3; ++q) {
        const Real alpha = dot(a[p], a[p]), beta = dot(a[q], a[q]), gamma = dot(a[p], a[q]);
        if (std::abs(gamma) <= precision * std::sqrt(alpha * beta)) continue;
        rotated = true;
        const Real zeta = (beta - alpha) / (2 * gamma);
        const Real t = (zeta >= 0 ? Real(1) : Real(-1)) / (std::abs(zeta) + std::sqrt(1 + zeta * zeta));
        const Real c = 1 / std::sqrt(1 + t * t), s = c * t;
        for (std::size_t r = 0; r < 3; ++r) {
          const Real ap = a[p][r], aq = a[q][r], vp = v[p][r], vq = v[q][r];
          a[p][r] = c * ap - s * aq;
          a[q][r] = s * ap + c * aq;
          v[p][r] = c * vp - s * vq;
          v[q][r] = s * vp + c * vq;
        }
      }
    }
    if (!rotated) break;
  }
  // Order by size. An exchange changes the orientation of V, so one column is turned round as well.
  std::array<Real, 3> size{dot(a[0], a[0]), dot(a[1], a[1]), dot(a[2], a[2])};
  const auto order = [&](std::size_t i, std::size_t j) {
    if (!(size[i] < size[j])) return;
    std::swap(size[i], size[j]);
    std::swap(a[i], a[j]);
    std::swap(v[i], v[j]);
    for (std::size_t r = 0; r < 3; ++r) {
      a[j][r] = -a[j][r];
      v[j][r] = -v[j][r];
    }
  };
  order(0, 1);
  order(0, 2);
  order(1, 2);
  const auto normalised = [&](std::array<Real, 3> x) {
    const Real length = std::sqrt(dot(x, x));
    for (Real& e : x) e /= length;
    return x;
  };
  const auto cross = [](const std::array<Real, 3>& x, const std::array<Real, 3>& y) {
    return std::array<Real, 3>{x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2],
                               x[0] * y[1] - x[1] * y[0]};
  };
  Matrix3<Real> u = a;
  if (!(size[0] > 0)) return {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};  // F = 0: any rotation
  u[0] = normalised(a[0]);
  // The part of the second column along the first is rounding, but of the size of the first one's.
  const Real along = dot(u[0], a[1]);
  for (std::size_t r = 0; r < 3; ++r) u[1][r] = a[1][r] - along * u[0][r];
  if (dot(u[1], u[1]) > Real(1e-30) * size[0]) {
    u[1] = normalised(u[1]);
  } else {  // F of rank one: any direction perpendicular to the first
    const std::size_t smallest = std::abs(u[0][0]) <= std::abs(u[0][1])
                                     ? (std::abs(u[0][0]) <= std::abs(u[0][2]) ? 0 : 2)
                                     : (std::abs(u[0][1]) <= std::abs(u[0][2]) ? 1 : 2);
    std::array<Real, 3> axis{};
    axis[smallest] = 1;
    u[1] = normalised(cross(u[0], axis));
  }
  u[2] = cross(u[0], u[1]);
  Matrix3<Real> rotation{};
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t j = 0; j < 3; ++j) rotation[r][c] += u[j][r] * v[j][c];
    }
  }
  return rotation;
}

/// Kirchhoff stress tau = 2 mu (F - R) F^T + lambda (J - 1) J I of fixed corotated elasticity (Stomakhin et
/// al. 2012, energy (6)).
template <class Real>
Matrix3<Real> kirchhoff_stress(const Matrix3<Real>& f, Real mu, Real lambda) {
  const Matrix3<Real> rotation = nearest_rotation(f);
  const Real volume = determinant(f);
  Matrix3<Real> stress{};
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t b = 0; b < 3; ++b) {
      Real sum = 0;
      for (std::size_t c = 0; c < 3; ++c) sum += (f[a][c] - rotation[a][c]) * f[b][c];
      stress[a][b] = 2 * mu * sum;
    }
    stress[a][a] += lambda * (volume - 1) * volume;
  }
  return stress;
}

}  // namespace gpuphys::serial
