// The serial baseline of ccd_vv, validated on its own: closed forms, all pairs sampled in time, symmetries.
#include "tests/toi_baseline.hpp"

namespace gpuphys {
namespace {

using namespace testing;

std::vector<double> pair_times(const Point& p, const Point& q, double d) {
  return toi_of(
      "ccd_vv",
      mesh_of(1, {{{{1, 2, 3}, {1, 2, 3}}},
                  {{{1 + p[0], 2 + p[1], 3 + p[2]}, {1 + p[0] + q[0], 2 + p[1] + q[1], 3 + p[2] + q[2]}}}}),
      d);
}

TEST(CcdVvBaseline, AHeadOnPairMeetsWhenTheGapIsGone) {
  // Gap 5 - 1, speed 8.
  EXPECT_EQ(pair_times({5, 0, 0}, {-8, 0, 0}, 1), (std::vector<double>{0.5, 0.5}));
}

TEST(CcdVvBaseline, TouchingInPassingCounts) {
  EXPECT_EQ(pair_times({-4, 3, 0}, {8, 0, 0}, 3)[0], 0.5);
  EXPECT_EQ(pair_times({-4, 3, 0}, {8, 0, 0}, 2.9999998)[0], 1);
}

TEST(CcdVvBaseline, ContactAtTheStartCountsWhateverTheMotion) {
  EXPECT_EQ(pair_times({0, 3, 0}, {0, 5, 0}, 3)[0], 0);
  EXPECT_EQ(pair_times({0, 0, 0}, {0, 0, 0}, 3)[0], 0);
}

TEST(CcdVvBaseline, WhatRecedesOrRestsHasNoContact) {
  EXPECT_EQ(pair_times({0, 4, 0}, {0, 1, 0}, 3)[0], 1);
  EXPECT_EQ(pair_times({0, 4, 0}, {0, 0, 0}, 3)[0], 1);
}

TEST(CcdVvBaseline, AnObliquePairSolvesTheQuadratic) {
  // |(-4 + 6 t, 1, 0)|^2 = 4: t = (4 - sqrt(3))/6.
  EXPECT_NEAR(pair_times({-4, 1, 0}, {6, 0, 0}, 2)[0], (4 - std::sqrt(3.0)) / 6, 1e-14);
}

TEST(CcdVvBaseline, AVertexAloneHasNoContact) {
  EXPECT_EQ(toi_of("ccd_vv", mesh_of(1, {{{{0, 0, 0}, {1, 1, 1}}}}), 1), (std::vector<double>{1}));
}

Mesh tumbling(std::int64_t n, double d) {
  Mesh mesh;
  toi::tumble(mesh, n, d, 1, 71);
  return mesh;
}

TEST(CcdVvBaseline, TumblingVerticesAgreeWithSamplingOfAllPairs) {
  constexpr double d = 0.1;
  const Mesh mesh = tumbling(120, d);
  const double wide_d = static_cast<double>(static_cast<float>(d));
  expect_times(toi_of("ccd_vv", mesh, d), 1e-9, [&](std::size_t v) {
    double first = 1;
    for (std::size_t other = 0; other < mesh.x0.size(); ++other) {
      if (other == v) continue;
      first = std::min(first, first_time(2000, [&](double t) {
                         return length(minus(at(mesh, v, t), at(mesh, other, t))) <= wide_d;
                       }));
    }
    return first;
  });
}

TEST(CcdVvBaseline, ScalingChangesNothing) {
  const Mesh mesh = tumbling(100, 0.25);
  EXPECT_EQ(toi_of("ccd_vv", mesh, 0.25), toi_of("ccd_vv", toi::scaled(mesh, 0x1p-30), 0.25 * 0x1p-30));
}

TEST(CcdVvBaseline, TheEarliestContactBelongsToTwo) {
  const std::vector<double> t = toi_of("ccd_vv", tumbling(100, 0.02), 0.02);
  const double earliest = *std::min_element(t.begin(), t.end());
  EXPECT_LT(earliest, 1);
  EXPECT_EQ(std::count(t.begin(), t.end(), earliest), 2);
}

TEST(CcdVvBaseline, TheSheetsHaveTheSizeOfThePaper) {
  EXPECT_EQ(4 * 1400 * 1400, 7840000);
  EXPECT_EQ(cloth_sheets::sheet_mesh(toi::public_sheets(9, 0.15), 1, 0.3).x0.size(), 4u * 9 * 9);
}

}  // namespace
}  // namespace gpuphys
