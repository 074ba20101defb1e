// Input sets and checks of ccd_vf (specification: cases/collision_query/ccd_vf.md).
#include "cases/collision_query/ccd_vf.hpp"

#include <fmt/format.h>

#include <cmath>

#include "cases/collision_query/toi_checks.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::ccd_vf {
namespace {

using cloth_sheets::Mesh;
using cloth_sheets::Motion;
using cloth_sheets::Parameters;
using cloth_sheets::Point;

Problem problem_of(const Mesh& mesh) {
  return toi::problem_from(describe<Inputs, Outputs<float>>(), mesh);
}

InputSet sheets_set(const std::string& name, SetKind kind, Size size, const Parameters& p) {
  InputSet set;
  set.name = name;
  set.kind = kind;
  set.size = size;
  set.about = fmt::format("4 cloth sheets of {}^2 vertices {:.2f} apart, driven into each other, seed {}",
                          p.n, p.offset, p.seed);
  set.make = [=] { return problem_of(cloth_sheets::sheet_mesh(p, 3, 0)); };
  return set;
}

// ---- hard cases ----

Check tight(double tolerance) {
  return as_invariant(toi::local(tolerance, ""), "toi_tight", tolerance,
                      "what the serial float32 builds show on this set, ten times");
}

Mesh triangles() {
  Mesh mesh;
  mesh.corners = 3;
  return mesh;
}

/// A triangle and vertices with nothing else near.
struct KnownTriangle {
  std::array<Point, 3> start, end;
  struct Vertex {
    Point start, end;
    double time;
  };
  std::vector<Vertex> vertices;
};

std::vector<KnownTriangle> known_triangles() {
  using Triangle = std::array<Point, 3>;
  const Triangle rest{{{0, 0, 0}, {4, 0, 0}, {0, 4, 0}}}, odd{{{0, 0, 0}, {0, 4, 0}, {4, 0, 0}}};
  const Triangle line{{{0, 0, 0}, {1, 0, 0}, {3, 0, 0}}}, point{{{1, 1, 1}, {1, 1, 1}, {1, 1, 1}}};
  const Triangle thin{{{0, 0, 0}, {4, 0, 0}, {4, 0x1p-17, 0}}},
      thinner{{{0, 0, 0}, {4, 0, 0}, {4, 0x1p-19, 0}}};
  const Triangle raised{{{0, 0, 4}, {4, 0, 4}, {0, 4, 4}}}, lowered{{{0, 0, -4}, {4, 0, -4}, {0, 4, -4}}};
  const auto falls = [](double x, double y, double time) {
    return KnownTriangle::Vertex{{x, y, 1}, {x, y, -1}, time};
  };
  return {
      {rest,
       rest,
       {falls(1, 1, 0.5), falls(0, 0, 0.5), falls(4, 0, 0.5), falls(0, 4, 0.5), falls(2, 0, 0.5)}},
      {rest,
       rest,
       {falls(2, 2, 0.5), falls(0, 2, 0.5), falls(-0.5, 1, 1), falls(1, -0.5, 1), falls(2.5, 2, 1)}},
      {odd, odd, {falls(1, 1, 0.5), falls(2, 2, 0.5), {{1, 1, -3}, {1, 1, 1}, 0.75}}},
      // Contact at the start: f(0) = 0 counts as positive. For (a, b, c) as stored f has the sign of z.
      {rest, rest, {{{1, 1, 0}, {1, 1, -1}, 0}, {{1, 1, 0}, {1, 1, 1}, 1}, {{0, 0, 0}, {0, 0, -4}, 0}}},
      {odd, odd, {{{1, 1, 0}, {1, 1, -1}, 1}, {{1, 1, 0}, {1, 1, 1}, 0}, {{0, 0, 0}, {0, 0, 4}, 0}}},
      // In the plane all the time; at rest; never there; arriving at the end of the step.
      {rest, rest, {{{-2, 1, 0}, {3, 1, 0}, 1}, {{1, 1, 1}, {1, 1, 1}, 1}, {{1, 1, 4}, {1, 1, 1}, 1}}},
      {rest, rest, {{{1, 1, 4}, {1, 1, 0}, 1}, {{1, 1, -4}, {1, 1, -0.0}, 1}}},
      // Triangles without an area.
      {line, line, {falls(0.5, 0, 1), falls(1, 0, 1)}},
      {point, point, {falls(1, 1, 1)}},
      // Angles of 2^-19, a thin triangle, and of 2^-21, none any more.
      {thin, thin, {falls(3, 0x1p-18, 0.5), falls(3, 0x1p-16, 1)}},
      {thinner, thinner, {falls(3, 0x1p-20, 1)}},
      // The triangle passes the vertex.
      {raised,
       lowered,
       {{{1, 1, 0}, {1, 1, 0}, 0.5}, {{1, 1, 2}, {1, 1, 2}, 0.25}, {{5, 1, 0}, {5, 1, 0}, 1}}},
  };
}

Problem exact_triangles() {
  Mesh mesh = triangles();
  double apart = 0;
  for (const KnownTriangle& k : known_triangles()) {
    const auto add = [&](Point start, Point end) {
      start[2] += apart;
      end[2] += apart;
      return toi::add_vertex(mesh, start, end);
    };
    for (std::size_t c = 0; c < 3; ++c) mesh.primitives.push_back(add(k.start[c], k.end[c]));
    for (const auto& v : k.vertices) add(v.start, v.end);
    apart += 64;
  }
  return problem_of(mesh);
}

double exact_time(std::int64_t vertex) {
  for (const KnownTriangle& k : known_triangles()) {
    const auto size = static_cast<std::int64_t>(3 + k.vertices.size());
    if (vertex < size) return vertex < 3 ? 1 : k.vertices[static_cast<std::size_t>(vertex - 3)].time;
    vertex -= size;
  }
  return 1;
}

// A right triangle with legs of 2^19 m and vertices that pass it at s, r or s + r beyond the border by half
// of the margin and by twice the margin. Every number is exact in float32.
constexpr std::array<std::array<double, 3>, 12> kAtTheMargin{{{-0.25, 1024, 0.5},
                                                              {-1, 1024, 1},
                                                              {1024, -0.25, 0.5},
                                                              {1024, -1, 1},
                                                              {0x1p18 + 0.25, 0x1p18, 0.5},
                                                              {0x1p18 + 1, 0x1p18, 1},
                                                              {0x1p18, 0x1p18 + 0.25, 0.5},
                                                              {0x1p18, 0x1p18 + 1, 1},
                                                              {-0.5, 0x1p17, 0.5},
                                                              {0x1p17, -0.5, 0.5},
                                                              {0x1p18 + 0.5, 0x1p18, 0.5},
                                                              {-0.25, -0.25, 0.5}}};
Problem margins() {
  Mesh mesh = triangles();
  const double leg = 0x1p19;
  toi::add_vertex(mesh, {0, 0, 0}, {0, 0, 0});
  toi::add_vertex(mesh, {leg, 0, 0}, {leg, 0, 0});
  toi::add_vertex(mesh, {0, leg, 0}, {0, leg, 0});
  mesh.primitives = {0, 1, 2};
  for (const auto& [x, y, time] : kAtTheMargin) toi::add_vertex(mesh, {x, y, 1}, {x, y, -1});
  return problem_of(mesh);
}

// Triangles among a few vertices that turn over: up to three crossings.
Problem crowded(std::int32_t vertices, std::int32_t count, std::uint64_t seed) {
  Mesh mesh = triangles();
  for (std::int32_t t = 0; t < count; ++t) {
    const auto item = static_cast<std::uint64_t>(t);
    const auto pick = [&](std::uint64_t stream, std::int32_t among) {
      return static_cast<std::int32_t>(random_bits(seed, stream, item) % static_cast<std::uint64_t>(among));
    };
    const std::int32_t a = pick(1, vertices), b = (a + 1 + pick(2, vertices - 1)) % vertices;
    std::int32_t c = (a + 1 + pick(3, vertices - 2)) % vertices;
    if (c == b) c = (a + vertices - 1) % vertices;
    mesh.primitives.insert(mesh.primitives.end(), {a, b, c});
  }
  toi::tumble(mesh, vertices, 0, 1, seed);
  return problem_of(mesh);
}

// Loose triangles: small ones, needles, some that span the scene, some of which one side stands still; and
// loose vertices.
Problem loose_triangles(std::int64_t count, std::uint64_t seed) {
  Mesh mesh = triangles();
  for (std::int32_t t = 0; t < count; ++t)
    mesh.primitives.insert(mesh.primitives.end(), {3 * t, 3 * t + 1, 3 * t + 2});
  cloth_sheets::settle(mesh, 5 * count, 0, [=](std::int64_t v, int attempt) {
    Motion m;
    const bool loose = v >= 3 * count;
    const std::int64_t triangle = v / 3;
    for (std::size_t c = 0; c < 3; ++c) {
      const auto draw = [&](std::uint64_t stream, std::int64_t item) {
        return uniform11(seed, stream + 100 * static_cast<std::uint64_t>(attempt),
                         3 * static_cast<std::uint64_t>(item) + c);
      };
      double size = !loose && triangle % 60 == 0 ? 40 : 1.5;
      if (!loose && triangle % 7 == 1 && c > 0) size = 0.02;  // needles along x
      const double centre = 8 * uniform11(seed, 0, 3 * static_cast<std::uint64_t>(loose ? v : triangle) + c);
      m.start[c] = centre + size * draw(1, v);
      m.end[c] = m.start[c] + (triangle % 4 == 0 && v % 3 != 0 ? 0 : 1) * draw(2, v);
      if (loose) m.end[c] = m.start[c] + 2 * draw(2, v);
    }
    return m;
  });
  return problem_of(mesh);
}

// A strip of triangles along x at rest, and vertices that fall on it.
Problem row() {
  Mesh mesh = triangles();
  constexpr std::int32_t squares = 32770, falling = 5000;
  for (std::int32_t s = 0; s < squares; ++s)
    mesh.primitives.insert(mesh.primitives.end(),
                           {2 * s, 2 * s + 1, 2 * s + 2, 2 * s + 1, 2 * s + 3, 2 * s + 2});
  cloth_sheets::settle(mesh, 2 * squares + 2 + falling, 0, [](std::int64_t v, int attempt) {
    const auto draw = [&](std::uint64_t d) {
      return uniform11(62, static_cast<std::uint64_t>(attempt), 3 * static_cast<std::uint64_t>(v) + d);
    };
    Motion m;
    if (v < 2 * squares + 2) {
      m.start = {static_cast<double>(v / 2) + 0.1 * draw(0), static_cast<double>(v % 2) + 0.1 * draw(1),
                 0.2 * draw(2)};
      m.end = m.start;
    } else {
      m.start = {0.5 * squares * (1 + draw(0)), 0.5 + 0.8 * draw(1), 1 + 0.5 * draw(2)};
      m.end = {m.start[0] + 0.2, m.start[1], m.start[2] - 2};
    }
    return m;
  });
  return problem_of(mesh);
}

Problem static_sheets() {
  Mesh mesh = cloth_sheets::sheet_mesh(toi::public_sheets(14, 0.06), 3, 0);
  mesh.x0 = mesh.x1;  // in the middle of each other
  return problem_of(mesh);
}

Problem scaled_sheets(double factor) {
  return problem_of(toi::scaled(cloth_sheets::sheet_mesh(toi::hidden_sheets(13, 0.05), 3, 0), factor));
}

Problem one_triangle() {
  Mesh mesh = triangles();
  toi::add_vertex(mesh, {0, 0, 0}, {0, 0, 1});
  toi::add_vertex(mesh, {1, 0, 0}, {1, 0, -1});
  toi::add_vertex(mesh, {0, 1, 0}, {-1, 1, 3});
  mesh.primitives = {2, 0, 1};
  return problem_of(mesh);
}

std::vector<InputSet> hard_cases() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet set) { sets.push_back(std::move(set)); };
  add(toi::hard(
      "exact_triangles",
      "triangles and vertices whose answers are exact in float32: corners, sides, the plane at the "
      "start, triangles without an area",
      exact_triangles,
      {toi::known_times("known_times", 0x1p-22, "closed forms with numbers exact in float32", exact_time)},
      true));
  add(toi::hard(
      "margins", "vertices that pass a triangle at half and at twice the margin beyond its sides", margins,
      {toi::known_times(
          "known_times", 0x1p-22, "fractions and times are exact in float32",
          [](std::int64_t v) { return v < 3 ? 1.0 : kAtTheMargin[static_cast<std::size_t>(v - 3)][2]; })},
      true));
  add(toi::hard("one_triangle", "a triangle and its own corners", one_triangle,
                {toi::no_events("a corner of the triangle is no partner of it")}, false));
  add(toi::hard("static", "sheets in the middle of each other, at rest", static_sheets,
                {toi::no_events("nothing moves, so no sign changes")}, false));
  add(toi::hard(
      "crowded", "1400 triangles among 45 vertices that turn over: up to three crossings",
      [] { return crowded(45, 1400, 54); }, {tight(1e-5)}, true));
  add(toi::hard(
      "few_triangles", "31 triangles among 33 vertices that turn over", [] { return crowded(33, 31, 55); },
      {tight(1e-5)}, true));
  add(toi::hard(
      "loose_triangles", "needles, triangles that span the scene, sides that stand still",
      [] { return loose_triangles(301, 56); }, {tight(1e-5)}, true));
  add(toi::hard("row", "65,540 triangles in a strip along x and vertices that fall on it", row, {tight(1e-5)},
                true));
  add(toi::hard(
      "large_scale", "sheets 65,536 times as large: coordinates up to 1e6 m",
      [] { return scaled_sheets(0x1p16); }, {tight(1e-5)}, true));
  add(toi::hard(
      "small_scale", "sheets 2^20 times smaller: sides of a micrometre",
      [] { return scaled_sheets(0x1p-20); }, {tight(1e-5)}, true));
  add(toi::hard(
      "far_from_the_origin", "sheets at 1e4 m, where positions resolve 1 mm and differences are exact",
      [] { return problem_of(toi::far_sheets(toi::public_sheets(13, 0.06), 3, 0, 1e4, 0.02)); },
      {tight(1e-5)}, true));
  return sets;
}

}  // namespace

Task make_task() {
  Task task;
  task.title = "Continuous vertex-face collision detection in moving cloth";
  task.paper_number = 42;
  task.contract = describe<Inputs, Outputs<float>>();
  task.sets.push_back(sheets_set("public", SetKind::open, Size::paper, toi::public_sheets(384, 0.06)));
  task.sets.push_back(sheets_set("hidden", SetKind::hidden, Size::paper, toi::hidden_sheets(384, 0.05)));
  task.sets.push_back(sheets_set("public_smoke", SetKind::open, Size::smoke, toi::public_sheets(53, 0.06)));
  task.sets.push_back(sheets_set("hidden_smoke", SetKind::hidden, Size::smoke, toi::hidden_sheets(47, 0.05)));
  for (InputSet& set : hard_cases()) task.sets.push_back(std::move(set));
  task.checks = {toi::minus_1_rel_l2(1e-4),
                 toi::local(1e-4,
                            "inputs keep no event whose time float32 rounding, taken at sixteen units of the "
                            "largest term of the cubic, could move by more than 5e-4"),
                 toi::mismatched_events()};
  task.unordered = {{"n", {"tris"}}, {"m", {}}};
  task.target_floor_multiple = 35;
  return task;
}

}  // namespace gpuphys::ccd_vf
