#include "cases/local_interaction/elastic_hard_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/generators/random.hpp"

namespace gpuphys::elastic {
namespace {

double largest_stretch(const Mat3& f) {
  double square = 0;
  for (const Vec3& row : f) square += row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
  return std::sqrt(square);
}

}  // namespace

void make_degenerate(SpringBody& b) {
  const std::size_t m = b.springs.size();
  const auto add = [&](std::int32_t i, std::int32_t j, double rest) {
    b.springs.push_back({i, j});
    b.rest.push_back(rest);
  };
  for (std::size_t j = 0; j < m; ++j) {
    const auto [p, q] = b.springs[j];
    if (j % 5 == 0) add(q, p, b.rest[j]);  // the same again, turned round
    if (j % 7 == 0) add(p, q, b.rest[j]);  // and once more
    if (j % 11 == 0) add(p, p, 0.5);       // to itself
    if (j % 13 == 0) add(p, q, 0);         // of rest length 0
    if (j % 301 == 0)
      b.x[static_cast<std::size_t>(q)] = b.x[static_cast<std::size_t>(p)];  // ends that coincide
  }
}

SpringBody hub_of_springs(std::int32_t arms, std::uint64_t seed) {
  SpringBody b;
  b.x.push_back({0.1, -0.2, 0.3});
  b.v.push_back({0, 0, 0});
  b.mass.push_back(1000);
  for (std::int32_t i = 1; i <= arms; ++i) {
    // A spiral on a half sphere, so that the forces do not cancel.
    const auto item = static_cast<std::uint64_t>(i);
    const double z = (i - 0.5) / arms, angle = 2.4 * i, r = std::sqrt(1 - z * z);
    const double reach = 1.25 + 0.1 * uniform11(seed, 50, item);
    b.x.push_back({0.1 + reach * r * std::cos(angle), -0.2 + reach * r * std::sin(angle), 0.3 + reach * z});
    b.v.push_back({0, 0, 0});
    b.mass.push_back(1);
    b.springs.push_back({i % 2 ? 0 : i, i % 2 ? i : 0});
    b.rest.push_back(1);
  }
  return b;
}

SpringBody random_graph(std::uint64_t seed, std::uint64_t n, std::uint64_t m) {
  SpringBody b;
  for (std::uint64_t i = 0; i < n; ++i) {
    Vec3 x, v;
    for (std::size_t d = 0; d < 3; ++d) {
      x[d] = 2 * uniform11(seed, 50, 3 * i + d);
      v[d] = uniform11(seed, 51, 3 * i + d);
    }
    b.x.push_back(x);
    b.v.push_back(v);
    b.mass.push_back(std::pow(10.0, 2 * uniform11(seed, 52, i)));
  }
  for (std::uint64_t j = 0; j < m; ++j) {
    b.springs.push_back({static_cast<std::int32_t>(random_bits(seed, 53, j) % n),
                         static_cast<std::int32_t>(random_bits(seed, 54, j) % n)});
    b.rest.push_back(2 * uniform01(seed, 55, j));
  }
  return b;
}

void add_tet(TetBody& b, const Vec3& place, double size, const Mat3& shape, const Mat3& f, double force_scale,
             std::uint64_t seed, std::uint64_t item) {
  const Mat3 turn = elastic::random_rotation(seed, 60, item);
  const auto first = static_cast<std::int32_t>(b.x.size());
  for (std::size_t k = 0; k < 4; ++k) {
    Vec3 p{};
    if (k > 0) p[k - 1] = size;
    p = turn * (shape * p);
    const Vec3 q = f * p;
    Vec3 rest, x, v;
    for (std::size_t d = 0; d < 3; ++d) {
      rest[d] = place[d] + p[d];
      x[d] = place[d] + q[d];
      v[d] = 0.1 * uniform11(seed, 61, 12 * item + 3 * k + d);
    }
    b.rest.push_back(rest);
    b.x.push_back(x);
    b.v.push_back(v);
    b.mass.push_back(force_scale * size * size * (1 + 0.5 * uniform01(seed, 62, 4 * item + k)));
  }
  b.tets.push_back({first, first + 1, first + 2, first + 3});
}

Mat3 diagonal(double a, double b, double c) {
  return {{{a, 0, 0}, {0, b, 0}, {0, 0, c}}};
}

Mat3 random_stretch(std::uint64_t seed, std::uint64_t i, double low, double high) {
  const auto stretch = [&](std::uint64_t d) {
    return std::pow(10.0, low + (high - low) * uniform01(seed, 65, 3 * i + d));
  };
  return elastic::random_rotation(seed, 63, i) * diagonal(stretch(0), stretch(1), stretch(2)) *
         elastic::random_rotation(seed, 64, i);
}

TetBody separate_tets(std::uint64_t seed, std::uint64_t count, double low, double high) {
  TetBody b;
  for (std::uint64_t i = 0; i < count; ++i) {
    const Mat3 f = random_stretch(seed, i, low, high);
    const double size = std::max(largest_stretch(f), std::pow(10.0, -low));
    add_tet(b, {}, 1, kIdentity, f, 10 * size, seed, i);
  }
  return b;
}

TetBody slivers(std::uint64_t seed, std::uint64_t count) {
  TetBody b;
  for (std::uint64_t i = 0; i < count; ++i) {
    const Mat3 f = random_stretch(seed, i, -0.1, 0.1);
    add_tet(b, {}, 1, diagonal(1, 1, std::tan(std::numbers::pi / 180)), f, 10, seed, i);
  }
  return b;
}

}  // namespace gpuphys::elastic
