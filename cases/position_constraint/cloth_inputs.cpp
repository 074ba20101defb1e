#include "cases/position_constraint/cloth_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::position_constraint {
namespace {

// Random streams; vector component d of particle q (numbered before shuffling) is item 3 q + d.
constexpr std::uint64_t kJitterStream = 0, kNoiseStream = 1, kFlipStream = 97, kSpringStream = 98,
                        kParticleStream = 99;
constexpr std::int64_t kRow = 4096;  // items that one call of a parallel loop handles

template <class Body>
void for_each_item(std::int64_t n, Body&& body) {
  parallel_for((n + kRow - 1) / kRow, [&](std::int64_t row) {
    const std::int64_t end = std::min(n, (row + 1) * kRow);
    for (std::int64_t i = row * kRow; i < end; ++i) body(i);
  });
}

// Arc length of r = c theta from the pole to radius r, up to a constant.
double spiral_length(double r, double c) {
  return (r * std::hypot(r, c) + c * c * std::asinh(r / c)) / (2 * c);
}

// Radius of the spiral at arc length `s` from the start radius.
double spiral_radius(double s, double start, double c) {
  const double target = spiral_length(start, c) + s;
  double r = std::sqrt(std::max(start * start + 2 * c * s, c * c));
  for (int step = 0; step < 8; ++step) r -= (spiral_length(r, c) - target) * c / std::hypot(r, c);
  return r;
}

}  // namespace

std::vector<std::int32_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t n) {
  std::vector<std::pair<std::uint64_t, std::int32_t>> keyed(static_cast<std::size_t>(n));
  for_each_item(n, [&](std::int64_t i) {
    keyed[static_cast<std::size_t>(i)] = {random_bits(seed, stream, static_cast<std::uint64_t>(i)),
                                          static_cast<std::int32_t>(i)};
  });
  std::sort(keyed.begin(), keyed.end());
  std::vector<std::int32_t> order;
  order.reserve(keyed.size());
  for (const auto& item : keyed) order.push_back(item.second);
  return order;
}

std::vector<std::array<std::int32_t, 2>> sheet_springs(std::int64_t rows, std::int64_t columns) {
  constexpr std::array<std::array<std::int64_t, 2>, 6> directions{
      {{1, 0}, {0, 1}, {1, 1}, {1, -1}, {2, 0}, {0, 2}}};
  std::vector<std::array<std::int32_t, 2>> springs;
  springs.reserve(static_cast<std::size_t>(6 * rows * columns));
  for (std::int64_t a = 0; a < rows; ++a) {
    for (std::int64_t b = 0; b < columns; ++b) {
      for (const auto& [da, db] : directions) {
        if (a + da >= rows || b + db < 0 || b + db >= columns) continue;
        springs.push_back({static_cast<std::int32_t>(a * columns + b),
                           static_cast<std::int32_t>((a + da) * columns + b + db)});
      }
    }
  }
  return springs;
}

Cloth make_rolled_cloth(const RolledCloth& c) {
  const std::int64_t sheet = c.rows * c.columns, n = sheet + c.free_side * c.free_side * c.free_side;
  const double growth = c.turn_gap / (2 * std::numbers::pi);  // of the radius per radian
  const double wave_a = 2 * std::numbers::pi * c.periods / static_cast<double>(c.rows);
  const double wave_b = 2 * std::numbers::pi * c.periods / static_cast<double>(c.columns);
  const std::vector<std::int32_t> particles = random_order(c.seed, kParticleStream, n);

  Cloth cloth;
  cloth.position.resize(static_cast<std::size_t>(n));
  cloth.velocity.resize(static_cast<std::size_t>(n));
  std::vector<std::int32_t> number(static_cast<std::size_t>(n));  // shuffled number of each particle
  for_each_item(n, [&](std::int64_t i) {
    const std::int64_t q = particles[static_cast<std::size_t>(i)];  // number before shuffling
    number[static_cast<std::size_t>(q)] = static_cast<std::int32_t>(i);
    std::array<double, 3> x, wave{0, 0, 0};
    if (q < sheet) {
      const double a = static_cast<double>(q / c.columns), b = static_cast<double>(q % c.columns);
      const double s = a + c.strain / wave_a * std::sin(wave_a * a) * std::cos(wave_b * b);
      const double y = b + c.strain / wave_b * std::sin(wave_b * b + 1) * std::cos(wave_a * a);
      const double r = spiral_radius(s, c.start_radius, growth), theta = (r - c.start_radius) / growth;
      x = {r * std::cos(theta), y - 0.5 * static_cast<double>(c.columns - 1), r * std::sin(theta)};
      wave = {std::sin(wave_b * b + 0.3) * std::cos(wave_a * a),
              std::sin(wave_a * a + 1.3) * std::cos(wave_b * b), std::sin(wave_a * a + wave_b * b + 2.3)};
    } else {
      const std::int64_t f = q - sheet, side = c.free_side;
      x = {70 + 2 * static_cast<double>(f / side / side), -15 + 2 * static_cast<double>(f / side % side),
           -15 + 2 * static_cast<double>(f % side)};
    }
    for (std::size_t d = 0; d < 3; ++d) {
      const std::uint64_t item = 3 * static_cast<std::uint64_t>(q) + d;
      cloth.position[static_cast<std::size_t>(i)][d] =
          x[d] + c.jitter * uniform11(c.seed, kJitterStream, item);
      cloth.velocity[static_cast<std::size_t>(i)][d] =
          c.speed * (wave[d] + c.noise * uniform11(c.seed, kNoiseStream, item));
    }
  });

  const std::vector<std::array<std::int32_t, 2>> springs = sheet_springs(c.rows, c.columns);
  const auto m = static_cast<std::int64_t>(springs.size());
  const std::vector<std::int32_t> order = random_order(c.seed, kSpringStream, m);
  cloth.springs.resize(springs.size());
  cloth.rest.resize(springs.size());
  for_each_item(m, [&](std::int64_t i) {
    const std::array<std::int32_t, 2>& spring =
        springs[static_cast<std::size_t>(order[static_cast<std::size_t>(i)])];
    const auto [p, q] = spring;
    const double da = static_cast<double>(q / c.columns - p / c.columns);
    const double db = static_cast<double>(q % c.columns - p % c.columns);
    const std::size_t flip = random_bits(c.seed, kFlipStream, static_cast<std::uint64_t>(i)) & 1;
    std::array<std::int32_t, 2>& ends = cloth.springs[static_cast<std::size_t>(i)];
    ends[flip] = number[static_cast<std::size_t>(p)];
    ends[1 - flip] = number[static_cast<std::size_t>(q)];
    cloth.rest[static_cast<std::size_t>(i)] = std::hypot(da, db);
  });
  return cloth;
}

}  // namespace gpuphys::position_constraint
