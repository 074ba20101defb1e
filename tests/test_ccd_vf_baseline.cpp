// The serial baseline of ccd_vf, validated on its own: closed forms, all pairs sampled in time, symmetries.
#include "tests/toi_baseline.hpp"

namespace gpuphys {
namespace {

using namespace testing;

// The time of a vertex that moves from p0 to p1 through the plane of the triangle (0,0,0), (4,0,0), (0,4,0).
double through(const Point& p0, const Point& p1, const std::vector<std::int32_t>& order = {0, 1, 2}) {
  return toi_of(
      "ccd_vf",
      mesh_of(3, {{{{0, 0, 0}, {0, 0, 0}}}, {{{4, 0, 0}, {4, 0, 0}}}, {{{0, 4, 0}, {0, 4, 0}}}, {{p0, p1}}},
              order))[3];
}

TEST(CcdVfBaseline, AVertexFallsThroughATriangle) {
  // Height 3, speed 4.
  EXPECT_NEAR(through({1, 1, 3}, {1, 1, -1}), 0.75, 1e-9);
}

TEST(CcdVfBaseline, SidesAndCornersBelongToTheTriangle) {
  EXPECT_NEAR(through({2, 2, 1}, {2, 2, -1}), 0.5, 1e-9);
  EXPECT_NEAR(through({0, 0, 1}, {0, 0, -1}), 0.5, 1e-9);
  EXPECT_EQ(through({2.001, 2, 1}, {2.001, 2, -1}), 1);
}

TEST(CcdVfBaseline, AStartInThePlaneDependsOnTheOrderOfTheCorners) {
  EXPECT_NEAR(through({1, 1, 0}, {1, 1, -1}, {0, 1, 2}), 0, 1e-9);
  EXPECT_EQ(through({1, 1, 0}, {1, 1, -1}, {0, 2, 1}), 1);
}

TEST(CcdVfBaseline, MotionInThePlaneIsNone) {
  EXPECT_EQ(through({-1, 1, 0}, {3, 1, 0}), 1);
}

TEST(CcdVfBaseline, CornersAreNoPartnersOfTheirTriangle) {
  EXPECT_EQ(toi_of("ccd_vf",
                   mesh_of(3, {{{{0, 0, 0}, {0, 0, 1}}}, {{{1, 0, 0}, {0, 0, 0}}}, {{{0, 1, 0}, {2, 0, -1}}}},
                           {0, 1, 2})),
            (std::vector<double>{1, 1, 1}));
}

Mesh tumbling(std::int32_t triangles) {
  Mesh mesh;
  mesh.corners = 3;
  for (std::int32_t t = 0; t < triangles; ++t)
    mesh.primitives.insert(mesh.primitives.end(), {3 * t, 3 * t + 1, 3 * t + 2});
  toi::tumble(mesh, 4 * triangles, 0, 1, 73);
  return mesh;
}

double determinant(const Point& a, const Point& b, const Point& c) {
  return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
         a[2] * (b[0] * c[1] - b[1] * c[0]);
}

TEST(CcdVfBaseline, TumblingTrianglesAgreeWithSamplingOfAllPairs) {
  const Mesh mesh = tumbling(20);
  expect_times(toi_of("ccd_vf", mesh), 1e-6, [&](std::size_t v) {
    double first = 1;
    for (std::size_t f = 0; f < mesh.primitives.size() / 3; ++f) {
      std::array<std::size_t, 3> c;
      for (std::size_t k = 0; k < 3; ++k) c[k] = static_cast<std::size_t>(mesh.primitives[3 * f + k]);
      if (v == c[0] || v == c[1] || v == c[2]) continue;
      const auto corner = [&](std::size_t k, double t) { return minus(at(mesh, c[k], t), at(mesh, v, t)); };
      // The volume of the tetrahedron with the vertex changes its sign; inside, the areas with the sides add
      // up.
      const auto volume = [&](double t) { return determinant(corner(0, t), corner(1, t), corner(2, t)); };
      const auto area = [](const Point& p, const Point& q) {
        return std::sqrt(std::max(0.0, dot(p, p) * dot(q, q) - dot(p, q) * dot(p, q)));
      };
      constexpr int samples = 4000;
      double earlier = volume(0);
      for (int k = 1; k <= samples; ++k) {
        const double now = volume(k / static_cast<double>(samples));
        if ((earlier < 0) != (now < 0)) {
          double low = (k - 1.0) / samples, high = k / static_cast<double>(samples);
          for (int step = 0; step < 40; ++step)
            ((volume(0.5 * (low + high)) < 0) == (now < 0) ? high : low) = 0.5 * (low + high);
          const Point p = corner(0, high), q = corner(1, high), r = corner(2, high);
          const double whole = area(minus(q, p), minus(r, p));
          if (area(p, q) + area(q, r) + area(r, p) <= whole * (1 + 1e-5)) {
            first = std::min(first, high);
            break;
          }
        }
        earlier = now;
      }
    }
    return first;
  });
}

TEST(CcdVfBaseline, PermutingTheCornersChangesNothing) {
  Mesh mesh = tumbling(30);
  const std::vector<double> t = toi_of("ccd_vf", mesh);
  for (std::size_t f = 0; f < mesh.primitives.size(); f += 3) {
    std::swap(mesh.primitives[f], mesh.primitives[f + 1 + f / 3 % 2]);
  }
  const std::vector<double> again = toi_of("ccd_vf", mesh);
  for (std::size_t v = 0; v < t.size(); ++v) EXPECT_NEAR(t[v], again[v], 1e-8) << v;
}

TEST(CcdVfBaseline, ScalingChangesNothing) {
  const Mesh mesh = tumbling(30);
  EXPECT_EQ(toi_of("ccd_vf", mesh), toi_of("ccd_vf", toi::scaled(mesh, 0x1p-24)));
}

TEST(CcdVfBaseline, TheSheetsHaveTheSizeOfThePaper) {
  EXPECT_EQ(4 * 2 * 383 * 383, 1173512);
  EXPECT_EQ(cloth_sheets::sheet_mesh(toi::public_sheets(9, 0.06), 3, 0).primitives.size(),
            3u * 4 * 2 * 8 * 8);
}

}  // namespace
}  // namespace gpuphys
