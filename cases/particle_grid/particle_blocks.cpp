#include "cases/particle_grid/particle_blocks.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/parallel.hpp"
#include "core/generators/fourier_velocity.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::particle_blocks {
namespace {

constexpr std::uint64_t kNoiseStream = 10, kDeformationStream = 11, kRotationStream = 12, kOrderStream = 99;
constexpr std::int64_t kChunk = 4096;  // items a thread takes at a time

template <class Body>
void parallel_chunks(std::int64_t n, Body&& body) {
  parallel_for((n + kChunk - 1) / kChunk, [&](std::int64_t c) {
    const std::int64_t end = std::min(n, (c + 1) * kChunk);
    for (std::int64_t i = c * kChunk; i < end; ++i) body(i);
  });
}

}  // namespace

std::vector<std::uint32_t> random_order(std::int64_t n, std::uint64_t seed) {
  struct Keyed {
    std::uint64_t key;
    std::uint32_t item;
  };
  std::vector<Keyed> keyed(static_cast<std::size_t>(n));
  parallel_chunks(n, [&](std::int64_t i) {
    keyed[static_cast<std::size_t>(i)] = {random_bits(seed, kOrderStream, static_cast<std::uint64_t>(i)),
                                          static_cast<std::uint32_t>(i)};
  });
  // Split by the leading byte first, so that the parts can be sorted side by side.
  std::array<std::size_t, 257> begin{};
  for (const Keyed& k : keyed) ++begin[(k.key >> 56) + 1];
  for (std::size_t b = 0; b < 256; ++b) begin[b + 1] += begin[b];
  std::vector<Keyed> sorted(keyed.size());
  std::array<std::size_t, 257> cursor = begin;
  for (const Keyed& k : keyed) sorted[cursor[k.key >> 56]++] = k;
  std::vector<std::uint32_t> order(keyed.size());
  parallel_for(256, [&](std::int64_t b) {
    const std::size_t first = begin[static_cast<std::size_t>(b)],
                      last = begin[static_cast<std::size_t>(b) + 1];
    std::sort(sorted.begin() + static_cast<std::ptrdiff_t>(first),
              sorted.begin() + static_cast<std::ptrdiff_t>(last), [](const Keyed& a, const Keyed& c) {
                return a.key != c.key ? a.key < c.key : a.item < c.item;
              });
    for (std::size_t i = first; i < last; ++i) order[i] = sorted[i].item;
  });
  return order;
}

std::vector<std::array<float, 3>> ball(const std::array<std::int64_t, 3>& cells, double radius) {
  std::vector<std::array<float, 3>> particles;
  for (std::int64_t i = 0; i < cells[0]; ++i) {
    for (std::int64_t j = 0; j < cells[1]; ++j) {
      for (std::int64_t k = 0; k < cells[2]; ++k) {
        const std::array<std::int64_t, 3> cell{i, j, k};
        double square = 0;
        for (std::size_t d = 0; d < 3; ++d) {
          const double r = static_cast<double>(cell[d]) + 0.5 - 0.5 * static_cast<double>(cells[d]);
          square += r * r;
        }
        if (square > radius * radius) continue;
        for (int s = 0; s < 8; ++s) {
          const std::array<int, 3> half{s / 4, s / 2 % 2, s % 2};
          std::array<float, 3> x{};
          for (std::size_t d = 0; d < 3; ++d)
            x[d] = static_cast<float>(static_cast<double>(cell[d]) + 0.25 + 0.5 * half[d]);
          particles.push_back(x);
        }
      }
    }
  }
  return particles;
}

void fill_velocity(const HostArray& x, std::uint64_t seed, int modes, int k_max, double period, double noise,
                   HostArray& v) {
  const FourierVelocity field = FourierVelocity::random(seed, modes, k_max, 1.0, period);
  const auto position = x.as<float>();
  const auto out = v.as<float>();
  parallel_chunks(x.shape()[0], [&](std::int64_t p) {
    const auto item = static_cast<std::size_t>(3 * p);
    std::array<double, 3> u{};
    for (const FourierVelocity::Mode& m : field.modes) {
      double turns = 0;
      for (std::size_t d = 0; d < 3; ++d) turns += m.k[d] * static_cast<double>(position[item + d]);
      const double wave = std::cos(2 * std::numbers::pi * turns / period + m.phase);
      for (std::size_t d = 0; d < 3; ++d) u[d] += m.amplitude[d] * wave;
    }
    for (std::size_t d = 0; d < 3; ++d) {
      const double extra = noise * uniform11(seed, kNoiseStream, static_cast<std::uint64_t>(item + d));
      out[item + d] = static_cast<float>(u[d] + extra);
    }
  });
}

void fill_deformation(std::uint64_t seed, double jitter, HostArray& f) {
  const auto out = f.as<float>();
  parallel_chunks(f.shape()[0], [&](std::int64_t p) {
    for (std::int64_t e = 0; e < 9; ++e) {
      const double unit = e % 4 == 0 ? 1.0 : 0.0;
      out[static_cast<std::size_t>(9 * p + e)] = static_cast<float>(
          unit + jitter * uniform11(seed, kDeformationStream, static_cast<std::uint64_t>(9 * p + e)));
    }
  });
}

Mat3 random_rotation(std::uint64_t seed, std::uint64_t item) {
  // Shoemake's map from three uniform numbers to a uniform unit quaternion (w, x, y, z).
  const double a = uniform01(seed, kRotationStream, 3 * item);
  const double b = 2 * std::numbers::pi * uniform01(seed, kRotationStream, 3 * item + 1);
  const double c = 2 * std::numbers::pi * uniform01(seed, kRotationStream, 3 * item + 2);
  const double w = std::sqrt(1 - a) * std::sin(b), x = std::sqrt(1 - a) * std::cos(b),
               y = std::sqrt(a) * std::sin(c), z = std::sqrt(a) * std::cos(c);
  return {{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
           {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
           {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}};
}

Mat3 product(const Mat3& a, const Mat3& b) {
  Mat3 c{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) c[i][j] += a[i][k] * b[k][j];
    }
  }
  return c;
}

Mat3 transposed(const Mat3& a) {
  Mat3 t{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) t[i][j] = a[j][i];
  }
  return t;
}

Mat3 diagonal(double a, double b, double c) {
  return {{{a, 0, 0}, {0, b, 0}, {0, 0, c}}};
}

}  // namespace gpuphys::particle_blocks
