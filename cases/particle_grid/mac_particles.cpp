#include "cases/particle_grid/mac_particles.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "cases/particle_grid/particle_blocks.hpp"
#include "core/base/parallel.hpp"
#include "core/generators/fourier_velocity.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::mac_particles {
namespace {

constexpr int kModes = 16, kMaxWaveNumber = 3;
constexpr double kNoise = 0.5;
constexpr std::uint64_t kJitterStream = 13, kFaceStream = 14, kPointStream = 15;

}  // namespace

const std::vector<BlockSet>& block_sets() {
  static const std::vector<BlockSet> sets{
      {.name = "public",
       .paper = true,
       .hidden = false,
       .cells = {256, 256, 256},
       .low = {0, 2, 0},
       .high = {128, 254, 128},
       .margin = 0.01,
       .n = 33021538,
       .seed = 1,
       .period = 256},
      {.name = "hidden",
       .paper = true,
       .hidden = true,
       .cells = {256, 256, 256},
       .low = {0, 2, 0},
       .high = {128, 254, 128},
       .margin = 0.015,
       .n = 33017033,
       .seed = 2,
       .period = 256},
      {.name = "public_smoke",
       .paper = false,
       .hidden = false,
       .cells = {37, 34, 45},
       .low = {0, 2, 0},
       .high = {19, 32, 23},
       .margin = 0.01,
       .n = 104843,
       .seed = 1,
       .period = 64},
      {.name = "hidden_smoke",
       .paper = false,
       .hidden = true,
       .cells = {33, 42, 38},
       .low = {0, 2, 0},
       .high = {17, 40, 19},
       .margin = 0.015,
       .n = 98117,
       .seed = 2,
       .period = 64},
  };
  return sets;
}

std::string describe(const BlockSet& s) {
  return fmt::format(
      "{} particles in {} x {} x {} cells: eight a cell of [{},{}) x [{},{}) x [{},{}), {} cells away from "
      "whole and "
      "half cells, in random order, seed {}",
      s.n, s.cells[0], s.cells[1], s.cells[2], s.low[0], s.high[0], s.low[1], s.high[1], s.low[2], s.high[2],
      s.margin, s.seed);
}

void fill_positions(const BlockSet& s, HostArray& x) {
  const Cells size{s.high[0] - s.low[0], s.high[1] - s.low[1], s.high[2] - s.low[2]};
  const auto order = particle_blocks::random_order(8 * size[0] * size[1] * size[2], s.seed);
  const auto out = x.as<float>();
  parallel_pieces(s.n, [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t q = begin; q < end; ++q) {
      const std::int64_t candidate = order[static_cast<std::size_t>(q)], cell = candidate / 8,
                         half = candidate % 8;
      const Cells at{s.low[0] + cell / size[2] / size[1], s.low[1] + cell / size[2] % size[1],
                     s.low[2] + cell % size[2]};
      const Cells upper{half / 4, half / 2 % 2, half % 2};
      for (std::size_t d = 0; d < 3; ++d) {
        const double u = uniform01(s.seed, kJitterStream, static_cast<std::uint64_t>(3 * candidate) + d);
        const double cells = static_cast<double>(at[d]) + 0.5 * static_cast<double>(upper[d]) + s.margin +
                             (0.5 - 2 * s.margin) * u;
        out[static_cast<std::size_t>(3 * q) + d] = static_cast<float>(cells * kDx);
      }
    }
  });
}

void fill_velocity(const BlockSet& s, const HostArray& x, HostArray& v) {
  particle_blocks::fill_velocity(x, s.seed, kModes, kMaxWaveNumber, s.period * kDx, kNoise, v);
}

void fill_faces(const BlockSet& s, std::uint64_t seed, double scale, int c, HostArray& u) {
  FourierVelocity::random(seed, kModes, kMaxWaveNumber, 1.0, s.period * kDx).fill(c, kDx, u);
  const auto out = u.as<float>();
  const std::uint64_t stream = kFaceStream + 100 * static_cast<std::uint64_t>(c);
  parallel_pieces(u.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const double noise = kNoise * uniform11(seed, stream, static_cast<std::uint64_t>(i));
      out[at] = static_cast<float>(scale * (static_cast<double>(out[at]) + noise));
    }
  });
}

void fill_uniform(std::uint64_t seed, std::uint64_t stream, double scale, HostArray& array) {
  const auto out = array.as<float>();
  parallel_pieces(array.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i)
      out[static_cast<std::size_t>(i)] =
          static_cast<float>(scale * uniform11(seed, stream, static_cast<std::uint64_t>(i)));
  });
}

Vec3 off_planes(std::uint64_t seed, std::uint64_t item, const Vec3& low, const Vec3& high, double step) {
  Vec3 x;
  for (std::size_t d = 0; d < 3; ++d) {
    const double at = low[d] + (high[d] - low[d]) * uniform01(seed, kPointStream, 3 * item + d);
    x[d] = (std::floor(at / step) + 0.5) * step;
  }
  return x;
}

Vec3 random_vector(std::uint64_t seed, std::uint64_t stream, std::uint64_t item) {
  return {uniform11(seed, stream, 3 * item), uniform11(seed, stream, 3 * item + 1),
          uniform11(seed, stream, 3 * item + 2)};
}

}  // namespace gpuphys::mac_particles
