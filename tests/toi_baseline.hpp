// What the tests of the serial baselines of ccd_vv, ccd_ve and ccd_vf share: running one on a mesh, and
// positions in between.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "cases/collision_query/toi_checks.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

using Point = cloth_sheets::Point;
using cloth_sheets::Mesh;

inline std::vector<double> toi_of(const std::string& task, const Mesh& mesh, double d = 0) {
  const Task& t = find_task(task);
  const Arrays out = run_module(t, "baseline_f64", toi::problem_from(t.contract, mesh, d));
  std::vector<double> times;
  for (std::int64_t i = 0; i < out[0].size(); ++i) times.push_back(out[0].value(i));
  return times;
}

inline Mesh mesh_of(int corners, const std::vector<std::array<Point, 2>>& vertices,
                    const std::vector<std::int32_t>& primitives = {}) {
  Mesh mesh;
  mesh.corners = corners;
  for (const auto& [start, end] : vertices) toi::add_vertex(mesh, start, end);
  mesh.primitives = primitives;
  return mesh;
}

inline Point at(const Mesh& mesh, std::size_t v, double t) {
  Point p;
  for (std::size_t d = 0; d < 3; ++d) {
    const double a = static_cast<double>(mesh.x0[v][d]), b = static_cast<double>(mesh.x1[v][d]);
    p[d] = a + t * (b - a);
  }
  return p;
}
inline Point minus(const Point& p, const Point& q) {
  return {p[0] - q[0], p[1] - q[1], p[2] - q[2]};
}
inline double dot(const Point& p, const Point& q) {
  return p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
}
inline double length(const Point& p) {
  return std::sqrt(dot(p, p));
}

/// Compares times with those of `sampled(vertex)`; some must be events.
template <class Sampled>
void expect_times(const std::vector<double>& times, double tolerance, Sampled&& sampled) {
  int events = 0;
  for (std::size_t v = 0; v < times.size(); ++v) {
    const double expected = sampled(v);
    events += expected < 1;
    EXPECT_NEAR(times[v], expected, tolerance) << "vertex " << v;
  }
  EXPECT_GT(events, 5);
}

/// The first sample at which `inside` holds, refined by bisection; 1 if there is none. `inside(t)` may begin
/// and end several times.
template <class Inside>
double first_time(int samples, Inside&& inside) {
  if (inside(0.0)) return 0;
  for (int k = 1; k <= samples; ++k) {
    double high = static_cast<double>(k) / samples, low = static_cast<double>(k - 1) / samples;
    if (!inside(high)) continue;
    for (int step = 0; step < 40; ++step) {
      const double middle = 0.5 * (low + high);
      (inside(middle) ? high : low) = middle;
    }
    return high;
  }
  return 1;
}

}  // namespace gpuphys::testing
