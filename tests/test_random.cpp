// The counter-based generator: reference values, range, uniformity and independence of streams.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "core/generators/random.hpp"

namespace gpuphys {
namespace {

TEST(Random, MixIsSplitMix64) {
  // The first outputs of SplitMix64 from state 1234567, as published with the generator.
  constexpr std::uint64_t golden = 0x9E3779B97F4A7C15ull;
  EXPECT_EQ(mix64(1234567 + golden), 6457827717110365317ull);
  EXPECT_EQ(mix64(1234567 + 2 * golden), 3203168211198807973ull);
}

TEST(Random, UniformNumbersStayInTheirRange) {
  for (std::uint64_t i = 0; i < 100000; ++i) {
    const double u = uniform01(1, 0, i);
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    ASSERT_EQ(uniform11(1, 0, i), 2 * u - 1);
  }
}

TEST(Random, TheTenthsAreEquallyFilled) {
  constexpr int n = 1000000;
  std::array<int, 10> count{};
  for (std::uint64_t i = 0; i < n; ++i) ++count[static_cast<std::size_t>(10 * uniform01(7, 3, i))];
  // Five standard deviations of a binomial count.
  for (const int c : count) EXPECT_NEAR(c, n / 10, 5 * std::sqrt(n * 0.1 * 0.9));
}

TEST(Random, SeedsStreamsAndItemsAreUncorrelated) {
  constexpr int n = 200000;
  double seeds = 0, streams = 0, items = 0;
  for (std::uint64_t i = 0; i < n; ++i) {
    seeds += uniform11(1, 0, i) * uniform11(2, 0, i);
    streams += uniform11(1, 0, i) * uniform11(1, 1, i);
    items += uniform11(1, 0, i) * uniform11(1, 0, i + 1);
  }
  // The product of two independent U(-1,1) has variance 1/9.
  const double bound = 5 * std::sqrt(n / 9.0);
  EXPECT_LT(std::abs(seeds), bound);
  EXPECT_LT(std::abs(streams), bound);
  EXPECT_LT(std::abs(items), bound);
}

}  // namespace
}  // namespace gpuphys
