// The cut-cell cylinder: unknown counts of the paper, hand-computed openings, symmetry, and geometry
// identities.
#include "core/generators/cut_cell_cylinder.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/base/error.hpp"

namespace gpuphys {
namespace {

TEST(CutCellCylinder, HasThePapersNumberOfUnknownsOnThePublicSet) {
  EXPECT_EQ(CutCellCylinder(256, 256, 256, 0.18 * 256).active_cells(), 15118336);
}

TEST(CutCellCylinder, HasThePapersNumberOfUnknownsOnTheHiddenSet) {
  EXPECT_EQ(CutCellCylinder(256, 256, 256, 0.21 * 256).active_cells(), 14505984);
}

TEST(OpenEdgeFraction, IsTheLinearCrossing) {
  EXPECT_EQ(open_edge_fraction(1, 2), 1);
  EXPECT_EQ(open_edge_fraction(-1, -2), 0);
  EXPECT_EQ(open_edge_fraction(1, -3), 0.25);
  EXPECT_EQ(open_edge_fraction(-3, 1), 0.25);
  EXPECT_EQ(open_edge_fraction(-1, 3), 0.75);
}

TEST(OpenEdgeFraction, CountsAZeroAsFluid) {
  EXPECT_EQ(open_edge_fraction(0, 0), 1);
  EXPECT_EQ(open_edge_fraction(0, 1), 1);
  EXPECT_EQ(open_edge_fraction(0, -1), 0);  // the open part is a single point
}

TEST(OpenSquareArea, OfHandComputedShapes) {
  EXPECT_EQ(open_square_area(1, 1, 1, 1), 1);
  EXPECT_EQ(open_square_area(-1, -1, -1, -1), 0);
  EXPECT_DOUBLE_EQ(open_square_area(1, -1, -1, -1), 0.125);   // a triangle with legs 1/2
  EXPECT_DOUBLE_EQ(open_square_area(-1, 1, 1, 1), 0.875);     // its complement
  EXPECT_DOUBLE_EQ(open_square_area(1, 1, -3, -3), 0.25);     // a strip of height 1/4
  EXPECT_DOUBLE_EQ(open_square_area(-1, 3, 3, -1), 0.75);     // a strip of width 3/4
  EXPECT_DOUBLE_EQ(open_square_area(-3, -1, -1, 1), 0.0625);  // legs 1/4 and 1/2
}

// For a straight interface the polygon is exact, whatever its position: compared with counting sample points.
TEST(OpenSquareArea, IsExactForHalfPlanes) {
  constexpr int kSamples = 400;
  for (int q = 0; q < 24; ++q) {
    const double angle = 2 * std::numbers::pi * q / 24 + 0.1;
    const double offset = -0.9 + 0.075 * q;
    const auto distance = [&](double x, double y) {
      return std::cos(angle) * (x - 0.5) + std::sin(angle) * (y - 0.5) - offset;
    };
    int inside = 0;
    for (int a = 0; a < kSamples; ++a) {
      for (int b = 0; b < kSamples; ++b)
        inside += distance((a + 0.5) / kSamples, (b + 0.5) / kSamples) >= 0 ? 1 : 0;
    }
    // Counting errs by at most half a sample per sample row the interface crosses.
    EXPECT_NEAR(open_square_area(distance(0, 0), distance(1, 0), distance(1, 1), distance(0, 1)),
                static_cast<double>(inside) / (kSamples * kSamples), 1.0 / kSamples)
        << "angle " << angle << " offset " << offset;
  }
}

// A cylinder of radius 1/2 around the middle node of a 2 x 2 box: every cell keeps three corners.
TEST(CutCellCylinder, OfRadiusOneHalfInTwoByTwoCells) {
  const CutCellCylinder c(2, 2, 2, 0.5);
  EXPECT_EQ(c.active_cells(), 8);
  EXPECT_DOUBLE_EQ(c.level_set(1, 1), -0.5);
  EXPECT_DOUBLE_EQ(c.level_set(0, 1), 0.5);
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      EXPECT_DOUBLE_EQ(c.area(i, j), 0.875);  // a triangle with legs 1/2 is solid
      EXPECT_EQ(c.face_z(i, j, 0), 0);
      EXPECT_DOUBLE_EQ(c.face_z(i, j, 1), 0.875);
      EXPECT_EQ(c.face_z(i, j, 2), 0);
    }
    EXPECT_EQ(c.face_x(0, i), 0);
    EXPECT_DOUBLE_EQ(c.face_x(1, i), 0.5);
    EXPECT_EQ(c.face_x(2, i), 0);
    EXPECT_EQ(c.face_y(i, 0), 0);
    EXPECT_DOUBLE_EQ(c.face_y(i, 1), 0.5);
    EXPECT_EQ(c.face_y(i, 2), 0);
  }
}

// One cell, its centre on the axis: the corners are sqrt(1/2) away.
TEST(CutCellCylinder, LosesACellOnlyWhenAllItsCornersAreSolid) {
  EXPECT_EQ(CutCellCylinder(1, 1, 3, 0.70).active_cells(), 3);
  EXPECT_EQ(CutCellCylinder(1, 1, 3, 0.71).active_cells(), 0);
}

// 3-4-5: a node lies exactly on the cylinder of radius 5, and zero does not make a cell active.
TEST(CutCellCylinder, NodesExactlyOnTheSurfaceDoNotActivateACell) {
  const CutCellCylinder c(12, 12, 1, 5);
  EXPECT_EQ(c.level_set(6 + 3, 6 + 4), 0);
  EXPECT_FALSE(c.active(6 + 2, 6 + 3));  // its far corner is the node (3, 4)
  EXPECT_TRUE(c.active(6 + 3, 6 + 3));   // its far corner is (4, 4)
  EXPECT_EQ(c.face_x(6 + 3, 6 + 3), 0);  // from (3, 3), inside, to (3, 4), on it
}

TEST(CutCellCylinder, OfRadiusZeroIsAnOpenBox) {
  const CutCellCylinder c(3, 4, 5, 0);
  EXPECT_EQ(c.active_cells(), 60);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 4; ++j) {
      EXPECT_EQ(c.area(i, j), 1);
      EXPECT_EQ(c.face_x(i, j), i == 0 ? 0 : 1);
      EXPECT_EQ(c.face_y(i, j), j == 0 ? 0 : 1);
    }
  }
}

TEST(CutCellCylinder, FractionsAreBetweenZeroAndOneAndOpenOnlyBetweenActiveCells) {
  for (const double fraction : {0.05, 0.18, 0.21, 0.45}) {
    for (const int n : {17, 32, 33}) {
      const CutCellCylinder c(n, n, 2, fraction * n);
      for (int i = 0; i <= n; ++i) {
        for (int j = 0; j < n; ++j) {
          const double x = c.face_x(i, j), y = c.face_y(j, i);
          EXPECT_TRUE(x >= 0 && x <= 1 && y >= 0 && y <= 1);
          if (x > 0) {
            EXPECT_TRUE(c.active(i - 1, j) && c.active(i, j)) << n << ' ' << fraction << ' ' << i << ' ' << j;
          }
          if (y > 0) {
            EXPECT_TRUE(c.active(j, i - 1) && c.active(j, i)) << n << ' ' << fraction << ' ' << i << ' ' << j;
          }
        }
      }
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          const double a = c.area(i, j);
          EXPECT_TRUE(a >= 0 && a <= 1);
          EXPECT_EQ(a > 0, c.active(i, j)) << n << ' ' << fraction << ' ' << i << ' ' << j;
        }
      }
    }
  }
}

// Rotations and reflections of the square generate each other from x -> n-x and the exchange of x and y.
TEST(CutCellCylinder, HasTheSymmetriesOfTheSquare) {
  for (const int n : {16, 17}) {
    const CutCellCylinder c(n, n, 3, 0.21 * n);
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        const int m = n - 1 - i;
        EXPECT_EQ(c.active(i, j), c.active(m, j));
        EXPECT_EQ(c.active(i, j), c.active(j, i));
        EXPECT_NEAR(c.area(i, j), c.area(m, j), 1e-14);  // the shoelace sum runs in another order
        EXPECT_NEAR(c.area(i, j), c.area(j, i), 1e-14);
        EXPECT_EQ(c.face_x(i, j), c.face_x(n - i, j));
        EXPECT_EQ(c.face_y(i, j), c.face_y(m, j));
        EXPECT_EQ(c.face_x(i, j), c.face_y(j, i));
      }
    }
  }
}

// Each open part is a closed polygon, so its area is also the integral of x over its boundary's y (Green).
// With one interface segment that area needs the two side faces and the segment alone, an independent route
// to face_z.
TEST(CutCellCylinder, AreaFollowsFromTheSideFacesByGreensTheorem) {
  const int n = 40;
  const CutCellCylinder c(n, n, 1, 0.21 * n);
  int cut = 0;
  for (int i = 1; i + 1 < n; ++i) {
    for (int j = 1; j + 1 < n; ++j) {
      const double left = c.face_x(i, j), right = c.face_x(i + 1, j), low = c.face_y(i, j),
                   high = c.face_y(i, j + 1);
      if (!c.active(i, j) || left + right + low + high == 4) continue;
      ++cut;
      // area = integral of x dy = 1 * right + 0 * left + (mean x of the segment) * (left - right).
      // The segment joins two crossings; the mean of their x follows from which edges are crossed.
      double sum_x = 0;
      int crossings = 0;
      const auto crossing = [&](double a, double b, double x0, double x1) {
        if ((a >= 0) == (b >= 0)) return;
        sum_x += x0 + (x1 - x0) * std::abs(a) / (std::abs(a) + std::abs(b));
        ++crossings;
      };
      const double p00 = c.level_set(i, j), p10 = c.level_set(i + 1, j), p01 = c.level_set(i, j + 1),
                   p11 = c.level_set(i + 1, j + 1);
      crossing(p00, p01, 0, 0);
      crossing(p10, p11, 1, 1);
      crossing(p00, p10, 0, 1);
      crossing(p01, p11, 0, 1);
      ASSERT_EQ(crossings, 2);
      EXPECT_NEAR(c.area(i, j), right + 0.5 * sum_x * (left - right), 1e-14);
    }
  }
  EXPECT_GT(cut, 40);
}

// Solid area -> pi R^2. The polygon inscribed by linear crossings errs by O(1/n^2); single radii scatter, so
// the error is the rms over several.
TEST(CutCellCylinder, SolidAreaConvergesAtSecondOrder) {
  const auto error = [](int n) {
    double square = 0;
    for (int q = 0; q < 16; ++q) {
      const double fraction = 0.18 + 0.03 * q / 16;
      const CutCellCylinder c(n, n, 1, fraction * n);
      double solid = 0;
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) solid += 1 - c.area(i, j);
      }
      const double e = solid / (static_cast<double>(n) * n) - std::numbers::pi * fraction * fraction;
      square += e * e;
    }
    return std::sqrt(square / 16);
  };
  const double order = std::log(error(32) / error(256)) / std::log(256.0 / 32.0);
  EXPECT_NEAR(order, 2, 0.2);
}

TEST(CutCellCylinder, RejectsWhatIsNoBoxOrNoCylinder) {
  EXPECT_THROW(CutCellCylinder(0, 4, 4, 1), Error);
  EXPECT_THROW(CutCellCylinder(4, 4, 4, -1), Error);
  EXPECT_THROW(CutCellCylinder(4, 4, 4, std::nan("")), Error);
}

}  // namespace
}  // namespace gpuphys
