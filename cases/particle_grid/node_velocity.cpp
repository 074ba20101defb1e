#include "cases/particle_grid/node_velocity.hpp"

#include <cmath>
#include <numbers>

#include "core/base/parallel.hpp"
#include "core/generators/fourier_velocity.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::node_velocity {
namespace {

constexpr int kModes = 16;
constexpr double kNoise = 0.1;
constexpr std::uint64_t kNoiseStream = 20, kPointStream = 21, kValueStream = 22;

/// Uniform in the box from `low` to `high`, in cells.
Vec3 random_point(std::uint64_t seed, std::uint64_t particle, const Vec3& low, const Vec3& high) {
  Vec3 g;
  for (std::size_t d = 0; d < 3; ++d)
    g[d] = low[d] + (high[d] - low[d]) * uniform01(seed, kPointStream, 3 * particle + d);
  return g;
}

/// Anywhere in the array and up to `beyond` cells outside.
std::function<Vec3(std::uint64_t)> anywhere(std::uint64_t seed, const Nodes& nodes, double beyond) {
  return [=](std::uint64_t q) {
    Vec3 high;
    for (std::size_t d = 0; d < 3; ++d) high[d] = static_cast<double>(nodes[d] - 1) + beyond;
    return random_point(seed, q, {-beyond, -beyond, -beyond}, high);
  };
}

/// Values of node (i, j, k), uniform in [-1, 1).
std::function<Vec3(std::int64_t, std::int64_t, std::int64_t)> noise(std::uint64_t seed, double mean = 0,
                                                                    double size = 1) {
  return [=](std::int64_t i, std::int64_t j, std::int64_t k) {
    const auto node = static_cast<std::uint64_t>((i * 131071 + j) * 131071 + k);
    Vec3 u;
    for (std::size_t c = 0; c < 3; ++c) u[c] = mean + size * uniform11(seed, kValueStream, 3 * node + c);
    return u;
  };
}

std::vector<Stress> all_stresses() {
  std::vector<Stress> list;
  const auto add = [&](const char* name, const char* about, const Nodes& nodes, double dx, std::int64_t n,
                       auto at, auto u) {
    list.push_back({.name = name, .about = about, .nodes = nodes, .dx = dx, .n = n, .at = at, .u = u});
  };
  add(
      "walls",
      "particles up to four cells outside of every side, edge and corner, and some at 1e30 m: node indices "
      "are clamped",
      {17, 9, 13}, kDx, 20011,
      [](std::uint64_t q) {
        Vec3 g = anywhere(40, {17, 9, 13}, 4)(q);
        if (q % 89 == 0) g[q % 3] = q % 2 == 0 ? 2.56e32 : -2.56e32;
        return g;
      },
      noise(40));
  add("spacing_tenth", "dx = 0.1, no power of two: fractions at cell 200", {202, 5, 7}, 0.1, 3001,
      anywhere(41, {202, 5, 7}, 1), noise(41));
  add("spacing_320th", "dx = 1/320", {6, 193, 33}, 1.0 / 320, 2049, anywhere(42, {6, 193, 33}, 1), noise(42));
  add("spacing_three", "dx = 3 m", {4, 3, 151}, 3, 1025, anywhere(43, {4, 3, 151}, 1), noise(43));
  add("thin", "one, two and three nodes along the axes: several of a particle's nodes are the same",
      {1, 2, 3}, kDx, 33, anywhere(44, {1, 2, 3}, 2), noise(44));
  add("long_x", "70,000 nodes along x", {70000, 2, 3}, kDx, 1031, anywhere(45, {70000, 2, 3}, 2), noise(45));
  add("long_y", "70,000 nodes along y", {3, 70000, 2}, kDx, 1023, anywhere(46, {3, 70000, 2}, 2), noise(46));
  add("long_z", "70,000 nodes along z", {2, 3, 70000}, kDx, 31, anywhere(47, {2, 3, 70000}, 2), noise(47));
  add(
      "planes", "particles exactly on nodes and half-way between them: two nodes' weights, or three",
      {9, 10, 11}, kDx, 4099,
      [](std::uint64_t q) {
        Vec3 g = anywhere(48, {9, 10, 11}, 2)(q);
        for (double& c : g) c = std::floor(2 * c) / 2;
        return g;
      },
      noise(48));
  add(
      "one_cell", "70,001 particles in one cell of a large grid, one elsewhere", {33, 34, 45}, kDx, 70002,
      [](std::uint64_t q) {
        return q == 70000 ? Vec3{2.25, 30.5, 41.75}
                          : random_point(49, q, {13.5, 14.5, 15.5}, {14.5, 15.5, 16.5});
      },
      noise(49));
  add("constant", "the same velocity on every node", {12, 9, 14}, kDx, 1025, anywhere(50, {12, 9, 14}, 3),
      [](std::int64_t, std::int64_t, std::int64_t) { return kConstant; });
  add("offset", "small differences on top of 1000 m/s: the gradient is that of the differences", {12, 14, 9},
      kDx, 1025, anywhere(51, {12, 14, 9}, 1), noise(51, 1000, 0.125));
  add("contrast", "node values over twelve decades, zeros and negative zeros among them", {14, 9, 12}, kDx,
      2047, anywhere(52, {14, 9, 12}, 1), [](std::int64_t i, std::int64_t j, std::int64_t k) {
        Vec3 u = noise(52)(i, j, k);
        const std::int64_t kind = (7 * i + 3 * j + k) % 5;
        for (double& c : u) c = kind == 0 ? 0.0 : kind == 1 ? -0.0 : c * std::pow(10.0, 6 * c);
        return u;
      });
  add(
      "linear", "a linear field on dyadic numbers: answers by hand", {12, 10, 15}, 1, 1021,
      [](std::uint64_t q) {
        return quarter_point(53, q, {12, 10, 15});
      },
      [](std::int64_t i, std::int64_t j, std::int64_t k) {
        return linear_field({static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)});
      });
  add(
      "single_nodes", "one node in 64 is not zero, particles on nodes and around those that are not",
      {16, 16, 16}, kDx, 5003,
      [](std::uint64_t q) {
        Vec3 g = anywhere(54, {16, 16, 16}, 1)(q);
        for (double& c : g) {
          const double nearest = 4 * std::floor(c / 4) + 3;  // a node that is not zero
          c = q % 2 == 0 ? std::round(c) : nearest + 1.5 * (2 * (c - std::floor(c)) - 1);
        }
        return g;
      },
      [](std::int64_t i, std::int64_t j, std::int64_t k) {
        // Nodes of the array's last planes among them.
        return i % 4 == 3 && j % 4 == 3 && k % 4 == 3 ? noise(54)(i, j, k) : Vec3{0, 0, 0};
      });
  add("largest", "node values of 1e20 m/s, dx = 2^30 m", {9, 11, 7}, 0x1p30, 513, anywhere(55, {9, 11, 7}, 1),
      noise(55, 0, 0.99e20));
  add("smallest", "node values of 1e-15 m/s, dx = 2^-30 m", {7, 9, 11}, 0x1p-30, 1,
      anywhere(56, {7, 9, 11}, 0), noise(56, 0, 1e-15));
  return list;
}

}  // namespace

void fill_nodes(std::uint64_t seed, int k_max, double period, int c, HostArray& u) {
  FourierVelocity field = FourierVelocity::random(seed, kModes, k_max, 1.0, period);
  // fill() samples faces, half a cell off the nodes along the two other axes: the phases take that back.
  for (FourierVelocity::Mode& m : field.modes) {
    for (std::size_t d = 0; d < 3; ++d) {
      if (static_cast<int>(d) != c) m.phase -= std::numbers::pi * m.k[d] * kDx / period;
    }
  }
  field.fill(c, kDx, u);
  const auto out = u.as<float>();
  parallel_pieces(u.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const double extra = kNoise * uniform11(seed, kNoiseStream + static_cast<std::uint64_t>(c) * 100,
                                              static_cast<std::uint64_t>(i));
      out[at] = static_cast<float>(static_cast<double>(out[at]) + extra);
    }
  });
}

void fill_positions(double dx, const std::function<Vec3(std::uint64_t)>& in_cells, HostArray& x) {
  const auto out = x.as<float>();
  const auto spacing = static_cast<double>(static_cast<float>(dx));
  for (std::int64_t q = 0; q < x.shape()[0]; ++q) {
    const Vec3 g = in_cells(static_cast<std::uint64_t>(q));
    for (std::size_t d = 0; d < 3; ++d)
      out[static_cast<std::size_t>(3 * q) + d] = static_cast<float>(g[d] * spacing);
  }
}

Vec3 quarter_point(std::uint64_t seed, std::uint64_t particle, const Nodes& nodes) {
  Vec3 g;
  for (std::size_t d = 0; d < 3; ++d) {
    const double room = static_cast<double>(nodes[d]) - 3;
    g[d] = 1 + std::floor(4 * room * uniform01(seed, kPointStream, 3 * particle + d)) / 4;
  }
  return g;
}

Vec3 linear_field(const Vec3& g) {
  Vec3 u = kAtOrigin;
  for (std::size_t a = 0; a < 3; ++a) {
    for (std::size_t b = 0; b < 3; ++b) u[a] += kRate[a][b] * g[b];
  }
  return u;
}

const std::vector<Stress>& stresses() {
  static const std::vector<Stress> list = all_stresses();
  return list;
}

void fill(const Stress& s, HostArray& x, HostArray& ux, HostArray& uy, HostArray& uz) {
  fill_positions(s.dx, s.at, x);
  const std::array<std::span<float>, 3> out{ux.as<float>(), uy.as<float>(), uz.as<float>()};
  std::size_t at = 0;
  for (std::int64_t i = 0; i < s.nodes[0]; ++i) {
    for (std::int64_t j = 0; j < s.nodes[1]; ++j) {
      for (std::int64_t k = 0; k < s.nodes[2]; ++k, ++at) {
        const Vec3 u = s.u(i, j, k);
        for (std::size_t c = 0; c < 3; ++c) out[c][at] = static_cast<float>(u[c]);
      }
    }
  }
}

}  // namespace gpuphys::node_velocity
