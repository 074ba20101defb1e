// The ABC flow: its values, its size, and that it is a Beltrami field.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/generators/abc_flow.hpp"

namespace gpuphys {
namespace {

TEST(AbcFlow, ValuesByHand) {
  const AbcFlow flow{2.0, {1, 1, 1}};
  const double quarter = std::numbers::pi / 2;
  const auto origin = flow.at(0, 0, 0);
  for (const double u : origin) EXPECT_EQ(u, 2.0);
  // x a quarter period on: sin(x) = 1, cos(x) = 0; the other two sines and cosines as at the origin.
  const auto shifted = flow.at(quarter, 0, 0);
  EXPECT_NEAR(shifted[0], 2.0, 1e-15);
  EXPECT_NEAR(shifted[1], 4.0, 1e-15);
  EXPECT_NEAR(shifted[2], 0.0, 1e-15);
}

TEST(AbcFlow, RepeatsAfterTheBoxOverThePeriods) {
  const AbcFlow flow = AbcFlow::periodic(1.0, 3, {24, 30, 36});
  const auto a = flow.at(1.3, 2.1, -0.7), b = flow.at(1.3 + 8, 2.1 + 10, -0.7 + 12);
  for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(a[d], b[d], 1e-13);
}

TEST(AbcFlow, RootMeanSquareSpeed) {
  const AbcFlow flow = AbcFlow::periodic(0.5, 2, {12, 16, 20});
  double sum = 0;
  for (int i = 0; i < 12; ++i) {
    for (int j = 0; j < 16; ++j) {
      for (int k = 0; k < 20; ++k) {
        for (const double u : flow.at(i, j, k)) sum += u * u;
      }
    }
  }
  EXPECT_NEAR(std::sqrt(sum / (12 * 16 * 20)), std::sqrt(3.0) * 0.5, 1e-12);
}

TEST(AbcFlow, CurlIsProportionalToTheVelocityAndDivergenceIsZero) {
  const double k = 0.7, h = 1e-4;
  const AbcFlow flow{1.0, {k, k, k}};
  const std::array<double, 3> x{0.3, -1.1, 2.4};
  double gradient[3][3];  // [component][axis]
  for (std::size_t d = 0; d < 3; ++d) {
    auto low = x, high = x;
    low[d] -= h;
    high[d] += h;
    const auto a = flow.at(low[0], low[1], low[2]), b = flow.at(high[0], high[1], high[2]);
    for (std::size_t c = 0; c < 3; ++c) gradient[c][d] = (b[c] - a[c]) / (2 * h);
  }
  const auto u = flow.at(x[0], x[1], x[2]);
  EXPECT_NEAR(gradient[0][0] + gradient[1][1] + gradient[2][2], 0, 1e-7);
  for (std::size_t c = 0; c < 3; ++c) {
    const std::size_t a = (c + 1) % 3, b = (c + 2) % 3;
    EXPECT_NEAR(gradient[b][a] - gradient[a][b], k * u[c], 1e-7);
  }
}

}  // namespace
}  // namespace gpuphys
