// Input sets and checks of ccd_ee (specification: cases/collision_query/ccd_ee.md).
#include "cases/collision_query/ccd_ee.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"
#include "core/judge/comparators.hpp"

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

// ---- checks ----

// Truth as the best float32 output.
double rounded(const HostArray& truth, std::int64_t i) {
  return static_cast<double>(static_cast<float>(truth.value(i)));
}

Check relative_l2_of_toi_minus_1() {
  return {"toi_minus_1_rel_l2",
          CheckKind::paper,
          "toi - 1",
          "relative L2",
          4e-6,
          "the paper's table of inputs and checks",
          true,
          [](const Judged& j) {
            const HostArray &got = find(j.outputs, "toi", "outputs"), &truth = find(*j.truth, "toi", "truth");
            double difference = 0, norm = 0;
            for (std::int64_t i = 0; i < got.size(); ++i) {
              const double g = got.value(i), r = rounded(truth, i);
              difference += (g - r) * (g - r);
              norm += (r - 1) * (r - 1);
            }
            Measured m;
            m.error = std::sqrt(norm > 0 ? difference / norm : difference);
            return m;
          }};
}

constexpr double kLocalTolerance = 1e-4;

Check local_error() {
  return worst_over(
      {.name = "toi_local",
       .array = "toi",
       .quantity = "largest error",
       .tolerance = kLocalTolerance,
       .why = "inputs keep no event whose time float32 rounding, taken at sixteen units of the "
              "largest term of the cubic, could move by more than 5e-4; what is seen are one to "
              "two units"},
      [](const Judged& j) {
        const HostArray &got = output(j, "toi"), &expected = truth(j, "toi");
        return Items{got.size(), [&](std::int64_t i) { return got.value(i) - rounded(expected, i); },
                     [&](std::int64_t i) {
                       return fmt::format("worst at {}: got {:.9g}, expected {:.9g}", index_text(got, i),
                                          got.value(i), rounded(expected, i));
                     }};
      });
}

Check mismatched_events() {
  return count_where(
      {.name = "toi_mismatched_events",
       .array = "toi",
       .quantity = "edges with an event in one solution only, or with times more than 1e-3 apart",
       .tolerance = 0.5,
       .why = "none: inputs hold no event that rounding in float32 can add or remove"},
      [](const Judged& j) {
        const HostArray &got = output(j, "toi"), &expected = truth(j, "toi");
        return Items{got.size(),
                     [&](std::int64_t i) {
                       const double g = got.value(i), r = rounded(expected, i);
                       return (g < 1) == (r < 1) && std::abs(g - r) <= 1e-3 ? 0.0 : 1.0;
                     },
                     [&](std::int64_t i) {
                       return fmt::format("first at {}: got {:.9g}, expected {:.9g}", index_text(got, i),
                                          got.value(i), rounded(expected, i));
                     }};
      });
}

/// Every output within [0, 1].
Check within_the_step() {
  return within("toi", 0, 1, "an impact outside the step is none of it", "within_the_step");
}

/// Every output equals what `expected` says of its edge, within `tolerance`.
Check known_times(std::string name, double tolerance, std::string why,
                  std::function<double(std::int64_t)> expected) {
  return equals_known(
      {.name = std::move(name),
       .kind = CheckKind::invariant,
       .array = "toi",
       .quantity = "largest distance from the known time",
       .tolerance = tolerance,
       .why = std::move(why),
       .needs_truth = false},
      [expected = std::move(expected)](const Judged& j) {
        std::vector<double> known;
        for (std::int64_t e = 0; e < output(j, "toi").size(); ++e) known.push_back(expected(e));
        return known;
      },
      1);
}

Check no_events(std::string why) {
  // A single event is an error of up to 1: any tolerance below the resolution of an impact time does.
  return known_times("no_events", 1e-12, std::move(why), [](std::int64_t) { return 1.0; });
}

// ---- hard cases ----

InputSet hard(const std::string& stress, const std::string& about, std::function<Problem()> make,
              std::vector<Check> invariants, bool use_task_checks) {
  invariants.push_back(within_the_step());
  return hard_case(stress, about, std::move(make), std::move(invariants), use_task_checks);
}

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
                                 [&](std::int64_t i) { return toi.value(2 * i) - toi.value(2 * i + 1); }};
                  })},
      false);
}

// Pairs whose answer exact comparisons decide, in numbers that float32 holds exactly, and so does the cubic.
struct KnownPairs {
  EdgeMesh mesh;
  std::vector<double> times;  // of each edge

  void add(const Point& a0, const Point& b0, const Point& a1, const Point& b1) {
    add_edge(mesh, a0, b0, a1, b1);
  }
  void close_pair(double time) { times.insert(times.end(), {time, time}); }
};

// Rods that meet exactly at an end of one or of both: the interval is closed, at each of its ends.
KnownPairs exact_ends() {
  KnownPairs k;
  for (std::int64_t pair = 0; pair < 48; ++pair) {
    const double fractions[] = {0.0, 0.5, 1.0, -0.0625, 1.0625};
    const double s = fractions[pair % 5], r = fractions[pair / 5 % 5], time = 0.25 + 0.125 * (pair % 3);
    add_rods(k.mesh, pair, s, r, 1.0, time);
    k.close_pair(s >= 0 && s <= 1 && r >= 0 && r <= 1 ? time : 1.0);
  }
  return k;
}

// f = 0 at t = 0, where zero counts as positive, and then of either sign; f = -(t - 1/2)^2, which touches
// zero from below, an event, and its negative, none.
KnownPairs exact_zeros() {
  KnownPairs k;
  for (int pair = 0; pair < 32; ++pair) {
    const double x = 16.0 * (pair % 8), y = 16.0 * (pair / 8), side = pair % 2 == 0 ? 1.0 : -1.0;
    if (pair % 4 < 2) {
      // In contact at the start, then apart: f falls below zero for one direction only.
      k.add({x, y, 0}, {x + 2, y, 0}, {x, y, 0}, {x + 2, y, 0});
      k.add({x + 1, y - 1, 0}, {x + 1, y + 1, 0}, {x + 1, y - 1, side}, {x + 1, y + 1, side});
      k.close_pair(side < 0 ? 0.0 : 1.0);
    } else {
      // u = (1, 0, side t), v = (0, 2, 0), w = (t, -1, side (t - 1/4)): f = 2 side (t - 1/4 - t^2).
      k.add({x, y, 0}, {x + 1, y, 0}, {x, y, 0}, {x + 1, y, side});
      k.add({x, y - 1, -0.25 * side}, {x, y + 1, -0.25 * side}, {x + 1, y - 1, 0.75 * side},
            {x + 1, y + 1, 0.75 * side});
      k.close_pair(side > 0 ? 0.5 : 1.0);
    }
  }
  return k;
}

// Rods that cross at an angle of 2^-k; up to about 1e-6 they count as parallel.
KnownPairs small_angles() {
  KnownPairs k;
  for (int pair = 0; pair < 24; ++pair) {
    const double x = 16.0 * (pair % 6), z = 16.0 * (pair / 6), angle = std::ldexp(1.0, -2 - pair),
                 time = 0.3125;
    // About y = 0, where float32 holds the small ends.
    k.add({x, 0, z}, {x + 1, 0, z}, {x, 0, z}, {x + 1, 0, z});
    k.add({x, -0.5 * angle, z + time}, {x + 1, 0.5 * angle, z + time}, {x, -0.5 * angle, z + time - 1},
          {x + 1, 0.5 * angle, z + time - 1});
    k.close_pair(angle > 1e-6 ? time : 1.0);
  }
  return k;
}

// Rods at the corners and in the middle of a box, all of which an impact stops: what lies in the first and in
// the last layer of cells is like the rest.
KnownPairs corners() {
  KnownPairs k;
  for (int pair = 0; pair < 125; ++pair) {
    const double x = 4.0 * (pair % 5), y = 4.0 * (pair / 5 % 5), z = 4.0 * (pair / 25),
                 time = 0.125 * (1 + pair % 7);
    k.add({x, y, z}, {x + 2, y, z}, {x, y, z}, {x + 2, y, z});
    k.add({x + 2, y - 2, z + time}, {x + 2, y, z + time}, {x + 2, y - 2, z + time - 1},
          {x + 2, y, z + time - 1});
    k.close_pair(time);
  }
  return k;
}

InputSet known_set(const std::string& stress, const std::string& about, KnownPairs (*make)(),
                   bool use_task_checks, double tolerance = 1e-6) {
  return hard(
      stress, about, [make] { return problem_from(make().mesh); },
      {known_times("known_times", tolerance,
                   "30 bisections leave 2^-31, a touching cubic is zero to rounding for 3e-4 around; all "
                   "else is exact in float32",
                   [times = make().times](std::int64_t e) { return times[static_cast<std::size_t>(e)]; })},
      use_task_checks);
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

// Pairs 8 m apart of which one edge hardly moves while the other turns over: cubics whose highest coefficient
// is exactly zero, or small against the others.
Problem nearly_quadratic() {
  return problem_from(loose_edges(900, [](std::int64_t v, int attempt) {
    constexpr double amount[] = {0.0, 1e-5, 1e-3};
    const std::int64_t pair = v / 4;
    const double turn = v % 4 < 2 ? amount[pair % 3] : 1.0;
    Motion m;
    for (std::size_t d = 0; d < 3; ++d) {
      const auto draw = [&](std::uint64_t stream) {
        return uniform11(61, stream + 100 * static_cast<std::uint64_t>(attempt),
                         3 * static_cast<std::uint64_t>(v) + d);
      };
      const double centre = d == 0   ? 8.0 * static_cast<double>(pair % 21 - 10)
                            : d == 1 ? 8.0 * static_cast<double>(pair / 21 - 10)
                                     : 0.0;
      m.start[d] = centre + draw(1);
      m.end[d] = turn == 0 ? m.start[d] : turn < 1 ? m.start[d] + turn * draw(2) : centre + draw(2);
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
  sets.push_back(known_set("exact_ends",
                           "rods that meet exactly at an end of one or both, or a sixteenth beyond it",
                           exact_ends, true));
  sets.push_back(known_set("exact_zeros",
                           "f exactly zero at t = 0, or touching zero from below or above at t = 1/2",
                           exact_zeros, false, 5e-4));
  sets.push_back(known_set("small_angles", "rods that cross at angles of 2^-2 to 2^-25", small_angles, true));
  sets.push_back(known_set("corners", "impacts at all corners of the scene", corners, true));
  sets.push_back(hard("nearly_quadratic", "an edge that rests, or nearly, and one that turns over: 450 pairs",
                      nearly_quadratic, {}, true));
  sets.push_back(hard(
      "crowd", "1300 edges that turn over in one spot: more than a thousand candidates each",
      [] { return tumbling(1300, 1.0, 52); }, {}, true));
  sets.push_back(hard(
      "millimetre", "edges of a millimetre", [] { return tumbling(150, 1e-3, 53); }, {}, true));
  sets.push_back(hard(
      "nanometre", "edges of a nanometre", [] { return tumbling(120, 1e-9, 54); }, {}, true));
  sets.push_back(hard(
      "megametre", "coordinates up to the largest that are valid", [] { return tumbling(100, 1e6, 55); }, {},
      true));
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
  task.checks = {relative_l2_of_toi_minus_1(), local_error(), mismatched_events()};
  task.unordered = {{"n", {"edges"}}, {"m", {}}};
  task.target_floor_multiple = 60;
  return task;
}

}  // namespace gpuphys::ccd_ee
