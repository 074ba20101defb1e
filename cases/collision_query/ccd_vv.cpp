// Input sets and checks of ccd_vv (specification: cases/collision_query/ccd_vv.md).
#include "cases/collision_query/ccd_vv.hpp"

#include <fmt/format.h>

#include <cmath>

#include "cases/collision_query/toi_checks.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::ccd_vv {
namespace {

using cloth_sheets::Mesh;
using cloth_sheets::Motion;
using cloth_sheets::Parameters;
using cloth_sheets::Point;

constexpr double kDistance = 0.3;  // of the sheets

// The float32 number above x.
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
  set.make = [=] { return problem_of(cloth_sheets::sheet_mesh(p, 1, kDistance), kDistance); };
  return set;
}

// ---- hard cases ----

Check tight(double tolerance) {
  return as_invariant(toi::local(tolerance, ""), "toi_tight", tolerance,
                      "what the serial float32 builds show on this set, ten times");
}

// Two vertices that meet with nothing else near: `p` and `q` are position and motion of the second one as
// seen from the first.
struct KnownPair {
  Point p, q;
  double time;
};

std::vector<KnownPair> known_pairs() {
  return {
      {{-4, 3, 0}, {8, 0, 0}, 0.5},       // touches at the closest approach: closed
      {{-4, above(3), 0}, {8, 0, 0}, 1},  // passes by one unit in the last place farther
      {{0, -4, -3}, {0, 8, 0}, 0.5},
      {{0, 3, 0}, {0, 1, 0}, 0},  // recedes from exactly d: closed
      {{0, above(3), 0}, {0, 1, 0}, 1},
      {{0, 3, 0}, {0, -1, 0}, 0},
      {{4, 0, 0}, {-2, 0, 0}, 0.5},
      {{0, 0, -4}, {0, 0, 2}, 0.5},
      {{4, 0, 0}, {-1, 0, 0}, 1},      // arrives at the end of the step
      {{4, 0, 0}, {-0.875, 0, 0}, 1},  // and not quite
      {{5, 0, 0}, {0, 0, 0}, 1},       // no relative motion
      {{-0.0, -0.0, 3.5}, {-0.0, 0, -0.0}, 1},
      {{1, 2, 2}, {0, 0, 0}, 0},     // at rest at exactly d
      {{1, 0.5, -1}, {8, 8, 8}, 0},  // recedes from inside
      {{0, 0, 0}, {0, 0, 0}, 0},     // coincide
      {{0, 0, 0}, {1, -2, 4}, 0},
      {{0, 0, 3.0 + 0x1p-16}, {0, 0, -0x1p-14}, 0.25},  // slow: 6e-5 m a step
      {{0, 0, 12}, {0, 0, -12}, 0.75},
  };
}

Problem exact_pairs() {
  Mesh mesh;
  for (const KnownPair& k : known_pairs()) {
    // 64 apart. In every third pair the first vertex moves, in every other third both do.
    const std::size_t at = mesh.x0.size();
    const double x = 32.0 * static_cast<double>(at);
    const double share = at / 2 % 3 == 0 ? 0 : at / 2 % 3 == 1 ? 1 : 0.5;
    const Point first{x, 0, 0}, second{x + k.p[0], k.p[1], k.p[2]};
    Point end = first, other_end = second;
    for (std::size_t d = 0; d < 3; ++d) {
      end[d] -= share * k.q[d];
      other_end[d] += (1 - share) * k.q[d];
    }
    toi::add_vertex(mesh, first, end);
    toi::add_vertex(mesh, second, other_end);
  }
  return problem_of(mesh, 3);
}

// Pairs that approach along z at `speed` until they are 3 m apart at (2k + 1)/128.
constexpr int kFastPairs = 64;
double fast_time(std::int64_t pair) {
  return static_cast<double>(2 * pair + 1) / (2 * kFastPairs);
}
Problem fast_pairs(double speed) {
  Mesh mesh;
  for (int k = 0; k < kFastPairs; ++k) {
    const double x = 16.0 * (k % 8), y = 16.0 * (k / 8), z = speed * fast_time(k) + 3;
    toi::add_vertex(mesh, {x, y, 0}, {x, y, 0});
    toi::add_vertex(mesh, {x, y, z}, {x, y, z - speed});
  }
  return problem_of(mesh, 3);
}

// A pair in each corner of the scene, and in the middle of each face; nothing in between.
Problem corners() {
  Mesh mesh;
  for (int k = 0; k < 27; ++k) {
    const double x = 500.0 * (k % 3 - 1), y = 400.0 * (k / 3 % 3 - 1), z = 300.0 * (k / 9 - 1);
    // Towards the outside, so that contact happens in the outermost layer of cells.
    const double sx = x < 0 ? -1 : 1;
    toi::add_vertex(mesh, {x, y, z}, {x, y, z});
    toi::add_vertex(mesh, {x - 4 * sx, y, z}, {x, y, z});
  }
  return problem_of(mesh, 2);
}

// `count` vertices at random places of a box, drifting; ambiguous events removed.
Problem drifting(std::int64_t count, const Point& size, double drift, double d, std::uint64_t seed) {
  Mesh mesh;
  cloth_sheets::settle(mesh, count, d, [=](std::int64_t v, int attempt) {
    Motion m;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(v) + c;
      m.start[c] = size[c] * uniform11(seed, 10 + 100 * static_cast<std::uint64_t>(attempt), i);
      m.end[c] = m.start[c] + drift * uniform11(seed, 11 + 100 * static_cast<std::uint64_t>(attempt), i);
    }
    return m;
  });
  return problem_of(mesh, d);
}

Problem static_sheets() {
  const Mesh moving = cloth_sheets::sheet_mesh(toi::public_sheets(19, 0.15), 1, kDistance);
  Mesh mesh;
  // In the middle of each other, where they stay.
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
  const Mesh mesh = cloth_sheets::sheet_mesh(toi::hidden_sheets(15, 0.16), 1, kDistance);
  return problem_of(toi::scaled(mesh, factor), static_cast<double>(static_cast<float>(kDistance)) * factor);
}

std::vector<InputSet> hard_cases() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet set) { sets.push_back(std::move(set)); };
  add(toi::hard(
      "exact_pairs", "pairs 64 m apart whose answers are exact in float32: closed and open comparisons",
      exact_pairs,
      {toi::known_times("known_times", 0x1p-23, "every number of the closed form is exact in float32",
                        [](std::int64_t i) { return known_pairs()[static_cast<std::size_t>(i / 2)].time; })},
      true));
  add(toi::hard(
      "fast_pairs", "4096 m a step: boxes span all others along z", [] { return fast_pairs(4096); },
      {toi::known_times("closed_form", 0x1p-23, "t = (distance - d)/speed, exact in float32",
                        [](std::int64_t i) { return fast_time(i / 2); })},
      true));
  add(toi::hard("corners", "contacts in every corner and on every face of the scene", corners,
                {toi::known_times("closed_form", 0x1p-23, "2 m of 4 are gone at t = 1/2",
                                  [](std::int64_t) { return 0.5; })},
                true));
  add(toi::hard(
      "one_vertex", "a single vertex has no partner",
      [] {
        Mesh mesh;
        toi::add_vertex(mesh, {1, 2, 3}, {-1, 0, 5});
        return problem_of(mesh, 1);
      },
      {toi::no_events("there is no other vertex")}, false));
  add(toi::hard(
      "coincident", "200 vertices in one point that fly apart",
      [] {
        Mesh mesh;
        for (std::uint64_t v = 0; v < 200; ++v)
          toi::add_vertex(mesh, {0.25, -0.5, 7}, {uniform11(33, 1, 3 * v), uniform11(33, 1, 3 * v + 1), 7});
        return problem_of(mesh, 0.01);
      },
      {toi::known_times("contact_at_once", 0, "all distances are 0 at the start",
                        [](std::int64_t) { return 0.0; })},
      true));
  add(toi::hard(
      "crowded", "1300 vertices that cross one spot: every box meets every other",
      [] {
        return drifting(1300, {1, 1, 1}, 1, 0.01, 34);
      },
      {tight(3e-6)}, true));
  add(toi::hard(
      "sparse", "33 vertices far apart, d = 3, motions of ten times that",
      [] {
        return drifting(33, {20, 15, 10}, 30, 3, 35);
      },
      {tight(3e-6)}, true));
  add(toi::hard(
      "row", "65,537 vertices in a row along y",
      [] {
        return drifting(65537, {0.5, 40000, 0.25}, 0.5, 0.0625, 36);
      },
      {tight(3e-6)}, true));
  add(toi::hard("static",
                "sheets that interpenetrate and do not move: near pairs and contacts from the start",
                static_sheets, {tight(3e-6)}, true));
  add(toi::hard(
      "large_scale", "sheets 65,536 times as large: coordinates up to 1e6 m",
      [] { return scaled_sheets(0x1p16); }, {tight(3e-6)}, true));
  add(toi::hard(
      "small_scale", "sheets 2^20 times smaller: a micrometre from vertex to vertex",
      [] { return scaled_sheets(0x1p-20); }, {tight(3e-6)}, true));
  add(toi::hard(
      "far_from_the_origin", "sheets at 1e5 m, where positions resolve 8 mm and differences are exact",
      [] {
        return problem_of(toi::far_sheets(toi::public_sheets(13, 0.15), 1, kDistance, 1e5, 0.1), kDistance);
      },
      {tight(3e-6)}, true));
  return sets;
}

}  // namespace

Task make_task() {
  Task task;
  task.title = "Continuous vertex-vertex collision detection in moving cloth";
  task.paper_number = 40;
  task.contract = describe<Inputs, Outputs<float>>();
  task.sets.push_back(sheets_set("public", SetKind::open, Size::paper, toi::public_sheets(1400, 0.15)));
  task.sets.push_back(sheets_set("hidden", SetKind::hidden, Size::paper, toi::hidden_sheets(1400, 0.16)));
  task.sets.push_back(sheets_set("public_smoke", SetKind::open, Size::smoke, toi::public_sheets(113, 0.15)));
  task.sets.push_back(sheets_set("hidden_smoke", SetKind::hidden, Size::smoke, toi::hidden_sheets(97, 0.16)));
  for (InputSet& set : hard_cases()) task.sets.push_back(std::move(set));
  task.checks = {toi::minus_1_rel_l2(3e-2),
                 toi::local(1e-4,
                            "inputs keep no event whose time float32 rounding, taken at sixteen units, could "
                            "move by more than 5e-4"),
                 toi::mismatched_events()};
  task.unordered = {{"n", {}}};
  task.target_floor_multiple = 10;
  return task;
}

}  // namespace gpuphys::ccd_vv
