// The times at which four moving points become coplanar, for the serial collision baselines.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "core/contract/view.hpp"

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

/// A vector that moves linearly over the step: start + t change.
template <class Real>
struct Moving {
  Vec3<Real> start, change;
  Vec3<Real> at(Real t) const { return start + t * change; }
};

/// c[0] + c[1] t + c[2] t^2 + c[3] t^3.
template <class Real>
struct Cubic {
  std::array<Real, 4> c;
  Real at(Real t) const { return c[0] + t * (c[1] + t * (c[2] + t * c[3])); }
};

/// The exponent of the largest coordinate; of a vector of zeros, that of the shortest valid length.
template <class Real>
int exponent_of(Vec3<Real> a) {
  const Real largest = std::max({std::abs(a.x), std::abs(a.y), std::abs(a.z)});
  return largest > 0 ? std::ilogb(largest) : -60;
}

/// The vector times a power of two for which its largest coordinate over the step is near 1: products of
/// scaled vectors neither overflow nor underflow. Powers of two round nothing.
template <class Real>
Moving<Real> scaled(const Moving<Real>& v) {
  const Real unit = std::ldexp(Real(1), -std::max(exponent_of(v.start), exponent_of(v.start + v.change)));
  return {unit * v.start, unit * v.change};
}

/// Vertex `to` seen from vertex `from`. Differences come first: neighbours' coordinates subtract exactly or
/// nearly so.
template <class Real>
Moving<Real> relative_motion(View<const float, 2> x0, View<const float, 2> x1, std::int32_t from,
                             std::int32_t to) {
  const auto difference = [&](View<const float, 2> x) {
    return Vec3<Real>{static_cast<Real>(x(to, 0)) - static_cast<Real>(x(from, 0)),
                      static_cast<Real>(x(to, 1)) - static_cast<Real>(x(from, 1)),
                      static_cast<Real>(x(to, 2)) - static_cast<Real>(x(from, 2))};
  };
  const Vec3<Real> start = difference(x0);
  return {start, difference(x1) - start};
}

/// w(t) . (u(t) x v(t)), up to a positive factor.
template <class Real>
Cubic<Real> triple_product(const Moving<Real>& w_metres, const Moving<Real>& u_metres,
                           const Moving<Real>& v_metres) {
  const Moving<Real> w = scaled(w_metres), u = scaled(u_metres), v = scaled(v_metres);
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

/// The fractions at which two coplanar vectors from one point span w = s u + r v: numerators and the common
/// denominator |N|^2, N = u x v; scaled, so that s = s_times / nn and r = r_times / nn.
template <class Real>
struct Fractions {
  Real s_times, r_times, nn;
  bool parallel;  ///< |N|^2 <= 1e-12 |u|^2 |v|^2
};
template <class Real>
Fractions<Real> fractions(Vec3<Real> w, Vec3<Real> u, Vec3<Real> v) {
  const int at_u = exponent_of(u), at_v = exponent_of(v), at_w = exponent_of(w);
  u = std::ldexp(Real(1), -at_u) * u;
  v = std::ldexp(Real(1), -at_v) * v;
  w = std::ldexp(Real(1), -at_w) * w;
  const Vec3<Real> n = cross(u, v);
  const Real nn = dot(n, n);
  return {std::ldexp(dot(cross(w, v), n), at_w - at_u), std::ldexp(dot(cross(u, w), n), at_w - at_v), nn,
          nn <= Real(1e-12) * dot(u, u) * dot(v, v)};
}

constexpr int kBisections = 30;

/// Calls crossing(t) for every change of sign of f in [0, 1], in order of time, until it returns true. Zero
/// counts as positive.
template <class Real, class Crossing>
void each_crossing(Cubic<Real> f, Crossing&& crossing) {
  Real largest = 0;
  for (const Real c : f.c) largest = std::max(largest, std::abs(c));
  if (largest == 0) return;
  for (Real& c : f.c) c *= std::ldexp(Real(1), -std::ilogb(largest));  // squares stay in range
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
