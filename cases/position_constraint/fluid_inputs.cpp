#include "cases/position_constraint/fluid_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/parallel.hpp"
#include "core/generators/abc_flow.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::fluid {
namespace {

constexpr std::uint64_t kJitter = 0, kNoise = 2, kOrder = 99;

}  // namespace

Particles block(const Block& b) {
  const auto& m = b.lattice;
  const std::int64_t n = m[0] * m[1] * m[2];
  std::vector<std::pair<std::uint64_t, std::int64_t>> order(static_cast<std::size_t>(n));
  for (std::int64_t q = 0; q < n; ++q) {
    order[static_cast<std::size_t>(q)] = {random_bits(b.seed, kOrder, static_cast<std::uint64_t>(q)), q};
  }
  std::sort(order.begin(), order.end());
  constexpr double turn = 2 * std::numbers::pi;
  const double k = turn / b.flow_length;
  const AbcFlow flow{b.flow, {k, k, k}};
  Particles all(static_cast<std::size_t>(n));
  parallel_for(n, [&](std::int64_t i) {
    const std::int64_t q = order[static_cast<std::size_t>(i)].second;
    const Vec3 p{b.spacing * static_cast<double>(q / (m[1] * m[2])),
                 b.spacing * static_cast<double>(q / m[2] % m[1]), b.spacing * static_cast<double>(q % m[2])};
    const std::array<double, 3> swirl = flow.at(p[0], p[1], p[2]);
    const auto item = static_cast<std::uint64_t>(q);
    Particle& particle = all[static_cast<std::size_t>(i)];
    for (std::size_t c = 0; c < 3; ++c) {
      const double compressed =
          p[c] + b.wave / 3 * b.wave_length / turn * std::sin(turn * p[c] / b.wave_length);
      particle.x[c] = b.corner[c] + compressed + b.jitter * uniform11(b.seed, kJitter, 3 * item + c);
      particle.v[c] = swirl[c] + b.noise * uniform11(b.seed, kNoise, 3 * item + c);
    }
  });
  return all;
}

Particles cloud(std::uint64_t seed, std::int64_t n, const Vec3& centre, double half, double speed) {
  Particles all(static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      all[i].x[c] = centre[c] + half * uniform11(seed, kJitter, 3 * i + c);
      all[i].v[c] = speed * uniform11(seed, kNoise, 3 * i + c);
    }
  }
  return all;
}

Particles line(std::uint64_t seed, std::int64_t n, std::size_t axis, double speed) {
  Particles all(static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < all.size(); ++i) {
    const std::size_t at = i * 1000 % all.size();
    all[i].x[axis] =
        0.9 * (static_cast<double>(at) - 0.5 * static_cast<double>(n)) + 0.09 * uniform11(seed, kJitter, i);
    for (std::size_t c = 0; c < 3; ++c) all[i].v[c] = speed * uniform11(seed, kNoise, 3 * i + c);
  }
  return all;
}

Particles moved(Particles all, double scale, const Vec3& offset) {
  for (Particle& p : all) {
    for (std::size_t c = 0; c < 3; ++c) p.x[c] = scale * p.x[c] + offset[c];
  }
  return all;
}

Particles joined(Particles all, const Particles& more) {
  all.insert(all.end(), more.begin(), more.end());
  return all;
}

Particles with_coincident(Particles all, std::size_t every) {
  for (std::size_t i = 1; i < all.size(); i += every) all[i].x = all[i - 1].x;
  return all;
}

Problem problem_of(const Contract& contract, const Particles& particles) {
  Problem p = make_problem(contract, {{"n", static_cast<std::int64_t>(particles.size())}});
  for (HostArray& array : p.inputs) {
    const auto values = array.as<float>();
    for (std::size_t i = 0; i < particles.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c)
        values[3 * i + c] = static_cast<float>((array.name() == "x" ? particles[i].x : particles[i].v)[c]);
    }
  }
  return p;
}

}  // namespace gpuphys::fluid
