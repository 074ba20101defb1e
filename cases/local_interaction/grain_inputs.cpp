#include "cases/local_interaction/grain_inputs.hpp"

#include <algorithm>
#include <utility>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::grains {
namespace {

constexpr std::uint64_t kJitter = 0, kRadius = 1, kNoise = 2, kSpin = 3, kOrder = 99;

}  // namespace

std::vector<Grain> packing(const Packing& p) {
  const auto& m = p.lattice;
  const std::int64_t n = m[0] * m[1] * m[2];
  std::vector<std::pair<std::uint64_t, std::int64_t>> order(static_cast<std::size_t>(n));
  for (std::int64_t q = 0; q < n; ++q) {
    order[static_cast<std::size_t>(q)] = {random_bits(p.seed, kOrder, static_cast<std::uint64_t>(q)), q};
  }
  std::sort(order.begin(), order.end());
  std::vector<Grain> grains(static_cast<std::size_t>(n));
  parallel_for(n, [&](std::int64_t i) {
    const std::int64_t q = order[static_cast<std::size_t>(i)].second;
    const Vec3 point{static_cast<double>(q / (m[1] * m[2])), static_cast<double>(q / m[2] % m[1]),
                     static_cast<double>(q % m[2])};
    const auto item = static_cast<std::uint64_t>(q);
    Grain& g = grains[static_cast<std::size_t>(i)];
    for (std::size_t c = 0; c < 3; ++c) {
      g.x[c] = p.corner[c] + point[c] + p.jitter * uniform11(p.seed, kJitter, 3 * item + c);
      g.v[c] = p.noise * uniform11(p.seed, kNoise, 3 * item + c);
      g.omega[c] = p.spin * uniform11(p.seed, kSpin, 3 * item + c);
    }
    g.v[0] += p.shear * point[2];
    g.radius = p.smallest + (p.largest - p.smallest) * uniform01(p.seed, kRadius, item);
  });
  return grains;
}

}  // namespace gpuphys::grains
