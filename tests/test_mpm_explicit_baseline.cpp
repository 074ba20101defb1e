// The serial baseline of mpm_explicit, validated on its own: by hand, against the operators that it is made
// of, by conservation, and by a wave in a bar.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "core/generators/random.hpp"
#include "tests/time_loops/mpm_explicit.hpp"

namespace gpuphys {
namespace {

using particle_blocks::diagonal;
using particle_blocks::Mat3;
using particle_blocks::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("mpm_explicit");
}

struct Particle {
  Vec3 cell, v;
  Mat3 f;
};

// dx = m = V0 = 1, so that numbers are easy.
Problem unit_problem(const Shape& nodes, const std::vector<Particle>& particles, double dt, double mu,
                     double lambda) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                             {"nx", nodes[0]},
                                             {"ny", nodes[1]},
                                             {"nz", nodes[2]}});
  for (const char* name : {"dx", "mass_p", "V0"}) p.set_scalar(name, 1);
  p.set_scalar("dt", dt);
  p.set_scalar("mu", mu);
  p.set_scalar("lambda", lambda);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t a = 0; a < 3; ++a) {
      p.inputs[0].as<float>()[3 * q + a] = static_cast<float>(particles[q].cell[a]);
      p.inputs[1].as<float>()[3 * q + a] = static_cast<float>(particles[q].v[a]);
      for (std::size_t b = 0; b < 3; ++b)
        p.inputs[2].as<float>()[9 * q + 3 * a + b] = static_cast<float>(particles[q].f[a][b]);
    }
  }
  return p;
}

TEST(MpmExplicitBaseline, OneParticleByHand) {
  // On node (2,2,2), F = diag(2, 1, 1), mu = 1, lambda = 3: tau = diag(10, 6, 6) (p2g_mpm). With dt = 1/8 the
  // nodes have u = v - tau/8 slope/weight, slope/weight = -4, 0, 4: u_x = v_x + (5, 0, -5) along x, and so
  // on. Back: v' = v (symmetric weights). G_xx = sum u_x slope = 5 (-1/2) - 5 (1/2) = -5, G_yy = G_zz = -3.
  const Problem p = unit_problem({5, 5, 5}, {{{2, 2, 2}, {1, 2, 3}, diagonal(2, 1, 1)}}, 0.125, 1, 3);
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t a = 0; a < 3; ++a) {
    EXPECT_NEAR(out[0].value(a), static_cast<double>(a + 1), 1e-14);
    EXPECT_NEAR(out[2].value(a), 2 + static_cast<double>(a + 1) / 8, 1e-14);
    for (std::int64_t b = 0; b < 3; ++b) {
      const double expected = a != b ? 0 : a == 0 ? 2 * (1 - 5.0 / 8) : 1 - 3.0 / 8;
      EXPECT_NEAR(out[1].value(3 * a + b), expected, 1e-14);
    }
  }
}

TEST(MpmExplicitBaseline, OfTwoParticlesTheLighterShareIsGathered) {
  // Both half-way between nodes 2 and 3 along x, in the middle of the weights along y and z: they share all
  // nodes, F = I.
  const Problem p = unit_problem(
      {6, 5, 5}, {{{2.5, 2, 2}, {1, 0, 0}, diagonal(1, 1, 1)}, {{2.5, 2, 2}, {4, 6, -2}, diagonal(1, 1, 1)}},
      0.5, 1, 1);
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t q = 0; q < 2; ++q) {
    EXPECT_NEAR(out[0].value(3 * q), 2.5, 1e-14);
    EXPECT_NEAR(out[0].value(3 * q + 1), 3, 1e-14);
    EXPECT_NEAR(out[2].value(3 * q + 2), 2 - 0.5, 1e-14);
  }
}

TEST(MpmExplicitBaseline, AParticleOutsideStopsAndAnEdgeIsClamped) {
  // One particle far outside; one whose lowest node along x is node 0 only: it moves with that node, and no
  // gradient comes from the two that are the same node.
  const Problem p = unit_problem(
      {4, 5, 5},
      {{{-7.25, 2, 2}, {1, 1, 1}, diagonal(1, 1, 1)}, {{-1.25, 2, 2}, {3, 1, 2}, diagonal(1, 1, 1)}}, 0.5, 1,
      1);
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t d = 0; d < 3; ++d) EXPECT_NEAR(out[0].value(d), d == 0 ? 3 : d == 1 ? 1 : 2, 1e-14);
  EXPECT_NEAR(out[0].value(3), 3, 1e-14);
  for (std::int64_t e = 0; e < 18; ++e) EXPECT_NEAR(out[1].value(e), e % 9 % 4 == 0 ? 1 : 0, 1e-14);
}

TEST(MpmExplicitBaseline, TheStepIsItsOperators) {
  ASSERT_TRUE(testing::mpm_explicit_loop::has_operators("baseline_f64")) << "build p2g_mpm and g2p_mpm too";
  for (const char* set : {"public_smoke", "hard_edges", "hard_dx_tenth", "hard_inverted", "hard_sparse"})
    testing::mpm_explicit_loop::is_its_operators(task(), "baseline_f64", set);
}

TEST(MpmExplicitBaseline, AxesAreAlike) {
  const auto build = [](bool exchanged) {
    std::vector<Particle> particles;
    const std::array<std::size_t, 3> to =
        exchanged ? std::array<std::size_t, 3>{1, 0, 2} : std::array<std::size_t, 3>{0, 1, 2};
    for (std::uint64_t q = 0; q < 40; ++q) {
      Particle particle{{}, {}, diagonal(1, 1, 1)};
      for (std::size_t a = 0; a < 3; ++a) {
        particle.cell[to[a]] = -1 + 8 * uniform01(95, 0, 3 * q + a);
        particle.v[to[a]] = uniform11(95, 1, 3 * q + a);
        for (std::size_t b = 0; b < 3; ++b)
          particle.f[to[a]][to[b]] = (a == b ? 1 : 0) + 0.2 * uniform11(95, 2, 9 * q + 3 * a + b);
      }
      particles.push_back(particle);
    }
    return unit_problem(exchanged ? Shape{6, 5, 7} : Shape{5, 6, 7}, particles, 0.125, 0.3, 0.2);
  };
  const Arrays a = run_module(task(), "baseline_f64", build(false));
  const Arrays b = run_module(task(), "baseline_f64", build(true));
  constexpr std::array<std::int64_t, 3> to{1, 0, 2};
  for (std::int64_t q = 0; q < 40; ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      EXPECT_NEAR(a[0].value(3 * q + static_cast<std::int64_t>(d)), b[0].value(3 * q + to[d]), 1e-11);
      EXPECT_NEAR(a[2].value(3 * q + static_cast<std::int64_t>(d)), b[2].value(3 * q + to[d]), 1e-11);
      for (std::size_t e = 0; e < 3; ++e)
        EXPECT_NEAR(a[1].value(9 * q + static_cast<std::int64_t>(3 * d + e)),
                    b[1].value(9 * q + 3 * to[d] + to[e]), 1e-10);
    }
  }
}

TEST(MpmExplicitBaseline, AWaveInABarHasItsSpeed) {
  testing::mpm_explicit_loop::wave_in_a_bar(task(), "baseline_f64");
}

TEST(MpmExplicitBaseline, AHundredStepsKeepMomentumAndDoNoWork) {
  testing::mpm_explicit_loop::ball_in_flight(task(), "baseline_f64");
}

}  // namespace
}  // namespace gpuphys
