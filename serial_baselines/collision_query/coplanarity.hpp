// The times at which four moving points become coplanar, for the serial collision baselines.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

namespace gpuphys::serial {

template <class Real>
struct Vec3 {
  Real x = 0, y = 0, z = 0;
  friend Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend Vec3 operator*(Real s, Vec3 a) { return {s * a.x, s * a.y, s * a.z}; }
};
template <class Real>
Real dot(Vec3<Real> a, Vec3<Real> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class Real>
Vec3<Real> cross(Vec3<Real> a, Vec3<Real> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/// The power of two that brings the largest coordinate of the vectors to between 1 and 2; 1 if all are zero.
template <class Real, class... More>
Real scale_of(Vec3<Real> a, More... more) {
  Real largest = 0;
  for (const Vec3<Real>& v : {a, more...})
    largest = std::max({largest, std::abs(v.x), std::abs(v.y), std::abs(v.z)});
  return largest == 0 ? Real(1) : std::ldexp(Real(1), -std::ilogb(largest));
}

/// A vector that moves linearly over the step: start + t change.
template <class Real>
struct Moving {
  Vec3<Real> start, change;
  Vec3<Real> at(Real t) const { return start + t * change; }
  /// The same in a unit in which it is about 1 long.
  Moving scaled() const {
    const Real scale = scale_of(start, change);
    return {scale * start, scale * change};
  }
};

/// c[0] + c[1] t + c[2] t^2 + c[3] t^3.
template <class Real>
struct Cubic {
  std::array<Real, 4> c;
  Real at(Real t) const { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }
};

/// w(t) . (u(t) x v(t)), but for a positive factor: its coefficients may be squared whatever the unit of
/// length.
template <class Real>
Cubic<Real> triple_product(const Moving<Real>& w_any, const Moving<Real>& u_any, const Moving<Real>& v_any) {
  const Moving<Real> w = w_any.scaled(), u = u_any.scaled(), v = v_any.scaled();
  const Vec3<Real> n0 = cross(u.start, v.start);
  const Vec3<Real> n1 = cross(u.start, v.change) + cross(u.change, v.start);
  const Vec3<Real> n2 = cross(u.change, v.change);
  Cubic<Real> f;
  f.c[0] = dot(w.start, n0);
  f.c[1] = dot(w.start, n1) + dot(w.change, n0);
  f.c[2] = dot(w.start, n2) + dot(w.change, n1);
  f.c[3] = dot(w.change, n2);
  return f;
}

constexpr int kBisections = 30;

/// Calls crossing(t) for every change of sign of f in [0, 1], in order of time, until it returns true. Zero
/// counts as positive.
template <class Real, class Crossing>
void each_crossing(const Cubic<Real>& f, Crossing&& crossing) {
  // The ends of the pieces on which f is monotone: 0, the zeros of f' in between, 1.
  std::array<Real, 4> ends{};
  std::size_t count = 1;
  const Real discriminant = f.c[2] * f.c[2] - 3 * f.c[3] * f.c[1];
  if (discriminant > 0) {
    const Real q = -(f.c[2] + std::copysign(std::sqrt(discriminant), f.c[2]));
    const Real first = q / (3 * f.c[3]), second = f.c[1] / q;  // an infinite one lies outside
    for (const Real t : {std::min(first, second), std::max(first, second)}) {
      if (t > 0 && t < 1) ends[count++] = t;
    }
  }
  ends[count++] = 1;
  for (std::size_t k = 0; k + 1 < count; ++k) {
    Real low = ends[k], high = ends[k + 1];
    const bool from_below = f.at(low) < 0;
    if (from_below == (f.at(high) < 0)) continue;
    for (int step = 0; step < kBisections; ++step) {
      const Real middle = (low + high) / 2;
      if ((f.at(middle) < 0) == from_below) {
        low = middle;
      } else {
        high = middle;
      }
    }
    if (crossing((low + high) / 2)) return;
  }
}

}  // namespace gpuphys::serial
