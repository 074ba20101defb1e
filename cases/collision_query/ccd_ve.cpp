// Input sets and checks of ccd_ve (specification: cases/collision_query/ccd_ve.md).
#include "cases/collision_query/ccd_ve.hpp"

#include <fmt/format.h>

#include <cmath>

#include "cases/collision_query/toi_checks.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::ccd_ve {
namespace {

using cloth_sheets::Mesh;
using cloth_sheets::Motion;
using cloth_sheets::Parameters;
using cloth_sheets::Point;

constexpr double kDistance = 0.1;  // of the sheets
constexpr double kJitter = 0.06;

double above(double x) {
  return static_cast<double>(std::nextafter(static_cast<float>(x), 1e30f));
}

Problem problem_of(const Mesh& mesh, double d) {
  return toi::problem_from(describe<Inputs, Outputs<float>>(), mesh, d);
}

InputSet sheets_set(const std::string& name, SetKind kind, Size size, const Parameters& p) {
  InputSet set;
  set.name = name;
  set.kind = kind;
  set.size = size;
  set.about = fmt::format("4 cloth sheets of {}^2 vertices {:.2f} apart, driven into each other, seed {}",
                          p.n, p.offset, p.seed);
  set.make = [=] { return problem_of(cloth_sheets::sheet_mesh(p, 2, kDistance), kDistance); };
  return set;
}

// ---- hard cases ----

Check tight(double tolerance) {
  return as_invariant(toi::local(tolerance, ""), "toi_tight", tolerance,
                      "what the serial float32 builds show on this set, ten times");
}

/// An edge and a vertex with nothing else near, d = 1.
struct KnownPair {
  Point a0, b0, p0, a1, b1, p1;
  double time;
};

std::vector<KnownPair> known_pairs() {
  const Point o{0, 0, 0}, e{4, 0, 0};
  const auto falls = [&](double x, double time) {
    return KnownPair{o, e, {x, 0, 3}, o, e, {x, 0, -1}, time};
  };
  const auto at_rest = [&](const Point& p, double time) { return KnownPair{o, e, p, o, e, p, time}; };
  return {
      falls(2, 0.5),
      falls(4, 0.5),  // beside the end: closed
      falls(4 + 0x1p-20, 1),
      falls(0, 0.5),
      falls(-0x1p-20, 1),
      {e, o, {4, 0, 3}, e, o, {4, 0, -1}, 0.5},  // the edge reversed
      {o, e, {2, 0, 1}, o, e, {2, 0, 5}, 0},     // recedes from exactly d: closed
      {o, e, {2, 0, above(1)}, o, e, {2, 0, 5}, 1},
      {o, e, {2, 0, -1}, o, e, {2, 0, -5}, 0},
      {o, e, {4, 1, 0}, o, e, {8, 1, 0}, 0},  // at the start beside the end
      {o, e, {4 + 0x1p-20, 1, 0}, o, e, {8, 1, 0}, 1},
      {o, e, {2, 0.25, 0.25}, o, e, {2, 5, 0}, 0},            // starts inside
      {o, e, {2, 3, 0}, o, e, {2, 1, 0}, 1},                  // arrives at the end of the step
      {o, e, {8, 0, 0}, o, e, {-8, 0, 0}, 1},                 // along the edge's line, through it
      {o, e, {8, 0.5, 0}, o, e, {2, 0.5, 0}, 1},              // enters through the end of the capsule
      {o, e, {-2, 2, 0}, o, e, {6, 2, 0}, 1},                 // parallel to it, two d away
      {o, e, {2, 2, 0}, {0, 0, 8}, {4, 0, 8}, {2, 2, 8}, 1},  // moves with it
      at_rest({2, 0, 2}, 1),
      at_rest({2, 0, 0.5}, 0),
      at_rest({-1, 0, 0}, 1),                                    // near the line, beyond the end
      {o, o, {0, 0, 3}, o, o, {0, 0, -1}, 1},                    // an edge of no length
      {o, {2, 0, 0}, {0, 0, 10}, o, {-2, 0, 0}, {0, 0, 10}, 1},  // turns inside out ten lengths away
      {o, o, {1, 0, 3}, o, e, {1, 0, -1}, 0.5},                  // grows out of a point
      {{0, 0, -3}, {4, 0, -3}, {2, 0, 0}, {0, 0, 1}, {4, 0, 1}, {2, 0, 0}, 0.5},  // the edge moves
      {{-4, 0, 0}, {0, 0, 0}, {0, 2, 0}, o, e, {0, 0, 0}, 0.5},
      {o, e, {2, 0, 7}, o, e, {2, 0, -9}, 0.375},  // in and out again: the first time
      {{-0.0, -0.0, 0}, e, {2, -0.0, 3}, {0, -0.0, -0.0}, e, {2, 0, -1}, 0.5},
      // An edge that has grown to 2^-18 of its length at contact, and one to 2^-22: below 2^-20 it has none.
      {o, o, {0x1p-18, 0, 2}, o, e, {0x1p-18, 0, 2 - 0x1p18}, 0x1p-18},
      {o, o, {0x1p-22, 0, 2}, o, e, {0x1p-22, 0, 2 - 0x1p22}, 1},
      // The last one: it reaches beside where others would stand.
      {o, {0, 4096, 0}, {0, 1024, 2}, o, {0, 4096, 0}, {0, 1024, -2}, 0.25},
  };
}

Problem exact_pairs() {
  Mesh mesh;
  mesh.corners = 2;
  std::int32_t count = 0;
  for (const KnownPair& k : known_pairs()) {
    const auto moved = [&](const Point& p) { return Point{p[0], p[1], p[2]}; };
    const double x = 64.0 * count++;
    const auto add = [&](Point start, Point end) {
      start = moved(start);
      end = moved(end);
      // Apart along y, so that x keeps its last bits.
      start[1] += x;
      end[1] += x;
      return toi::add_vertex(mesh, start, end);
    };
    const std::int32_t a = add(k.a0, k.a1), b = add(k.b0, k.b1);
    add(k.p0, k.p1);
    mesh.primitives.insert(mesh.primitives.end(), {a, b});
  }
  return problem_of(mesh, 1);
}

double exact_time(std::int64_t vertex) {
  return vertex % 3 == 2 ? known_pairs()[static_cast<std::size_t>(vertex / 3)].time : 1;
}

// Edges between all pairs of 60 vertices that turn over.
Problem crowded() {
  Mesh mesh;
  mesh.corners = 2;
  constexpr std::int32_t vertices = 60;
  for (std::int32_t a = 0; a < vertices; ++a) {
    for (std::int32_t b = 0; b < a; ++b) {
      mesh.primitives.push_back((a + b) % 2 ? a : b);
      mesh.primitives.push_back((a + b) % 2 ? b : a);
    }
  }
  toi::tumble(mesh, vertices, 0.01, 1, 51);
  return problem_of(mesh, 0.01);
}

// Edges that change length, turn, or stand with one end, and loose vertices, within reach of a large d.
Problem loose_edges(std::int64_t edges, double d, std::uint64_t seed) {
  Mesh mesh;
  mesh.corners = 2;
  for (std::int32_t e = 0; e < edges; ++e) mesh.primitives.insert(mesh.primitives.end(), {2 * e, 2 * e + 1});
  const std::int64_t vertices = 3 * edges;
  cloth_sheets::settle(mesh, vertices, d, [=](std::int64_t v, int attempt) {
    Motion m;
    const double half = v < 2 * edges && v / 2 % 50 == 0 ? 60 : 1.5;  // a few span the scene
    for (std::size_t c = 0; c < 3; ++c) {
      const auto draw = [&](std::uint64_t stream, std::int64_t item) {
        return uniform11(seed, stream + 100 * static_cast<std::uint64_t>(attempt),
                         3 * static_cast<std::uint64_t>(item) + c);
      };
      const double centre =
          20 * uniform11(seed, 0, 3 * static_cast<std::uint64_t>(v < 2 * edges ? v / 2 : v) + c);
      m.start[c] = centre + half * draw(1, v);
      m.end[c] = v % 4 == 0 ? m.start[c] : centre + 2 * half * draw(2, v);
    }
    return m;
  });
  return problem_of(mesh, d);
}

// A chain of edges along y, and vertices that fall on it here and there.
Problem row() {
  Mesh mesh;
  mesh.corners = 2;
  constexpr std::int32_t edges = 65537, falling = 5000;
  for (std::int32_t e = 0; e < edges; ++e) mesh.primitives.insert(mesh.primitives.end(), {e, e + 1});
  cloth_sheets::settle(mesh, edges + 1 + falling, kDistance, [](std::int64_t v, int attempt) {
    const auto draw = [&](std::uint64_t d) {
      return uniform11(61, static_cast<std::uint64_t>(attempt), 3 * static_cast<std::uint64_t>(v) + d);
    };
    Motion m;
    if (v <= edges) {
      m.start = {0.05 * draw(0), static_cast<double>(v) + 0.05 * draw(1), 0.05 * draw(2)};
      m.end = m.start;
    } else {
      m.start = {0.3 * draw(0), 0.5 * edges * (1 + draw(1)), 1 + 0.5 * draw(2)};
      m.end = {m.start[0], m.start[1] + 0.2, m.start[2] - 1.5};
    }
    return m;
  });
  return problem_of(mesh, kDistance);
}

Problem static_sheets() {
  const Mesh moving = cloth_sheets::sheet_mesh(toi::public_sheets(14, kJitter), 2, kDistance);
  Mesh mesh = moving;
  cloth_sheets::settle(mesh, static_cast<std::int64_t>(moving.x0.size()), kDistance,
                       [&](std::int64_t v, int attempt) {
                         Motion m;
                         for (std::size_t c = 0; c < 3; ++c) {
                           m.start[c] = static_cast<double>(moving.x1[static_cast<std::size_t>(v)][c]);
                           if (attempt > 0)
                             m.start[c] += 0.01 * uniform11(42, static_cast<std::uint64_t>(attempt),
                                                            3 * static_cast<std::uint64_t>(v) + c);
                         }
                         m.end = m.start;
                         return m;
                       });
  return problem_of(mesh, kDistance);
}

Problem scaled_sheets(double factor) {
  const Mesh mesh = cloth_sheets::sheet_mesh(toi::hidden_sheets(13, kJitter), 2, kDistance);
  return problem_of(toi::scaled(mesh, factor), static_cast<double>(static_cast<float>(kDistance)) * factor);
}

Problem one_edge() {
  Mesh mesh;
  mesh.corners = 2;
  toi::add_vertex(mesh, {0, 0, 0}, {1, 1, 1});
  toi::add_vertex(mesh, {0.05, 0, 0}, {1, -1, 1});
  mesh.primitives = {0, 1};
  return problem_of(mesh, 0.5);
}

std::vector<InputSet> hard_cases() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet set) { sets.push_back(std::move(set)); };
  add(toi::hard(
      "exact_pairs",
      "an edge and a vertex each, whose answers are exact in float32: closed and open comparisons, "
      "ends, edges that vanish",
      exact_pairs,
      {toi::known_times("known_times", 0x1p-22, "closed forms with numbers exact in float32", exact_time)},
      true));
  add(toi::hard("one_edge", "an edge and its own two ends, nearer than d", one_edge,
                {toi::no_events("a vertex of the edge is no partner of it")}, false));
  add(toi::hard("crowded", "1770 edges between 60 vertices that turn over: every box meets every other",
                crowded, {tight(1e-5)}, true));
  add(toi::hard(
      "loose_edges", "edges that stretch, turn or stand with an end, some that span the scene, d = 1",
      [] { return loose_edges(331, 1, 52); }, {tight(1e-5)}, true));
  add(toi::hard(
      "few_edges", "31 edges and loose vertices, d = 0.01", [] { return loose_edges(31, 0.01, 53); },
      {tight(1e-5)}, true));
  add(toi::hard("row", "65,537 edges in a row along y and vertices that fall on it", row, {tight(1e-5)},
                true));
  add(toi::hard("static", "sheets that interpenetrate and do not move", static_sheets, {tight(1e-5)}, true));
  add(toi::hard(
      "large_scale", "sheets 65,536 times as large: coordinates up to 1e6 m",
      [] { return scaled_sheets(0x1p16); }, {tight(1e-5)}, true));
  add(toi::hard(
      "small_scale", "sheets 2^20 times smaller: edges of a micrometre",
      [] { return scaled_sheets(0x1p-20); }, {tight(1e-5)}, true));
  add(toi::hard(
      "far_from_the_origin", "sheets at 1e4 m, where positions resolve 1 mm and differences are exact",
      [] {
        return problem_of(toi::far_sheets(toi::public_sheets(13, kJitter), 2, kDistance, 1e4, 0.02),
                          kDistance);
      },
      {tight(1e-5)}, true));
  return sets;
}

}  // namespace

Task make_task() {
  Task task;
  task.title = "Continuous vertex-edge collision detection in moving cloth";
  task.paper_number = 41;
  task.contract = describe<Inputs, Outputs<float>>();
  task.sets.push_back(sheets_set("public", SetKind::open, Size::paper, toi::public_sheets(256, kJitter)));
  task.sets.push_back(sheets_set("hidden", SetKind::hidden, Size::paper, toi::hidden_sheets(256, kJitter)));
  task.sets.push_back(
      sheets_set("public_smoke", SetKind::open, Size::smoke, toi::public_sheets(53, kJitter)));
  task.sets.push_back(
      sheets_set("hidden_smoke", SetKind::hidden, Size::smoke, toi::hidden_sheets(47, kJitter)));
  for (InputSet& set : hard_cases()) task.sets.push_back(std::move(set));
  task.checks = {toi::minus_1_rel_l2(1e-3),
                 toi::local(1e-4,
                            "inputs keep no event whose time float32 rounding, taken at sixteen units, could "
                            "move by more than 5e-4"),
                 toi::mismatched_events()};
  task.unordered = {{"n", {"edges"}}, {"m", {}}};
  task.target_floor_multiple = 38;
  return task;
}

}  // namespace gpuphys::ccd_ve
