// The serial baseline of g2p_mpm, validated on its own: by hand, by exact fields, against differences of its
// own velocity, and against the transfer the other way.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "cases/particle_grid/particle_blocks.hpp"
#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using particle_blocks::Mat3;
using particle_blocks::Vec3;
using testing::run_module;

const Task& task() {
  return find_task("g2p_mpm");
}

// dx = 1 and F = I unless set; nodes of a cube of `side`.
Problem unit_problem(std::int64_t side, const std::vector<Vec3>& places, double dt = 1) {
  Problem p = make_problem(
      task().contract,
      {{"n", static_cast<std::int64_t>(places.size())}, {"nx", side}, {"ny", side}, {"nz", side}});
  p.set_scalar("dx", 1);
  p.set_scalar("dt", dt);
  for (std::size_t q = 0; q < places.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(places[q][d]);
      p.inputs[1].as<float>()[9 * q + 4 * d] = 1;
    }
  }
  return p;
}

template <class Field>
void fill_nodes(Problem& p, Field&& field) {
  const Shape n = p.inputs[2].shape();
  for (std::int64_t i = 0; i < n[0]; ++i) {
    for (std::int64_t j = 0; j < n[1]; ++j) {
      for (std::int64_t k = 0; k < n[2]; ++k) {
        const Vec3 u = field(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
        for (std::size_t c = 0; c < 3; ++c)
          p.inputs[2 + c].as<float>()[static_cast<std::size_t>((i * n[1] + j) * n[2] + k)] =
              static_cast<float>(u[c]);
      }
    }
  }
}

Vec3 noise(double i, double j, double k) {
  const auto node = static_cast<std::uint64_t>((i * 64 + j) * 64 + k);
  return {uniform11(81, 0, 3 * node), uniform11(81, 0, 3 * node + 1), uniform11(81, 0, 3 * node + 2)};
}

// v (3), F' (9), x' (3) of one particle.
struct Result {
  Vec3 v, x;
  Mat3 f;
};
Result result_of(const Arrays& out, std::int64_t q) {
  Result r;
  for (std::int64_t d = 0; d < 3; ++d) {
    const auto a = static_cast<std::size_t>(d);
    r.v[a] = out[0].value(3 * q + d);
    r.x[a] = out[2].value(3 * q + d);
    for (std::int64_t e = 0; e < 3; ++e)
      r.f[a][static_cast<std::size_t>(e)] = out[1].value(9 * q + 3 * d + e);
  }
  return r;
}

TEST(G2pMpmBaseline, OneNodeByHand) {
  // Only node (2,3,2) moves, with (8, 16, 32). On it the weight is (3/4)^3 = 27/64 and the gradient 0. One
  // below it along x, at (1,3,2): w = 1/8 (3/4)^2 = 9/128, dw/dx = 1/2 (3/4)^2 = 9/32, the other slopes 0.
  Problem p = unit_problem(6, {{2, 3, 2}, {1, 3, 2}});
  fill_nodes(p, [](double i, double j, double k) {
    return i == 2 && j == 3 && k == 2 ? Vec3{8, 16, 32} : Vec3{0, 0, 0};
  });
  const Arrays out = run_module(task(), "baseline_f64", p);
  const Result on = result_of(out, 0), below = result_of(out, 1);
  EXPECT_DOUBLE_EQ(on.v[0], 8 * 27.0 / 64);
  EXPECT_DOUBLE_EQ(on.v[2], 32 * 27.0 / 64);
  EXPECT_DOUBLE_EQ(on.x[1], 3 + 16 * 27.0 / 64);
  EXPECT_DOUBLE_EQ(on.f[0][0], 1);
  EXPECT_DOUBLE_EQ(on.f[1][0], 0);
  EXPECT_DOUBLE_EQ(below.v[0], 8 * 9.0 / 128);
  EXPECT_DOUBLE_EQ(below.f[0][0], 1 + 8 * 9.0 / 32);
  EXPECT_DOUBLE_EQ(below.f[1][0], 16 * 9.0 / 32);  // dv_y/dx, in row y
  EXPECT_DOUBLE_EQ(below.f[0][1], 0);
}

TEST(G2pMpmBaseline, LinearFieldIsExact) {
  const Mat3 rate{{{0.5, -0.25, 1}, {2, 0.125, -1}, {0.75, -0.5, 0.25}}};
  const Vec3 at{2.3125, 3.75, 2.5};
  Problem p = unit_problem(7, {at}, 0.5);
  const Mat3 f{{{1, 2, 0}, {-1, 0.5, 3}, {0.25, 1, -2}}};
  for (std::size_t e = 0; e < 9; ++e) p.inputs[1].as<float>()[e] = static_cast<float>(f[e / 3][e % 3]);
  const auto field = [&](double i, double j, double k) {
    Vec3 u{1, -2, 0.5};
    const Vec3 g{i, j, k};
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) u[a] += rate[a][b] * g[b];
    }
    return u;
  };
  fill_nodes(p, field);
  const Result r = result_of(run_module(task(), "baseline_f64", p), 0);
  const Vec3 v = field(at[0], at[1], at[2]);
  const Mat3 change = particle_blocks::product(rate, f);  // (A F), not (F A) nor (A^T F)
  for (std::size_t a = 0; a < 3; ++a) {
    EXPECT_NEAR(r.v[a], v[a], 1e-13);
    EXPECT_NEAR(r.x[a], at[a] + 0.5 * v[a], 1e-13);
    for (std::size_t b = 0; b < 3; ++b) EXPECT_NEAR(r.f[a][b], f[a][b] + 0.5 * change[a][b], 1e-13);
  }
}

TEST(G2pMpmBaseline, AQuadraticFieldGainsAQuarterCellSquared) {
  // Quadratic B-splines turn g^2 into g^2 + 1/4, whatever the place between nodes.
  Problem p = unit_problem(8, {{3.0, 3.0, 3.0}, {3.3125, 2.75, 4.5}, {2.5, 4.125, 3.9375}});
  fill_nodes(p, [](double i, double j, double k) { return Vec3{i * i, j * j, i * k}; });
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t q = 0; q < 3; ++q) {
    const Result r = result_of(out, q);
    const Vec3 x{p.inputs[0].value(3 * q), p.inputs[0].value(3 * q + 1), p.inputs[0].value(3 * q + 2)};
    EXPECT_NEAR(r.v[0], x[0] * x[0] + 0.25, 1e-12);
    EXPECT_NEAR(r.v[1], x[1] * x[1] + 0.25, 1e-12);
    EXPECT_NEAR(r.v[2], x[0] * x[2], 1e-12);
    EXPECT_NEAR(r.f[0][0], 1 + 2 * x[0], 1e-12);
    EXPECT_NEAR(r.f[2][0], x[2], 1e-12);
    EXPECT_NEAR(r.f[2][2], 1 + x[0], 1e-12);
  }
}

TEST(G2pMpmBaseline, TheGradientIsThatOfTheVelocity) {
  // Within a cell v is a polynomial of degree 2 along each axis: central differences are exact.
  constexpr double step = 0x1p-6;
  const Vec3 at{3.1875, 2.6875, 4.25};
  std::vector<Vec3> places{at};
  for (std::size_t d = 0; d < 3; ++d) {
    for (const double sign : {-1.0, 1.0}) {
      Vec3 x = at;
      x[d] += sign * step;
      places.push_back(x);
    }
  }
  Problem p = unit_problem(8, places);
  fill_nodes(p, noise);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const Result r = result_of(out, 0);
  for (std::size_t b = 0; b < 3; ++b) {
    const auto axis = static_cast<std::int64_t>(b);
    const Result below = result_of(out, 1 + 2 * axis), above = result_of(out, 2 + 2 * axis);
    for (std::size_t a = 0; a < 3; ++a)
      EXPECT_NEAR(r.f[a][b] - (a == b ? 1 : 0), (above.v[a] - below.v[a]) / (2 * step), 1e-12);
  }
}

TEST(G2pMpmBaseline, OutsideTheVelocityIsTheNearestNodes) {
  const std::int64_t side = 5;
  Problem p =
      unit_problem(side, {{-1.5, 2, 2}, {-1e30, 2, 2}, {5.5, 2, 2}, {1e30, -1e30, 1e30}, {-0.25, 2, 2}});
  fill_nodes(p, noise);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const Result near = result_of(out, 0), far = result_of(out, 1), corner = result_of(out, 3),
               partly = result_of(out, 4);
  const Vec3 last = noise(4, 0, 4);
  for (std::size_t a = 0; a < 3; ++a) {
    EXPECT_DOUBLE_EQ(near.v[a], far.v[a]);
    EXPECT_DOUBLE_EQ(near.f[a][0], a == 0 ? 1 : 0);  // no change along x
    EXPECT_DOUBLE_EQ(corner.v[a], static_cast<double>(static_cast<float>(last[a])));
    EXPECT_NE(partly.v[a], near.v[a]);
  }
  // At -1/4 the nodes -1, 0, 1 have weights 9/32, 22/32, 1/32, the first two of which are node 0.
  double expected = 0;
  for (int j = -1; j <= 1; ++j) {
    for (int k = -1; k <= 1; ++k) {
      const double w = (j == 0 ? 0.75 : 0.125) * (k == 0 ? 0.75 : 0.125);
      expected += w * (31.0 / 32 * static_cast<double>(static_cast<float>(noise(0, 2 + j, 2 + k)[0])) +
                       1.0 / 32 * static_cast<double>(static_cast<float>(noise(1, 2 + j, 2 + k)[0])));
    }
  }
  EXPECT_NEAR(partly.v[0], expected, 1e-13);
}

TEST(G2pMpmBaseline, VolumeGrowsWithTheDivergence) {
  // det((I + dt G) F) = det F (1 + dt tr G) to first order.
  constexpr double dt = 1e-4;
  Problem p = unit_problem(8, {{3.4375, 2.8125, 4.25}}, dt);
  fill_nodes(p, noise);
  const auto det = [](const Mat3& m) {
    return m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
           m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
           m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
  };
  const Result r = result_of(run_module(task(), "baseline_f64", p), 0);
  const double trace = (r.f[0][0] + r.f[1][1] + r.f[2][2] - 3) / dt;
  EXPECT_NEAR((det(r.f) - 1) / dt, trace, 1e-3);
}

TEST(G2pMpmBaseline, IsTheTransposeOfP2gMpm) {
  // sum_i w_i . (sum_p w_ip v_p) = sum_p v_p . (sum_i w_ip w_i) for any node field w and particle velocities
  // v: p2g_mpm without stress (F = I) and with the node masses of a uniform field.
  const std::int64_t side = 9;
  std::vector<Vec3> places;
  for (std::uint64_t q = 0; q < 40; ++q) {
    Vec3 x;
    for (std::size_t d = 0; d < 3; ++d)
      x[d] = 2 + std::floor(64 * 4 * uniform01(82, 0, 3 * q + d)) / 64 + 0x1p-8;
    places.push_back(x);
  }
  Problem back = unit_problem(side, places);
  fill_nodes(back, noise);
  const Arrays gathered = run_module(task(), "baseline_f64", back);

  const Task& there = find_task("p2g_mpm");
  Problem p = make_problem(there.contract, {{"n", 40}, {"nx", side}, {"ny", side}, {"nz", side}});
  for (const char* name : {"dx", "dt", "mass_p", "V0", "mu", "lambda"}) p.set_scalar(name, 1);
  double expected = 0, found = 0;
  for (std::size_t q = 0; q < places.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      const double v = uniform11(83, 0, 3 * q + d);
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(places[q][d]);
      p.inputs[1].as<float>()[3 * q + d] = static_cast<float>(v);
      p.inputs[2].as<float>()[9 * q + 4 * d] = 1;
      expected += static_cast<double>(static_cast<float>(v)) *
                  gathered[0].value(static_cast<std::int64_t>(3 * q + d));
    }
  }
  const Arrays u = run_module(there, "baseline_f64", p);
  const auto spline = [](double r) {
    const double a = std::abs(r);
    return a < 0.5 ? 0.75 - a * a : a < 1.5 ? 0.5 * (1.5 - a) * (1.5 - a) : 0.0;
  };
  for (std::int64_t node = 0; node < side * side * side; ++node) {
    const std::array<double, 3> at{static_cast<double>(node / side / side),
                                   static_cast<double>(node / side % side), static_cast<double>(node % side)};
    double mass = 0;
    for (const Vec3& x : places) mass += spline(x[0] - at[0]) * spline(x[1] - at[1]) * spline(x[2] - at[2]);
    for (std::size_t c = 0; c < 3; ++c) found += mass * u[c].value(node) * back.inputs[2 + c].value(node);
  }
  EXPECT_NEAR(found, expected, 1e-11);
}

}  // namespace
}  // namespace gpuphys
