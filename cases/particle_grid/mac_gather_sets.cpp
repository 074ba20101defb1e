#include "cases/particle_grid/mac_gather_sets.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "core/generators/random.hpp"

namespace gpuphys::mac_particles {
namespace {

using Field = std::function<double(int, int, std::int64_t, std::int64_t, std::int64_t)>;

constexpr std::uint64_t kValueStream = 30;

/// Uniform in mean + size * [-1, 1), each sample of each component of each field by itself.
Field noise(std::uint64_t seed, double size = 1, double mean = 0) {
  return [=](int field, int c, std::int64_t i, std::int64_t j, std::int64_t k) {
    const auto sample = static_cast<std::uint64_t>((i * 131071 + j) * 131071 + k);
    const auto stream = kValueStream + static_cast<std::uint64_t>(3 * field + c);
    return mean + size * uniform11(seed, stream, sample);
  };
}

std::function<Vec3(std::uint64_t)> random_velocity(std::uint64_t seed) {
  return [=](std::uint64_t q) { return random_vector(seed, 4, q); };
}

std::function<Vec3(std::uint64_t)> in_box(std::uint64_t seed, const Vec3& low, const Vec3& high,
                                          double step) {
  return [=](std::uint64_t q) { return off_planes(seed, q, low, high, step); };
}

std::vector<FaceStress> all_stresses() {
  std::vector<FaceStress> list;
  std::uint64_t seed = 100;
  for (Placement p : placements()) {
    p.use_task_checks = true;  // a gather has no long sums
    const double size = p.stress == "smallest" ? 1e30 : p.stress == "largest" ? 1e-20 : 1;
    const bool flat = *std::min_element(p.cells.begin(), p.cells.end()) == 1;
    list.push_back({.particles = p, .u = noise(seed++, size), .flat = flat});
  }
  list.push_back({.particles = {.stress = "constant",
                                .about = "the same velocity on every face of a component",
                                .cells = {12, 9, 14},
                                .n = 1025,
                                .at = in_box(80, {-2, -2, -2}, {14, 11, 16}, 0x1p-9),
                                .v = random_velocity(80)},
                  .u = [](int, int c, std::int64_t, std::int64_t, std::int64_t) {
                    return kConstantFaces[static_cast<std::size_t>(c)];
                  }});
  list.push_back({.particles = {.stress = "offset",
                                .about = "small differences on top of 1000 m/s",
                                .cells = {12, 14, 9},
                                .n = 1025,
                                .at = in_box(81, {-1, -1, -1}, {13, 15, 10}, 0x1p-9),
                                .v = random_velocity(81)},
                  .u = noise(81, 0.125, 1000)});
  list.push_back({.particles = {.stress = "linear",
                                .about = "a linear field on dyadic numbers, dx = 1: answers by hand",
                                .cells = {12, 10, 15},
                                .dx = 1,
                                .n = 1021,
                                .at =
                                    [](std::uint64_t q) {
                                      // Multiples of a quarter of a cell, two cells away from every wall.
                                      Vec3 x = off_planes(82, q, {2, 2, 2}, {10, 8, 13}, 0x1p-4);
                                      for (double& c : x) c = std::floor(4 * c) / 4;
                                      return x;
                                    },
                                .v =
                                    [](std::uint64_t q) {
                                      Vec3 v = random_vector(82, 4, q);
                                      for (double& c : v) c = std::floor(16 * c) / 8;
                                      return v;
                                    }},
                  .u = [](int field, int c, std::int64_t i, std::int64_t j, std::int64_t k) {
                    Vec3 g{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
                    for (std::size_t d = 0; d < 3; ++d) g[d] += static_cast<int>(d) == c ? 0.0 : 0.5;
                    return field == 0 ? linear_at(c, g) : linear_at(c, {2 * g[2], g[0], -g[1]});
                  }});
  list.push_back(
      {.particles = {.stress = "planes_tenth",
                     .about = "dx = 0.1, particles within rounding of whole and half cells up to number 333: "
                              "the quotient lies on one side, the place on the other",
                     .cells = {9, 333, 8},
                     .dx = static_cast<double>(0.1f),
                     .n = 4001,
                     .at =
                         [](std::uint64_t q) {
                           Vec3 x = off_planes(84, q, {0, 0, 0}, {9, 333, 8}, 0.5);
                           for (double& c : x) c = std::floor(2 * c) / 2;
                           return x;
                         },
                     .v = random_velocity(84)},
       .u = noise(84)});
  list.push_back(
      {.particles = {.stress = "single_faces",
                     .about = "one face in 64 is not zero, the last ones along each axis among them; -0 "
                              "in places",
                     .cells = {15, 19, 11},
                     .n = 6007,
                     .at =
                         [](std::uint64_t q) {
                           Vec3 x = off_planes(83, q, {-1, -1, -1}, {16, 20, 12}, 0x1p-10);
                           if (q % 2 == 0) return x;
                           for (double& c : x)  // within two cells of one that is not zero
                             c = 4 * std::floor(c / 4) + 1.25 + 4 * (c / 4 - std::floor(c / 4));
                           return x;
                         },
                     .v = random_velocity(83)},
       .u = [](int field, int c, std::int64_t i, std::int64_t j, std::int64_t k) {
         if (i % 4 == 3 && j % 4 == 3 && k % 4 == 3) return noise(83)(field, c, i, j, k);
         return i % 2 == 0 ? 0.0 : -0.0;
       }});
  return list;
}

}  // namespace

double linear_at(int c, const Vec3& g) {
  const auto row = static_cast<std::size_t>(c);
  return kStart[row] + kSlope[row][0] * g[0] + kSlope[row][1] * g[1] + kSlope[row][2] * g[2];
}

const std::vector<FaceStress>& face_stresses() {
  static const std::vector<FaceStress> list = all_stresses();
  return list;
}

void fill_samples(const FaceStress& s, int field, int c, HostArray& u) {
  const auto out = u.as<float>();
  std::size_t at = 0;
  for (std::int64_t i = 0; i < u.shape()[0]; ++i) {
    for (std::int64_t j = 0; j < u.shape()[1]; ++j) {
      for (std::int64_t k = 0; k < u.shape()[2]; ++k) out[at++] = static_cast<float>(s.u(field, c, i, j, k));
    }
  }
}

}  // namespace gpuphys::mac_particles
