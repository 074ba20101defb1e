// The Fourier velocity field: what is sampled, its size and its divergence.
#include <gtest/gtest.h>

#include <cmath>

#include "core/generators/fourier_velocity.hpp"

namespace gpuphys {
namespace {

HostArray component(int c, std::int64_t n) {
  Shape shape{n, n + 3, n + 5};
  ++shape[static_cast<std::size_t>(c)];
  return HostArray("u", DType::f32, shape);
}

TEST(FourierVelocity, SamplesTheFieldAtTheFaceCentres) {
  const FourierVelocity field = FourierVelocity::random(3, 16, 3, 1.0, 2.0);
  for (int c = 0; c < 3; ++c) {
    HostArray u = component(c, 9);
    field.fill(c, 0.125, u);
    const Shape s = u.shape();
    for (std::int64_t i = 0; i < u.size(); ++i) {
      const double x[3] = {(static_cast<double>(i / (s[1] * s[2])) + (c == 0 ? 0 : 0.5)) * 0.125,
                           (static_cast<double>(i / s[2] % s[1]) + (c == 1 ? 0 : 0.5)) * 0.125,
                           (static_cast<double>(i % s[2]) + (c == 2 ? 0 : 0.5)) * 0.125};
      ASSERT_NEAR(u.value(i), field.at(c, x[0], x[1], x[2]), 1e-6) << c << " " << i;
    }
  }
}

TEST(FourierVelocity, EveryModeIsDivergenceFree) {
  for (const FourierVelocity::Mode& m : FourierVelocity::random(1, 20, 3, 1.0, 1.0).modes) {
    const double along = m.k[0] * m.amplitude[0] + m.k[1] * m.amplitude[1] + m.k[2] * m.amplitude[2];
    EXPECT_NEAR(along, 0, 1e-14);
    EXPECT_NE(m.k[0] * m.k[0] + m.k[1] * m.k[1] + m.k[2] * m.k[2], 0);
    for (const int k : m.k) EXPECT_LE(std::abs(k), 3);
  }
}

TEST(FourierVelocity, RmsDoesNotDependOnTheNumberOfModes) {
  for (const int modes : {16, 20}) {
    const FourierVelocity field = FourierVelocity::random(1, modes, 3, 1.5, 1.0);
    double sum = 0;
    const int n = 16;  // resolves products of waves up to 2 k_max = 6: the average over a period is exact
    for (int c = 0; c < 3; ++c) {
      for (int i = 0; i < n * n * n; ++i) {
        const double u = field.at(c, (i / n / n) / 16.0, (i / n % n) / 16.0, (i % n) / 16.0);
        sum += u * u;
      }
    }
    // Modes that share a wave vector interfere: the average over draws is exact, one draw is not.
    EXPECT_NEAR(std::sqrt(sum / (3.0 * n * n * n)), 1.5, 0.3) << modes;
  }
}

TEST(FourierVelocity, SeedsGiveDifferentFields) {
  EXPECT_NE(FourierVelocity::random(1, 16, 3, 1, 1).at(0, 0.1, 0.2, 0.3),
            FourierVelocity::random(2, 16, 3, 1, 1).at(0, 0.1, 0.2, 0.3));
}

}  // namespace
}  // namespace gpuphys
