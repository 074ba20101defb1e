// The serial baseline of ccd_ee, validated on its own: closed forms, all pairs tested one by one with another
// criterion, and symmetries.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cases/collision_query/ccd_ee.hpp"
#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using cloth_sheets::EdgeMesh;
using testing::run_module;
using Point = std::array<double, 3>;

const Task& task() {
  return find_task("ccd_ee");
}

Problem problem_from(const EdgeMesh& mesh) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(mesh.x0.size())},
                                             {"m", static_cast<std::int64_t>(mesh.edges.size())}});
  for (std::size_t v = 0; v < mesh.x0.size(); ++v) {
    for (std::size_t d = 0; d < 3; ++d) {
      p.inputs[0].as<float>()[3 * v + d] = mesh.x0[v][d];
      p.inputs[1].as<float>()[3 * v + d] = mesh.x1[v][d];
    }
  }
  for (std::size_t e = 0; e < mesh.edges.size(); ++e) {
    p.inputs[2].as<std::int32_t>()[2 * e] = mesh.edges[e][0];
    p.inputs[2].as<std::int32_t>()[2 * e + 1] = mesh.edges[e][1];
  }
  return p;
}

std::vector<double> times(const Problem& p, const std::string& label = "baseline_f64") {
  const Arrays out = run_module(task(), label, p);
  std::vector<double> t;
  for (std::int64_t e = 0; e < out[0].size(); ++e) t.push_back(out[0].value(e));
  return t;
}
std::vector<double> times(const EdgeMesh& mesh) {
  return times(problem_from(mesh));
}

using Vertex = std::array<float, 3>;

// The edges (0,1) and (2,3), from their ends at both times.
EdgeMesh two_edges(const std::array<Vertex, 4>& start, const std::array<Vertex, 4>& end) {
  EdgeMesh mesh;
  mesh.x0.assign(start.begin(), start.end());
  mesh.x1.assign(end.begin(), end.end());
  mesh.edges = {{0, 1}, {2, 3}};
  return mesh;
}

TEST(CcdEeBaseline, ARodFallsOnARod) {
  // Height 3, speed 4.
  EdgeMesh mesh = two_edges({{{0, 0, 0}, {2, 0, 0}, {1, -1, 3}, {1, 1, 3}}},
                            {{{0, 0, 0}, {2, 0, 0}, {1, -1, -1}, {1, 1, -1}}});
  std::vector<double> t = times(mesh);
  EXPECT_NEAR(t[0], 0.75, 1e-9);
  EXPECT_EQ(t[0], t[1]);
  // Beside the first one: no impact.
  for (std::size_t v : {2, 3}) mesh.x0[v][0] = mesh.x1[v][0] = 2.25f;
  t = times(mesh);
  EXPECT_EQ(t, (std::vector<double>{1, 1}));
  // Through its end: the end belongs to it.
  for (std::size_t v : {2, 3}) mesh.x0[v][0] = mesh.x1[v][0] = 2.0f;
  t = times(mesh);
  EXPECT_NEAR(t[0], 0.75, 1e-9);
}

TEST(CcdEeBaseline, ContactAtTheStartCountsAsPositive) {
  // The volume starts at zero. Towards negative values it changes its sign at once, towards positive ones
  // never: the motion decides.
  const std::array<Vertex, 4> start{{{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}}};
  std::array<Vertex, 4> up = start, down = start;
  for (std::size_t v : {2, 3}) {
    up[v][2] = 1;
    down[v][2] = -1;
  }
  // w . (u x v) with u = (2,0,0), v = (0,2,0) has the sign of w_z.
  EXPECT_EQ(times(two_edges(start, up))[0], 1);
  EXPECT_NEAR(times(two_edges(start, down))[0], 0, 1e-9);
}

TEST(CcdEeBaseline, ScaleDoesNotMatterInFloat32) {
  // Squares of the cubic's coefficients would leave float32 at 2^18 m, and vanish at 2^-30 m.
  for (const float scale : {0x1p-30f, 1.0f, 0x1p18f}) {
    EdgeMesh mesh = two_edges({{{0, 0, 0}, {2, 0, 0}, {1, -1, 3}, {1, 1, 3}}},
                              {{{0, 0, 0}, {2, 0, 0}, {1, -1, -1}, {1, 1, -1}}});
    for (auto* x : {&mesh.x0, &mesh.x1}) {
      for (Vertex& v : *x) {
        for (float& c : v) c *= scale;
      }
    }
    EXPECT_NEAR(times(problem_from(mesh), "baseline_f32")[0], 0.75, 1e-7) << scale;
  }
}

TEST(CcdEeBaseline, TheEarliestPartnerCounts) {
  // One rod at rest; two others pass it, at t = 0.5 and at t = 0.25.
  EdgeMesh mesh;
  mesh.x0 = {{0, 0, 0}, {2, 0, 0}, {1, -1, 1}, {1, 1, 1}, {0.5f, -1, 0.5f}, {0.5f, 1, 0.5f}};
  mesh.x1 = {{0, 0, 0}, {2, 0, 0}, {1, -1, -1}, {1, 1, -1}, {0.5f, -1, -1.5f}, {0.5f, 1, -1.5f}};
  mesh.edges = {{0, 1}, {2, 3}, {4, 5}};
  const std::vector<double> t = times(mesh);
  EXPECT_NEAR(t[0], 0.25, 1e-9);
  EXPECT_NEAR(t[1], 0.5, 1e-9);
  EXPECT_NEAR(t[2], 0.25, 1e-9);
}

TEST(CcdEeBaseline, ASharedVertexIsNoImpact) {
  for (const std::array<std::int32_t, 2> second :
       {std::array{0, 2}, std::array{2, 0}, std::array{1, 2}, std::array{2, 1}}) {
    EdgeMesh mesh;
    mesh.x0 = {{0, 0, 0}, {1, 0, 0}, {0.25f, 1, 0.5f}};
    mesh.x1 = {{0.5f, 0, 0.25f}, {1, 1, 0}, {0.25f, -1, -0.5f}};
    mesh.edges = {{0, 1}, second};
    EXPECT_EQ(times(mesh), (std::vector<double>{1, 1}));
  }
}

// ---- all pairs, by sampling in time with another criterion ----

Point at(const EdgeMesh& mesh, std::int32_t v, double t) {
  Point p;
  for (std::size_t d = 0; d < 3; ++d) {
    const double a = mesh.x0[static_cast<std::size_t>(v)][d], b = mesh.x1[static_cast<std::size_t>(v)][d];
    p[d] = a + t * (b - a);
  }
  return p;
}
Point operator-(const Point& p, const Point& q) {
  return {p[0] - q[0], p[1] - q[1], p[2] - q[2]};
}
double dot(const Point& p, const Point& q) {
  return p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
}

double determinant(const Point& a, const Point& b, const Point& c) {
  return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
         a[2] * (b[0] * c[1] - b[1] * c[0]);
}

// The closest points of two lines, by the normal equations: parameters along both.
std::array<double, 2> closest(const Point& u, const Point& v, const Point& w) {
  const double uu = dot(u, u), uv = dot(u, v), vv = dot(v, v), uw = dot(u, w), vw = dot(v, w);
  const double det = uu * vv - uv * uv;
  return {(vv * uw - uv * vw) / det, (uv * uw - uu * vw) / det};
}

double sampled_impact(const EdgeMesh& mesh, std::size_t i, std::size_t j, int samples) {
  const auto [a, b] = mesh.edges[i];
  const auto [c, d] = mesh.edges[j];
  if (a == c || a == d || b == c || b == d) return 1;
  const auto volume = [&](double t) {
    const Point o = at(mesh, a, t);
    return determinant(at(mesh, c, t) - o, at(mesh, b, t) - o, at(mesh, d, t) - at(mesh, c, t));
  };
  double earlier = volume(0);
  for (int k = 1; k <= samples; ++k) {
    const double t = static_cast<double>(k) / samples, now = volume(t);
    if ((earlier < 0) != (now < 0)) {
      // The chord is as good as the cubic over one sample.
      const double hit = t - (1.0 / samples) * now / (now - earlier);
      const Point o = at(mesh, a, hit);
      const auto [s, r] =
          closest(at(mesh, b, hit) - o, at(mesh, d, hit) - at(mesh, c, hit), at(mesh, c, hit) - o);
      if (s >= 0 && s <= 1 && r >= 0 && r <= 1) return hit;
    }
    earlier = now;
  }
  return 1;
}

void expect_all_pairs(const EdgeMesh& mesh, int samples) {
  const std::vector<double> t = times(mesh);
  std::vector<double> expected(t.size(), 1.0);
  for (std::size_t i = 0; i < t.size(); ++i) {
    for (std::size_t j = i + 1; j < t.size(); ++j) {
      const double hit = sampled_impact(mesh, i, j, samples);
      expected[i] = std::min(expected[i], hit);
      expected[j] = std::min(expected[j], hit);
    }
  }
  int events = 0;
  for (std::size_t e = 0; e < t.size(); ++e) {
    events += expected[e] < 1;
    EXPECT_NEAR(t[e], expected[e], 1e-4) << "edge " << e;
  }
  EXPECT_GT(events, 10);
}

EdgeMesh tumbling(std::int32_t count, std::uint64_t seed) {
  EdgeMesh mesh;
  for (std::int32_t e = 0; e < count; ++e) mesh.edges.push_back({2 * e, 2 * e + 1});
  cloth_sheets::settle(mesh, 2 * count, [&](std::int64_t v, int attempt) {
    cloth_sheets::Motion m;
    for (std::size_t d = 0; d < 3; ++d) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(v) + d,
                          k = 10 * static_cast<std::uint64_t>(attempt);
      m.start[d] = uniform11(seed, k, i);
      m.end[d] = uniform11(seed, k + 1, i);
    }
    return m;
  });
  return mesh;
}

TEST(CcdEeBaseline, TumblingEdgesAgreeWithSamplingOfAllPairs) {
  expect_all_pairs(tumbling(40, 3), 2000);
}

TEST(CcdEeBaseline, SheetsAgreeWithSamplingOfAllPairs) {
  cloth_sheets::Parameters parameters;
  parameters.n = 6;
  parameters.seed = 5;
  parameters.drive_period = 12;
  expect_all_pairs(cloth_sheets::edge_mesh(parameters), 300);
}

TEST(CcdEeBaseline, ReversingEdgesChangesNothing) {
  const EdgeMesh mesh = tumbling(60, 4);
  const std::vector<double> t = times(mesh);
  EdgeMesh reversed = mesh;
  for (std::size_t e = 0; e < reversed.edges.size(); e += 2)
    std::swap(reversed.edges[e][0], reversed.edges[e][1]);
  const std::vector<double> again = times(reversed);
  for (std::size_t e = 0; e < t.size(); ++e) EXPECT_NEAR(t[e], again[e], 1e-8) << e;
}

TEST(CcdEeBaseline, RenumberingEdgesRenumbersTheTimes) {
  const EdgeMesh mesh = tumbling(60, 6);
  const std::vector<double> t = times(mesh);
  EdgeMesh turned = mesh;
  std::reverse(turned.edges.begin(), turned.edges.end());
  std::vector<double> again = times(turned);
  std::reverse(again.begin(), again.end());
  for (std::size_t e = 0; e < t.size(); ++e) EXPECT_NEAR(t[e], again[e], 1e-8) << e;
}

TEST(CcdEeBaseline, TheEarliestImpactBelongsToTwoEdges) {
  const std::vector<double> t = times(tumbling(60, 7));
  const double earliest = *std::min_element(t.begin(), t.end());
  EXPECT_LT(earliest, 1);
  EXPECT_EQ(std::count(t.begin(), t.end(), earliest), 2);
}

TEST(ClothSheets, HaveTheSizeOfThePaper) {
  cloth_sheets::Parameters parameters;
  parameters.n = 9;
  const EdgeMesh mesh = cloth_sheets::edge_mesh(parameters);
  EXPECT_EQ(mesh.x0.size(), 4u * 9 * 9);
  EXPECT_EQ(mesh.edges.size(), 4u * (2 * 9 * 8 + 8 * 8));
  // The same formula at 320: 409,600 vertices and 1,223,684 edges.
  EXPECT_EQ(4 * (2 * 320 * 319 + 319 * 319), 1223684);
  std::vector<int> degree(mesh.x0.size(), 0);
  for (const auto& edge : mesh.edges) {
    for (const std::int32_t v : edge) ++degree[static_cast<std::size_t>(v)];
  }
  EXPECT_EQ(*std::max_element(degree.begin(), degree.end()), 6);
  EXPECT_EQ(*std::min_element(degree.begin(), degree.end()), 2);
}

}  // namespace
}  // namespace gpuphys
