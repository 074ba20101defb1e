// The serial baseline of ccd_ve, validated on its own: closed forms, all pairs sampled in time, symmetries.
#include "tests/toi_baseline.hpp"

namespace gpuphys {
namespace {

using namespace testing;

// The time of a vertex that moves from p0 to p1 above the edge (0,0,0)-(4,0,0) at rest.
double above_the_edge(const Point& p0, const Point& p1, double d) {
  return toi_of("ccd_ve",
                mesh_of(2, {{{{0, 0, 0}, {0, 0, 0}}}, {{{4, 0, 0}, {4, 0, 0}}}, {{p0, p1}}}, {0, 1}), d)[2];
}

TEST(CcdVeBaseline, AVertexFallsOnAnEdge) {
  // Gap 3 - 1, speed 4.
  EXPECT_NEAR(above_the_edge({1, 0, 3}, {1, 0, -1}, 1), 0.5, 1e-9);
}

TEST(CcdVeBaseline, TheEndsBelongToTheEdge) {
  EXPECT_NEAR(above_the_edge({4, 0, 3}, {4, 0, -1}, 1), 0.5, 1e-9);
  EXPECT_EQ(above_the_edge({4.001, 0, 3}, {4.001, 0, -1}, 1), 1);
}

TEST(CcdVeBaseline, EnteringPastTheEndIsNone) {
  EXPECT_EQ(above_the_edge({9, 0, 0.5}, {1, 0, 0.5}, 1), 1);
}

TEST(CcdVeBaseline, ContactAtTheStartIsAtZero) {
  EXPECT_EQ(above_the_edge({1, 0, 1}, {1, 0, 9}, 1), 0);
}

TEST(CcdVeBaseline, ACrossingPastTheEndIsNone) {
  // z = 3 - 6 t reaches 1 at t = 1/3, where x is -1/3 or 1/6.
  EXPECT_EQ(above_the_edge({-1, 0, 3}, {1, 0, -3}, 1), 1);
  EXPECT_NEAR(above_the_edge({-0.25, 0, 3}, {1, 0, -3}, 1), 1 / 3.0, 1e-9);
}

TEST(CcdVeBaseline, AnEdgeThatVanishesFarAwayIsNone) {
  const Mesh mesh =
      mesh_of(2, {{{{0, 0, 0}, {0, 0, 0}}}, {{{2, 0, 0}, {-2, 0, 0}}}, {{{0, 0, 10}, {0, 1, 10}}}}, {0, 1});
  EXPECT_EQ(toi_of("ccd_ve", mesh, 1), (std::vector<double>{1, 1, 1}));
}

TEST(CcdVeBaseline, TheEndsOfAnEdgeAreNoPartnersOfIt) {
  EXPECT_EQ(toi_of("ccd_ve", mesh_of(2, {{{{0, 0, 0}, {1, 0, 0}}}, {{{0.1, 0, 0}, {1, 0, 0}}}}, {0, 1}), 1),
            (std::vector<double>{1, 1}));
}

Mesh tumbling(std::int32_t edges, double d) {
  Mesh mesh;
  mesh.corners = 2;
  for (std::int32_t e = 0; e < edges; ++e) mesh.primitives.insert(mesh.primitives.end(), {2 * e, 2 * e + 1});
  toi::tumble(mesh, 3 * edges, d, 1, 72);
  return mesh;
}

TEST(CcdVeBaseline, TumblingEdgesAgreeWithSamplingOfAllPairs) {
  constexpr double d = 0.05;
  const Mesh mesh = tumbling(25, d);
  const double dd = static_cast<double>(static_cast<float>(d));
  expect_times(toi_of("ccd_ve", mesh, d), 1e-8, [&](std::size_t v) {
    double first = 1;
    for (std::size_t e = 0; e < mesh.primitives.size() / 2; ++e) {
      const auto a = static_cast<std::size_t>(mesh.primitives[2 * e]);
      const auto b = static_cast<std::size_t>(mesh.primitives[2 * e + 1]);
      if (v == a || v == b) continue;
      // By the foot of the perpendicular. Only entries beside the edge count.
      const auto foot = [&](double t) {
        const Point u = minus(at(mesh, b, t), at(mesh, a, t)), w = minus(at(mesh, v, t), at(mesh, a, t));
        return dot(w, u) / dot(u, u);
      };
      const auto distance = [&](double t) {
        const Point u = minus(at(mesh, b, t), at(mesh, a, t)), w = minus(at(mesh, v, t), at(mesh, a, t));
        const double s = dot(w, u) / dot(u, u);
        return length({w[0] - s * u[0], w[1] - s * u[1], w[2] - s * u[2]});
      };
      double t = 1;
      constexpr int samples = 4000;
      for (int k = 0; k <= samples; ++k) {
        double low = (k - 1.0) / samples, high = k / static_cast<double>(samples);
        if (distance(high) > dd || (k > 0 && distance(low) <= dd)) continue;
        for (int step = 0; k > 0 && step < 40; ++step)
          (distance(0.5 * (low + high)) <= dd ? high : low) = 0.5 * (low + high);
        if (foot(high) < 0 || foot(high) > 1) continue;
        t = high;
        break;
      }
      first = std::min(first, t);
    }
    return first;
  });
}

TEST(CcdVeBaseline, ReversingEdgesChangesNothing) {
  Mesh mesh = tumbling(40, 0.05);
  const std::vector<double> t = toi_of("ccd_ve", mesh, 0.05);
  for (std::size_t e = 0; e < mesh.primitives.size(); e += 2)
    std::swap(mesh.primitives[e], mesh.primitives[e + 1]);
  const std::vector<double> again = toi_of("ccd_ve", mesh, 0.05);
  for (std::size_t v = 0; v < t.size(); ++v) EXPECT_NEAR(t[v], again[v], 1e-8) << v;
}

TEST(CcdVeBaseline, ScalingChangesNothing) {
  const Mesh mesh = tumbling(40, 0.0625);
  EXPECT_EQ(toi_of("ccd_ve", mesh, 0.0625), toi_of("ccd_ve", toi::scaled(mesh, 0x1p18), 0.0625 * 0x1p18));
}

TEST(CcdVeBaseline, TheSheetsHaveTheSizeOfThePaper) {
  EXPECT_EQ(4 * (2 * 256 * 255 + 255 * 255), 782340);
  EXPECT_EQ(cloth_sheets::sheet_mesh(toi::public_sheets(9, 0.06), 2, 0.1).primitives.size(),
            2u * 4 * (2 * 9 * 8 + 8 * 8));
}

}  // namespace
}  // namespace gpuphys
