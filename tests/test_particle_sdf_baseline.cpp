// The serial baseline of particle_sdf, validated on its own: closed forms, brute force, and what a distance
// must obey.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cases/collision_query/particle_sdf.hpp"
#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using Vec3 = std::array<double, 3>;
using Extents = std::array<std::int64_t, 3>;
using testing::run_module;

const Task& task() {
  return find_task("particle_sdf");
}

/// In metres.
Problem problem_of(const std::vector<Vec3>& particles, const Extents& cells, double dx, double r,
                   double clamp) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                             {"nx", cells[0]},
                                             {"ny", cells[1]},
                                             {"nz", cells[2]}});
  p.set_scalar("nx", static_cast<double>(cells[0]));
  p.set_scalar("ny", static_cast<double>(cells[1]));
  p.set_scalar("nz", static_cast<double>(cells[2]));
  p.set_scalar("dx", dx);
  p.set_scalar("r", r);
  p.set_scalar("clamp", clamp);
  for (std::size_t i = 0; i < particles.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      p.inputs[0].as<float>()[3 * i + c] = static_cast<float>(particles[i][c]);
  }
  return p;
}

Arrays phi_of(const Problem& p) {
  return run_module(task(), "baseline_f64", p);
}

std::vector<Vec3> cloud(std::uint64_t seed, std::size_t n, double low, double size) {
  std::vector<Vec3> all(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c) all[i][c] = low + size * uniform01(seed, c, i);
  }
  return all;
}

// dx = 1/2, the particle on the centre of cell (1, 2, 3), r = 1/4.
TEST(ParticleSdfBaseline, OneParticleByHand) {
  const Arrays out = phi_of(problem_of({{0.75, 1.25, 1.75}}, {4, 5, 6}, 0.5, 0.25, 1));
  const auto at = [&](int i, int j, int k) { return out[0].value((i * 5 + j) * 6 + k); };
  EXPECT_EQ(at(1, 2, 3), -0.25);
  EXPECT_EQ(at(1, 2, 4), 0.25);
  EXPECT_EQ(at(0, 2, 3), 0.25);
  EXPECT_EQ(at(1, 0, 3), 0.75);
  EXPECT_NEAR(at(2, 3, 3), std::sqrt(0.5) - 0.25, 1e-15);
  EXPECT_NEAR(at(2, 1, 2), std::sqrt(0.75) - 0.25, 1e-15);
  EXPECT_EQ(at(3, 4, 0), 1);  // clamped: the distance is sqrt(1 + 1 + 9/4)
}

TEST(ParticleSdfBaseline, TheNearestParticleCounts) {
  const Arrays out = phi_of(problem_of({{0.5, 0.5, 2.5}, {0.5, 0.5, 0}, {0.5, 0.5, 2}}, {1, 1, 4}, 1, 0, 9));
  // Centres at 1/2, 3/2, 5/2, 7/2.
  EXPECT_EQ(out[0].value(0), 0.5);
  EXPECT_EQ(out[0].value(1), 0.5);
  EXPECT_EQ(out[0].value(2), 0);
  EXPECT_EQ(out[0].value(3), 1);
}

TEST(ParticleSdfBaseline, ParticlesOutsideTheGridCount) {
  const Arrays out =
      phi_of(problem_of({{-1, 0.5, 0.5}, {3.25, 0.5, 0.5}, {1e30, 0, 0}}, {3, 1, 1}, 1, 0.25, 1.5));
  EXPECT_EQ(out[0].value(0), 1.25);
  EXPECT_EQ(out[0].value(1), 1.5);
  EXPECT_EQ(out[0].value(2), 0.5);
}

// A plane of particles above centres: phi is the height over it.
TEST(ParticleSdfBaseline, APlaneOfSpheres) {
  std::vector<Vec3> plane;
  for (int i = -2; i < 9; ++i) {
    for (int j = -2; j < 10; ++j) plane.push_back({i + 0.5, j + 0.5, 4.25});
  }
  const Arrays out = phi_of(problem_of(plane, {7, 8, 9}, 1, 0.75, 2));
  for (std::int64_t c = 0; c < out[0].size(); ++c) {
    const double height = std::abs(static_cast<double>(c % 9) + 0.5 - 4.25);
    EXPECT_EQ(out[0].value(c), std::min(2.0, height - 0.75));
  }
}

TEST(ParticleSdfBaseline, EveryParticleAgainstEveryCentre) {
  const Extents cells{9, 12, 7};
  for (const auto& [r, clamp] : {std::pair{0.9, 1.0}, {2.5, 4.0}, {0.0, 0.5}, {1.5, -0.5}}) {
    const Problem p = problem_of(cloud(3, 50, -2, 15), cells, 1, r, clamp);
    const auto in = bind_inputs<particle_sdf::Inputs>(p);
    const Arrays out = phi_of(p);
    for (std::int64_t c = 0; c < out[0].size(); ++c) {
      const Vec3 centre{static_cast<double>(c / 84) + 0.5, static_cast<double>(c / 7 % 12) + 0.5,
                        static_cast<double>(c % 7) + 0.5};
      double expected = static_cast<double>(in.clamp);
      for (std::int64_t q = 0; q < in.x.shape[0]; ++q) {
        expected = std::min(expected, std::hypot(centre[0] - static_cast<double>(in.x(q, 0)),
                                                 centre[1] - static_cast<double>(in.x(q, 1)),
                                                 centre[2] - static_cast<double>(in.x(q, 2))) -
                                          static_cast<double>(in.r));
      }
      ASSERT_NEAR(out[0].value(c), expected, 1e-14);
    }
  }
}

TEST(ParticleSdfBaseline, AnotherParticleNeverRaisesPhi) {
  std::vector<Vec3> particles = cloud(4, 100, 0, 8);
  const Arrays before = phi_of(problem_of(particles, {8, 8, 8}, 1, 0.8, 1));
  particles.push_back({3, 4, 5});
  const Arrays after = phi_of(problem_of(particles, {8, 8, 8}, 1, 0.8, 1));
  bool lower = false;
  for (std::int64_t c = 0; c < before[0].size(); ++c) {
    ASSERT_LE(after[0].value(c), before[0].value(c));
    lower = lower || after[0].value(c) < before[0].value(c);
  }
  EXPECT_TRUE(lower);
}

TEST(ParticleSdfBaseline, OrderOfTheParticlesDoesNotMatter) {
  std::vector<Vec3> particles = cloud(5, 300, 0, 8);
  const Arrays before = phi_of(problem_of(particles, {8, 7, 6}, 1, 0.8, 1));
  std::reverse(particles.begin(), particles.end());
  const Arrays after = phi_of(problem_of(particles, {8, 7, 6}, 1, 0.8, 1));
  for (std::int64_t c = 0; c < before[0].size(); ++c) EXPECT_EQ(after[0].value(c), before[0].value(c));
}

TEST(ParticleSdfInputs, TheBallHoldsEightParticlesPerCell) {
  const Problem p = task().set("public_smoke").make();
  const auto in = bind_inputs<particle_sdf::Inputs>(p);
  std::vector<int> held(static_cast<std::size_t>(37 * 34 * 45), 0);
  for (std::int64_t q = 0; q < in.x.shape[0]; ++q) {
    const auto cell = [&](int c) {
      return static_cast<std::int64_t>(std::floor(static_cast<double>(in.x(q, c)) / in.dx));
    };
    ++held[static_cast<std::size_t>((cell(0) * 34 + cell(1)) * 45 + cell(2))];
  }
  std::int64_t full = 0;
  for (const int n : held) {
    EXPECT_TRUE(n == 0 || n == 8);
    full += n == 8;
  }
  EXPECT_EQ(8 * full, in.x.shape[0]);
  EXPECT_NEAR(static_cast<double>(full), 4.0 / 3 * 3.14159 * 12 * 12 * 12, 100);
}

}  // namespace
}  // namespace gpuphys
