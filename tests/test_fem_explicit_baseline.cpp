// The serial baseline of fem_explicit, validated on its own: by the energy that its forces come from, by
// conservation, by affine and rigid motions, by the period of a bar, and in a time loop.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "cases/local_interaction/elastic_inputs.hpp"
#include "cases/local_interaction/fem_explicit.hpp"
#include "tests/run_module.hpp"
#include "tests/time_loops/fem_explicit.hpp"

namespace gpuphys {
namespace {

using elastic::Mat3;
using elastic::TetBody;
using elastic::Vec3;
using elastic::operator*;
using testing::run_module;

const Task& task() {
  return find_task("fem_explicit");
}

Problem problem_of(const TetBody& body, double mu = 400, double lambda = 600, double dt = 1) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                             {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", mu);
  p.set_scalar("lambda", lambda);
  p.set_scalar("dt", dt);
  return p;
}

// Forces on all coordinates, of a problem with dt = 1.
std::vector<double> forces(const Problem& p) {
  const Arrays out = run_module(task(), "baseline_f64", p);
  const auto in = bind_inputs<fem_explicit::Inputs>(p);
  std::vector<double> f(static_cast<std::size_t>(in.x.size()));
  for (std::size_t c = 0; c < f.size(); ++c) {
    f[c] =
        (find(out, "v_new", "out").value(static_cast<std::int64_t>(c)) - static_cast<double>(in.v.data[c])) *
        static_cast<double>(in.mass.data[c / 3]);
  }
  return f;
}

TetBody block() {
  return elastic::tet_block(
      {3, 4, 5}, {.periods = 1, .strain = 0.1, .jitter = 0.05, .speed = 1, .noise = 0.1, .seed = 7});
}

TEST(FemExplicitBaseline, TheForceIsMinusTheSlopeOfTheEnergy) {
  Problem p = problem_of(block());
  const std::vector<double> f = forces(p);
  const auto x = p.inputs[1].as<float>();
  double size = 0;
  for (const double component : f) size = std::max(size, std::abs(component));
  for (std::size_t c = 0; c < x.size(); c += 7) {
    const float start = x[c];
    x[c] = start + 0x1p-10f;
    const double above = testing::tet_totals(p).elastic, high = static_cast<double>(x[c]);
    x[c] = start - 0x1p-10f;
    const double slope = (above - testing::tet_totals(p).elastic) / (high - static_cast<double>(x[c]));
    x[c] = start;
    EXPECT_NEAR(f[c], -slope, 1e-4 * size) << "coordinate " << c;
  }
}

TEST(FemExplicitBaseline, ForcesKeepMomentumAndAngularMomentum) {
  Problem p = problem_of(block());
  const std::vector<double> f = forces(p);
  double sum[3] = {0, 0, 0}, torque[3] = {0, 0, 0}, size = 0;
  for (std::size_t c = 0; c < f.size(); ++c) {
    const std::size_t d = c % 3, i = c - d;
    sum[d] += f[c];
    size += std::abs(f[c]);
    const std::size_t d1 = (d + 1) % 3, d2 = (d + 2) % 3;
    const auto x = p.inputs[1].as<float>();
    torque[d] += static_cast<double>(x[i + d1]) * f[i + d2] - static_cast<double>(x[i + d2]) * f[i + d1];
  }
  for (int d = 0; d < 3; ++d) {
    EXPECT_LT(std::abs(sum[d]), 1e-13 * size);
    EXPECT_LT(std::abs(torque[d]), 1e-12 * size);
  }
}

TEST(FemExplicitBaseline, AnAffineMapLeavesInnerVerticesWithoutForce) {
  TetBody b = block();
  const Mat3 map{{{1.25, 0.125, 0}, {-0.25, 0.875, 0.0625}, {0.5, 0, 1}}};
  // Multiples of 2^-10, so that positions after the map are exact.
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    for (double& c : b.rest[i]) c = std::round(c * 1024) / 1024;
    b.x[i] = map * b.rest[i];
  }
  const std::vector<double> f = forces(problem_of(b));
  int inner = 0;
  double largest = 0;
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    const Vec3& p = b.rest[i];
    const bool inside = std::abs(p[0]) < 1.2 && std::abs(p[1]) < 1.7 && std::abs(p[2]) < 2.2;
    inner += inside;
    for (std::size_t d = 0; d < 3; ++d) {
      largest = std::max(largest, std::abs(f[3 * i + d]));
      if (inside) {
        EXPECT_NEAR(f[3 * i + d], 0, 1e-10);
      }
    }
  }
  EXPECT_EQ(inner, 2 * 3 * 4);
  EXPECT_GT(largest, 1);
}

TEST(FemExplicitBaseline, ARigidMotionHasNoForce) {
  TetBody b = block();
  const Mat3 turn{{{0, 0, 1}, {1, 0, 0}, {0, 1, 0}}};
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    for (double& c : b.rest[i]) c = std::round(c * 1024) / 1024;
    b.x[i] = turn * b.rest[i];
    b.x[i][1] += 16;
  }
  for (const double f : forces(problem_of(b))) EXPECT_NEAR(f, 0, 1e-10);
}

TEST(FemExplicitBaseline, VerticesMoveWithTheNewVelocity) {
  Problem p = problem_of(block(), 400, 600, 0.01);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const double dt = p.scalar("dt");
  for (std::int64_t c = 0; c < p.inputs[1].size(); ++c) {
    EXPECT_NEAR(find(out, "x_new", "out").value(c),
                p.inputs[1].value(c) + dt * find(out, "v_new", "out").value(c), 1e-13);
  }
}

TEST(FemExplicitBaseline, ABarSwingsWithItsPeriod) {
  // A bar with free ends, of Poisson's ratio 0: its first mode along x has half a wave, at pi / L sqrt(E /
  // rho).
  constexpr double young = 100, length = 16, dt = 0.02;
  TetBody b = elastic::tet_block({16, 1, 1},
                                 {.periods = 1, .strain = 0, .jitter = 0, .speed = 0, .noise = 0, .seed = 8});
  for (double& m : b.mass) m = 0;
  for (const auto& tet : b.tets) {
    for (const std::int32_t i : tet) b.mass[static_cast<std::size_t>(i)] += 1.0 / 24;  // density 1 kg/m^3
  }
  const auto mode = [&](std::size_t i) { return std::sin(std::numbers::pi * b.rest[i][0] / length); };
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    b.x[i] = b.rest[i];
    b.x[i][0] += 0.02 * mode(i);
  }
  Problem p = problem_of(b, young / 2, 0, dt);
  const auto x = p.inputs[1].as<float>(), v = p.inputs[2].as<float>();
  const auto amplitude = [&] {
    double sum = 0;
    for (std::size_t i = 0; i < b.x.size(); ++i)
      sum += (static_cast<double>(x[3 * i]) - b.rest[i][0]) * mode(i);
    return sum;
  };
  std::vector<double> crossings;
  double earlier = amplitude();
  for (int step = 1; crossings.size() < 2 && step < 1000; ++step) {
    const Arrays out = run_module(task(), "baseline_f64", p);
    for (std::size_t c = 0; c < x.size(); ++c) {
      x[c] = static_cast<float>(find(out, "x_new", "out").value(static_cast<std::int64_t>(c)));
      v[c] = static_cast<float>(find(out, "v_new", "out").value(static_cast<std::int64_t>(c)));
    }
    const double now = amplitude();
    if (earlier * now < 0) crossings.push_back(dt * (step - now / (now - earlier)));
    earlier = now;
  }
  ASSERT_EQ(crossings.size(), 2u);
  const double half_period = length / std::sqrt(young);
  EXPECT_NEAR(crossings[1] - crossings[0], half_period, 0.03 * half_period);
}

TEST(TetBlock, HasThePapersNumbersAndPositiveVolumes) {
  // 6 tetrahedra a cube; 96^3 cubes have 5,308,416 and 912,673 vertices.
  const TetBody b = block();
  EXPECT_EQ(b.tets.size(), 6u * 60);
  EXPECT_EQ(b.x.size(), 4u * 5 * 6);
  Problem p = problem_of(b);
  EXPECT_GT(testing::tet_totals(p).smallest_j, 0.3);
  double volume = 0;
  for (const auto& tet : b.tets) {
    double e[3][3];
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        e[c][k] =
            b.rest[static_cast<std::size_t>(tet[k + 1])][c] - b.rest[static_cast<std::size_t>(tet[0])][c];
      }
    }
    EXPECT_GT(testing::determinant_of(e), 0.2);
    volume += testing::determinant_of(e) / 6;
  }
  EXPECT_NEAR(volume, 60, 3);  // the jitter of the surface
}

TEST(FemExplicitBaseline, ABlockOfJellyBounces) {
  testing::time_loop_fem_explicit("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
