// The serial baseline of velocity_gradient_mpm, validated on its own: by hand, by exact fields, and against
// the same gradient in g2p_mpm.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <vector>

#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using Vec3 = std::array<double, 3>;

const Task& task() {
  return find_task("velocity_gradient_mpm");
}

template <class Field>
Problem problem(std::int64_t side, double dx, const std::vector<Vec3>& cells, Field&& field) {
  Problem p = make_problem(
      task().contract,
      {{"n", static_cast<std::int64_t>(cells.size())}, {"nx", side}, {"ny", side}, {"nz", side}});
  p.set_scalar("dx", dx);
  for (std::size_t q = 0; q < cells.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d)
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(cells[q][d] * dx);
  }
  for (std::int64_t node = 0; node < side * side * side; ++node) {
    const Vec3 u = field(static_cast<double>(node / side / side), static_cast<double>(node / side % side),
                         static_cast<double>(node % side));
    for (std::size_t c = 0; c < 3; ++c)
      p.inputs[1 + c].as<float>()[static_cast<std::size_t>(node)] = static_cast<float>(u[c]);
  }
  return p;
}

Vec3 noise(double i, double j, double k) {
  const auto node = static_cast<std::uint64_t>((i * 64 + j) * 64 + k);
  return {uniform11(84, 0, 3 * node), uniform11(84, 0, 3 * node + 1), uniform11(84, 0, 3 * node + 2)};
}

TEST(VelocityGradientMpmBaseline, OneNodeByHand) {
  // A particle on node (2,2,2), dx = 1/2: slopes (-1/2, 0, 1/2) per cell, weights (1/8, 3/4, 1/8). Only node
  // (2,3,2) moves, with u_z = 4: dv_z/dy = 4 x 3/4 x 1/2 x 3/4 / (1/2) = 9/4, all else 0.
  const Problem p = problem(5, 0.5, {{2, 2, 2}}, [](double i, double j, double k) {
    return i == 2 && j == 3 && k == 2 ? Vec3{0, 0, 4} : Vec3{0, 0, 0};
  });
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t e = 0; e < 9; ++e) EXPECT_DOUBLE_EQ(out[0].value(e), e == 7 ? 2.25 : 0) << e;
}

TEST(VelocityGradientMpmBaseline, LinearFieldIsExactForAnySpacing) {
  for (const double dx : {0x1p-8, 0.1, 3.0}) {
    const Problem p =
        problem(7, dx, {{2.3125, 3.75, 2.5}, {3.25, 2.0, 4.0}}, [](double i, double j, double k) {
          return Vec3{i - 2 * j, 3 * k + 0.5 * i, j};
        });
    const Arrays out = run_module(task(), "baseline_f64", p);
    const auto spacing = static_cast<double>(static_cast<float>(dx));
    const std::array<double, 9> rate{1, -2, 0, 0.5, 0, 3, 0, 1, 0};
    for (std::int64_t e = 0; e < 18; ++e)
      EXPECT_NEAR(out[0].value(e) * spacing, rate[static_cast<std::size_t>(e % 9)], 1e-12);
  }
}

TEST(VelocityGradientMpmBaseline, AConstantFieldHasNone) {
  const Problem p = problem(5, 0x1p-8, {{1.1, 2.2, 1.7}, {-7, 2, 11}}, [](double, double, double) {
    return Vec3{1000.1, -0.3, 1e-3};
  });
  const Arrays out = run_module(task(), "baseline_f32", p);
  for (std::int64_t e = 0; e < out[0].size(); ++e) EXPECT_EQ(out[0].value(e), 0);
}

TEST(VelocityGradientMpmBaseline, AxesAreAlike) {
  // Exchanging x and z of places, nodes and components exchanges rows and columns of G.
  const std::vector<Vec3> places{{2.3125, 1.75, 3.5}, {-0.25, 4.5, 1.0}};
  std::vector<Vec3> exchanged = places;
  for (Vec3& x : exchanged) std::swap(x[0], x[2]);
  const Arrays one = run_module(task(), "baseline_f64", problem(6, 0.25, places, noise));
  const Arrays other =
      run_module(task(), "baseline_f64", problem(6, 0.25, exchanged, [](double i, double j, double k) {
                   Vec3 u = noise(k, j, i);
                   std::swap(u[0], u[2]);
                   return u;
                 }));
  for (std::int64_t q = 0; q < 2; ++q) {
    for (std::int64_t a = 0; a < 3; ++a) {
      for (std::int64_t b = 0; b < 3; ++b)
        EXPECT_NEAR(one[0].value(9 * q + 3 * a + b), other[0].value(9 * q + 3 * (2 - a) + 2 - b), 1e-12);
    }
  }
}

TEST(VelocityGradientMpmBaseline, IsTheGradientOfG2pMpm) {
  // F = I and dt = 1: F' = I + G.
  const Problem p = problem(9, 0.5, {{2.3125, 1.75, 3.5}, {-0.25, 8.5, 1.0}, {4, 4.5, 30}}, noise);
  const Task& step = find_task("g2p_mpm");
  Problem s = make_problem(step.contract, {{"n", 3}, {"nx", 9}, {"ny", 9}, {"nz", 9}});
  s.set_scalar("dx", 0.5);
  s.set_scalar("dt", 1);
  s.inputs[0] = p.inputs[0].clone();
  for (std::size_t c = 0; c < 3; ++c) s.inputs[2 + c] = p.inputs[1 + c].clone();
  for (std::size_t e = 0; e < 27; ++e) s.inputs[1].as<float>()[e] = e % 9 % 4 == 0 ? 1.0f : 0.0f;
  const Arrays g = run_module(task(), "baseline_f64", p), f = run_module(step, "baseline_f64", s);
  for (std::int64_t e = 0; e < 27; ++e)
    EXPECT_NEAR(f[1].value(e), (e % 9 % 4 == 0 ? 1 : 0) + g[0].value(e), 1e-12);
}

}  // namespace
}  // namespace gpuphys
