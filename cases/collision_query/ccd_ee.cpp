// Input sets and checks of ccd_ee (specification: cases/collision_query/ccd_ee.md).
#include "cases/collision_query/ccd_ee.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>

#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "cases/collision_query/toi_checks.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::ccd_ee {
namespace {

using cloth_sheets::EdgeMesh;
using cloth_sheets::Motion;
using cloth_sheets::Parameters;
using cloth_sheets::Point;

Problem problem_from(const EdgeMesh& mesh) {
  Problem p =
      make_problem(describe<Inputs, Outputs<float>>(), {{"n", static_cast<std::int64_t>(mesh.x0.size())},
                                                        {"m", static_cast<std::int64_t>(mesh.edges.size())}});
  const std::span<float> x0 = p.inputs[0].as<float>(), x1 = p.inputs[1].as<float>();
  const std::span<std::int32_t> edges = p.inputs[2].as<std::int32_t>();
  for (std::size_t v = 0; v < mesh.x0.size(); ++v) {
    for (std::size_t d = 0; d < 3; ++d) {
      x0[3 * v + d] = mesh.x0[v][d];
      x1[3 * v + d] = mesh.x1[v][d];
    }
  }
  for (std::size_t e = 0; e < mesh.edges.size(); ++e) {
    edges[2 * e] = mesh.edges[e][0];
    edges[2 * e + 1] = mesh.edges[e][1];
  }
  return p;
}

Parameters public_parameters(std::int64_t n) {
  Parameters p;
  p.n = n;
  return p;
}

Parameters hidden_parameters(std::int64_t n) {
  Parameters p;
  p.n = n;
  p.seed = 2;
  p.offset = 0.95;
  p.waviness = 0.34;
  p.wave_a = 2;
  p.wave_b = 3;
  p.phase_step = 0.9;
  p.drive_period = 48;
  p.jitter = 0.07;
  return p;
}

InputSet sheets_set(std::string name, SetKind kind, Size size, const Parameters& parameters) {
  InputSet set;
  set.name = std::move(name);
  set.kind = kind;
  set.size = size;
  set.about = fmt::format("4 cloth sheets of {}^2 vertices {:.2f} apart, driven into each other, seed {}",
                          parameters.n, parameters.offset, parameters.seed);
  set.make = [=] { return problem_from(cloth_sheets::edge_mesh(parameters)); };
  return set;
}

// ---- hard cases ----

using toi::hard;
using toi::known_times;
using toi::no_events;

void add_edge(EdgeMesh& mesh, const Point& a0, const Point& b0, const Point& a1, const Point& b1) {
  const auto narrow = [](const Point& p) {
    return std::array<float, 3>{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
  };
  const std::int32_t first = static_cast<std::int32_t>(mesh.x0.size());
  mesh.x0.push_back(narrow(a0));
  mesh.x0.push_back(narrow(b0));
  mesh.x1.push_back(narrow(a1));
  mesh.x1.push_back(narrow(b1));
  mesh.edges.push_back({first, first + 1});
}

// Edges of two vertices of their own, drawn by `draw(vertex, attempt)`, ambiguous events removed.
EdgeMesh loose_edges(std::int64_t count, const cloth_sheets::DrawVertex& draw) {
  EdgeMesh mesh;
  for (std::int32_t e = 0; e < count; ++e) mesh.edges.push_back({2 * e, 2 * e + 1});
  cloth_sheets::settle(mesh, 2 * count, draw);
  return mesh;
}

// A rod along x at rest, and one along y that falls on it: they meet at t = height / speed. All numbers are
// exact in float32. Pairs lie 16 apart.
constexpr std::int64_t kRods = 64;
double rod_time(std::int64_t pair) {
  return static_cast<double>(2 * pair + 1) / (2 * kRods);
}
void add_rods(EdgeMesh& mesh, std::int64_t pair, double along_first, double along_second, double speed,
              double time) {
  const double x = 16.0 * static_cast<double>(pair % 8), y = 16.0 * static_cast<double>(pair / 8);
  add_edge(mesh, {x, y, 0}, {x + 2, y, 0}, {x, y, 0}, {x + 2, y, 0});
  // They cross at a fraction along_first of the first and along_second of the second.
  const double px = x + 2 * along_first, low = y - 2 * along_second, high = low + 2, z = speed * time;
  add_edge(mesh, {px, low, z}, {px, high, z}, {px, low, z - speed}, {px, high, z - speed});
}

InputSet perpendicular_rods(std::string name, std::string about, double speed) {
  return hard(
      std::move(name), std::move(about),
      [=] {
        EdgeMesh mesh;
        for (std::int64_t k = 0; k < kRods; ++k) add_rods(mesh, k, 0.25, 0.75, speed, rod_time(k));
        return problem_from(mesh);
      },
      {known_times("closed_form", 4 * 0x1p-24, "t = height / speed; every number in it is exact in float32",
                   [](std::int64_t e) { return rod_time(e / 2); })},
      true);
}

// Rods that meet within 1e-6 of an end, of the first or of the second: inside for even pairs.
double end_offset(std::int64_t pair) {
  static constexpr std::array<double, 4> offsets{1e-6, 3e-7, 1e-7, 0};
  return offsets[static_cast<std::size_t>(pair / 2 % 4)] * (pair % 2 == 0 ? 1 : -1);
}

InputSet near_the_ends() {
  return hard(
      "impact_at_an_end",
      "rods that meet within 1e-6 of an end of one of them, beyond it or not: rounding decides, and must "
      "decide for "
      "one of the two answers",
      [] {
        EdgeMesh mesh;
        for (std::int64_t k = 0; k < kRods; ++k) {
          const double offset = k / 8 % 2 == 0 ? end_offset(k) : 1 - end_offset(k);
          add_rods(mesh, k, k / 16 % 2 == 0 ? offset : 0.5, k / 16 % 2 == 0 ? 0.5 : offset, 1.0, rod_time(k));
        }
        return problem_from(mesh);
      },
      {worst_over({.name = "either_answer",
                   .kind = CheckKind::invariant,
                   .array = "toi",
                   .quantity = "largest distance from the nearer of t = height and 1",
                   .tolerance = 4e-6,
                   .why = "the impact is found at its time or not at all",
                   .needs_truth = false},
                  [](const Judged& j) {
                    const HostArray& toi = output(j, "toi");
                    return Items{toi.size(), [&](std::int64_t i) {
                                   return std::min(std::abs(toi.value(i) - rod_time(i / 2)),
                                                   std::abs(toi.value(i) - 1));
                                 }};
                  }),
       worst_over({.name = "agreement_of_the_pair",
                   .kind = CheckKind::invariant,
                   .array = "toi",
                   .quantity = "largest difference between the two rods",
                   .tolerance = 1e-12,
                   .why = "an event is found for both or for neither",
                   .needs_truth = false},
                  [](const Judged& j) {
                    const HostArray& toi = output(j, "toi");
                    return Items{toi.size() / 2,
                                 [&](std::int64_t k) { return toi.value(2 * k) - toi.value(2 * k + 1); }};
                  })},
      false);
}

Problem parallel_edges() {
  EdgeMesh mesh;
  for (int k = 0; k < 24; ++k) {
    const double y = 8.0 * k;
    // Coplanar throughout, falling through each other: parallel, then on one line, then of no length.
    add_edge(mesh, {0, y, 0}, {2, y, 0}, {0, y, 1}, {2, y, 1});
    add_edge(mesh, {1, y, 1}, {3, y, 1}, {1, y, 0}, {3, y, 0});
    add_edge(mesh, {1, y, 0}, {2, y, 0}, {2, y, 0}, {3, y, 0});
    add_edge(mesh, {1, y, 0.5}, {1, y, 0.5}, {1, y, 0.5}, {1, y, 0.5});
    add_edge(mesh, {1, y, 0.25}, {1, y, 0.25}, {2, y, 0.75}, {2, y, 0.75});
  }
  return problem_from(mesh);
}

// Edges of one vertex that sweep through each other; and pairs with a vertex in common at each combination of
// ends.
Problem star() {
  EdgeMesh mesh;
  mesh.x0.push_back({0.1f, 0.2f, 0.3f});
  mesh.x1.push_back({0.3f, 0.7f, 0.1f});
  for (std::int32_t k = 1; k <= 150; ++k) {
    std::array<float, 3> start, end;
    for (std::size_t d = 0; d < 3; ++d) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(k) + d;
      start[d] = static_cast<float>(uniform11(21, 0, i));
      end[d] = static_cast<float>(uniform11(21, 1, i));
    }
    mesh.x0.push_back(start);
    mesh.x1.push_back(end);
    if (k % 2 == 0) {
      mesh.edges.push_back({0, k});
    } else {
      mesh.edges.push_back({k, 0});
    }
  }
  return problem_from(mesh);
}

// Edges that turn over: positions at both times are drawn independently, so that pairs have up to three
// coplanar times.
Problem tumbling(std::int64_t count, double size, std::uint64_t seed) {
  return problem_from(loose_edges(count, [=](std::int64_t v, int attempt) {
    Motion m;
    for (std::size_t d = 0; d < 3; ++d) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(v) + d;
      m.start[d] = size * uniform11(seed, 10 + 100 * static_cast<std::uint64_t>(attempt), i);
      m.end[d] = size * uniform11(seed, 11 + 100 * static_cast<std::uint64_t>(attempt), i);
    }
    return m;
  }));
}

// Loose edges of about unit length that drift, and a few that span them all.
Problem long_edges() {
  constexpr std::int64_t count = 1500, spanning = 6;
  return problem_from(loose_edges(count, [](std::int64_t v, int attempt) {
    Motion m;
    const double half = v / 2 % (count / spanning) == 0 ? 60 : 0.6;
    for (std::size_t d = 0; d < 3; ++d) {
      const auto draw = [&](std::uint64_t stream, std::int64_t item) {
        return uniform11(31, stream + 100 * static_cast<std::uint64_t>(attempt),
                         3 * static_cast<std::uint64_t>(item) + d);
      };
      // The centre belongs to the edge and is not drawn anew.
      const double centre = 8 * uniform11(31, 0, 3 * static_cast<std::uint64_t>(v / 2) + d);
      m.start[d] = centre + half * draw(1, v);
      m.end[d] = m.start[d] + 0.5 * draw(2, v);
    }
    return m;
  }));
}

/// Two edges with nothing else near, whose answer is exact in float32.
struct KnownPair {
  Point a0, b0, a1, b1, c0, d0, c1, d1;
  double time;
};

std::vector<KnownPair> known_pairs() {
  // An edge along x at rest, and one that falls through z = 0 at t = 1/2 (or as said).
  const Point o{0, 0, 0}, e{2, 0, 0};
  const auto falls = [&](const Point& c, const Point& d, double time) {
    return KnownPair{o, e, o, e, {c[0], c[1], 1}, {d[0], d[1], 1}, {c[0], c[1], -1}, {d[0], d[1], -1}, time};
  };
  const auto crosses_at = [&](double x, double below, double time) {
    return falls({x, -below, 0}, {x, 2 - below, 0}, time);
  };
  std::vector<KnownPair> pairs{
      crosses_at(1, 1, 0.5),
      crosses_at(0, 1, 0.5),  // the ends belong to both edges
      crosses_at(2, 1, 0.5),
      crosses_at(1, 0, 0.5),
      crosses_at(1, 2, 0.5),
      crosses_at(0, 0, 0.5),
      crosses_at(2, 2, 0.5),
      crosses_at(-0x1p-20, 1, 1),  // and nothing beyond
      crosses_at(2 + 0x1p-20, 1, 1),
      crosses_at(1, -0x1p-20, 1),
      crosses_at(1, 2 + 0x1p-20, 1),
      // Contact at the start: w . (u x v) has the sign of z there, and zero counts as positive.
      {o, e, o, e, {1, -1, 0}, {1, 1, 0}, {1, -1, -1}, {1, 1, -1}, 0},
      {o, e, o, e, {1, -1, 0}, {1, 1, 0}, {1, -1, 1}, {1, 1, 1}, 1},
      {o, e, o, e, {1, 1, 0}, {1, -1, 0}, {1, 1, 1}, {1, -1, 1}, 0},
      // Arrival at the end, from above and from below.
      {o, e, o, e, {1, -1, 1}, {1, 1, 1}, {1, -1, 0}, {1, 1, 0}, 1},
      {o, e, o, e, {1, -1, -1}, {1, 1, -1}, {1, -1, -0.0}, {1, 1, -0.0}, 1},
      {o, e, o, e, {1, -1, 0.25}, {1, 1, 0.25}, {1, -1, -0.75}, {1, 1, -0.75}, 0.25},
      // It turns about its first end, which rests (c3 = 0): z where they cross is 1/2 - t.
      {o, e, o, e, {1, -1, 0.5}, {1, 1, 0.5}, {1, -1, 0.5}, {1, 1, -1.5}, 0.5},
  };
  // Nearly parallel: the lines cross at an angle of 2^-k, in the middle of both. Below 1e-6 they count as
  // parallel.
  for (const int k : {7, 10, 13, 16, 19})
    pairs.push_back(falls({0, -std::ldexp(1, -k), 0}, {2, std::ldexp(1, -k), 0}, 0.5));
  pairs.push_back(falls({0, -0x1p-21, 0}, {2, 0x1p-21, 0}, 1));
  // A short edge across a long one.
  pairs.push_back({o, e, o, e, {1, -0x1p-20, 1}, {1, 0x1p-20, 1}, {1, -0x1p-20, -1}, {1, 0x1p-20, -1}, 0.5});
  return pairs;
}

Problem exact_pairs(double scale) {
  EdgeMesh mesh;
  double z = 0;
  for (const KnownPair& k : known_pairs()) {
    // Apart along z, where coordinates have few digits.
    const auto placed = [&](const Point& p) { return Point{scale * p[0], scale * p[1], scale * (p[2] + z)}; };
    add_edge(mesh, placed(k.a0), placed(k.b0), placed(k.a1), placed(k.b1));
    add_edge(mesh, placed(k.c0), placed(k.d0), placed(k.c1), placed(k.d1));
    z += 8;
  }
  return problem_from(mesh);
}

InputSet exact_pairs_set(const std::string& name, const std::string& about, double scale) {
  return hard(
      name, about, [=] { return exact_pairs(scale); },
      {known_times("known_times", 0x1p-22, "closed forms with numbers exact in float32",
                   [](std::int64_t e) { return known_pairs()[static_cast<std::size_t>(e / 2)].time; })},
      true);
}

// Pairs of rods that meet in each corner, on each face and in the middle of the scene.
Problem rods_in_the_corners() {
  EdgeMesh mesh;
  for (int k = 0; k < 27; ++k) {
    const double x = 400.0 * (k % 3 - 1), y = 500.0 * (k / 3 % 3 - 1), z = 300.0 * (k / 9 - 1);
    // Each ends where the scene does.
    const double sx = x > 0 ? -1 : 1, sy = y > 0 ? -1 : 1, sz = z > 0 ? -1 : 1;
    add_edge(mesh, {x, y + sy, z}, {x + 2 * sx, y + sy, z}, {x, y + sy, z}, {x + 2 * sx, y + sy, z});
    add_edge(mesh, {x + sx, y, z + 2 * sz}, {x + sx, y + 2 * sy, z + 2 * sz}, {x + sx, y, z - 2 * sz},
             {x + sx, y + 2 * sy, z - 2 * sz});
  }
  return problem_from(mesh);
}

// Edges that turn over, a half of them at rest and a quarter nearly so: the cubic's leading coefficient is
// zero or nearly.
Problem half_at_rest() {
  return problem_from(loose_edges(240, [](std::int64_t v, int attempt) {
    Motion m;
    const double share = v / 2 % 4 < 2 ? 0 : v / 2 % 4 == 2 ? 1e-5 : 1;
    for (std::size_t d = 0; d < 3; ++d) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(v) + d;
      m.start[d] = 2 * uniform11(52, 10 + 100 * static_cast<std::uint64_t>(attempt), i);
      m.end[d] = m.start[d] +
                 share * (2 * uniform11(52, 11 + 100 * static_cast<std::uint64_t>(attempt), i) - m.start[d]);
    }
    return m;
  }));
}

// 1100 short edges within the box of a middling one: more candidates than any fixed list holds. Others of its
// size stand far away, so that it does not count as large.
Problem crowded() {
  constexpr std::int64_t short_ones = 1100, others = 1500;
  return problem_from(loose_edges(1 + short_ones + others, [](std::int64_t v, int attempt) {
    Motion m;
    const std::int64_t edge = v / 2;
    for (std::size_t d = 0; d < 3; ++d) {
      const auto draw = [&](std::uint64_t stream, std::int64_t item) {
        return uniform11(53, stream + 100 * static_cast<std::uint64_t>(attempt),
                         3 * static_cast<std::uint64_t>(item) + d);
      };
      const double end = v % 2 == 0 ? -1 : 1;
      if (edge == 0) {
        m.start[d] = end + 0.01 * draw(1, v);
      } else if (edge <= short_ones) {
        m.start[d] = uniform11(53, 0, 3 * static_cast<std::uint64_t>(edge) + d) + 0.1 * draw(1, v);
      } else {
        const double place = d == 0   ? static_cast<double>(edge % 40)
                             : d == 1 ? static_cast<double>(edge / 40 % 40)
                                      : 3;
        m.start[d] = 4 * place + 10 + end + 0.01 * draw(1, v);
      }
      m.end[d] = m.start[d] + 0.1 * draw(2, v);
    }
    return m;
  }));
}

Problem static_sheets() {
  EdgeMesh mesh = cloth_sheets::edge_mesh(public_parameters(14));
  mesh.x0 = mesh.x1;  // in the middle of each other
  return problem_from(mesh);
}

// Far from the origin float32 positions have a resolution of 1e-3: the inputs are what they are after
// rounding.
Problem far_from_the_origin() {
  const Parameters parameters = public_parameters(13);
  EdgeMesh mesh = cloth_sheets::edge_mesh(parameters);
  const std::vector<std::array<float, 3>> x0 = mesh.x0, x1 = mesh.x1;
  cloth_sheets::settle(mesh, static_cast<std::int64_t>(x0.size()), [&](std::int64_t v, int attempt) {
    Motion m;
    for (std::size_t d = 0; d < 3; ++d) {
      // Drawn anew, a vertex moves by a few units of that resolution.
      const double shift = attempt == 0 ? 0
                                        : 0.02 * uniform11(41, static_cast<std::uint64_t>(attempt),
                                                           3 * static_cast<std::uint64_t>(v) + d);
      m.start[d] = 1e4 + static_cast<double>(x0[static_cast<std::size_t>(v)][d]) + shift;
      m.end[d] = 1e4 + static_cast<double>(x1[static_cast<std::size_t>(v)][d]) - shift;
    }
    return m;
  });
  return problem_from(mesh);
}

std::vector<InputSet> hard_cases() {
  std::vector<InputSet> sets;
  sets.push_back(hard(
      "one_edge", "a single edge has no partner",
      [] {
        EdgeMesh mesh;
        add_edge(mesh, {0, 0, 0}, {1, 0, 0}, {0, 3, 0}, {0, 3, 1});
        return problem_from(mesh);
      },
      {no_events("there is no other edge")}, false));
  sets.push_back(hard("static", "sheets that interpenetrate and do not move", static_sheets,
                      {no_events("nothing moves, so no sign changes")}, false));
  sets.push_back(hard("always_coplanar",
                      "pairs that stay parallel, overlap on one line or have no length, passing through "
                      "each other",
                      parallel_edges, {no_events("the triple product is zero throughout: no change of sign")},
                      false));
  sets.push_back(hard("one_vertex", "150 edges that all share a vertex sweep through each other", star,
                      {no_events("edges with a vertex in common are no pair")}, false));
  sets.push_back(perpendicular_rods("perpendicular_rods", "rods falling on rods: known times", 1.0));
  sets.push_back(perpendicular_rods(
      "fast_rods", "the same at 4096 lengths a step: each box spans all others along z", 4096.0));
  sets.push_back(near_the_ends());
  sets.push_back(hard(
      "tumbling_in_one_cell",
      "500 edges that turn over in one spot: all pairs overlap, up to three coplanar times",
      [] { return tumbling(500, 1.0, 51); }, {}, true));
  sets.push_back(
      exact_pairs_set("exact_pairs",
                      "pairs whose answers are exact in float32: ends hit and just missed, contact at the "
                      "start and at the end, angles down to 2^-19",
                      1));
  sets.push_back(exact_pairs_set("exact_small_pairs", "the same, 2^20 times smaller", 0x1p-20));
  sets.push_back(hard(
      "rods_in_the_corners", "rods that meet in the corners and on the faces of the scene",
      rods_in_the_corners,
      {known_times("closed_form", 0x1p-22, "they meet at half the way", [](std::int64_t) { return 0.5; })},
      true));
  sets.push_back(
      hard("half_at_rest", "edges that turn over among others at rest or nearly so", half_at_rest, {}, true));
  sets.push_back(hard("crowded", "an edge whose box overlaps those of 1100 others", crowded, {}, true));
  sets.push_back(hard(
      "large_scale", "edges that turn over, with coordinates up to 1e6 m",
      [] { return tumbling(150, 983040, 54); }, {}, true));
  sets.push_back(hard(
      "small_scale", "edges that turn over within a micrometre", [] { return tumbling(150, 0x1p-20, 55); },
      {}, true));
  sets.push_back(hard("long_edges", "six edges a hundred times as long as the other 1494 around them",
                      long_edges, {}, true));
  sets.push_back(hard("far_from_the_origin", "sheets at 1e4: positions resolve 1e-3, differences are exact",
                      far_from_the_origin, {}, true));
  return sets;
}

}  // namespace

Task make_task() {
  Task task;
  task.title = "Continuous edge-edge collision detection in moving cloth";
  task.paper_number = 43;
  task.contract = describe<Inputs, Outputs<float>>();
  task.sets.push_back(sheets_set("public", SetKind::open, Size::paper, public_parameters(320)));
  task.sets.push_back(sheets_set("hidden", SetKind::hidden, Size::paper, hidden_parameters(320)));
  task.sets.push_back(sheets_set("public_smoke", SetKind::open, Size::smoke, public_parameters(53)));
  task.sets.push_back(sheets_set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_parameters(47)));
  for (InputSet& set : hard_cases()) task.sets.push_back(std::move(set));
  task.checks = {
      toi::minus_1_rel_l2(4e-6),
      toi::local(1e-4,
                 "inputs keep no event whose time float32 rounding, taken at sixteen units of the "
                 "largest term of the cubic, could move by more than 5e-4; what is seen are one to two "
                 "units"),
      toi::mismatched_events()};
  task.unordered = {{"n", {"edges"}}, {"m", {}}};
  task.target_floor_multiple = 60;
  return task;
}

}  // namespace gpuphys::ccd_ee
