// Input sets and checks of ccd_ee (specification: cases/collision_query/ccd_ee.md).
#include "cases/collision_query/ccd_ee.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>

#include "cases/collision_query/cloth_sheets_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
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
  return {"toi_local",
          CheckKind::local,
          "toi",
          "largest error",
          kLocalTolerance,
          "inputs keep no event whose time float32 rounding, taken at sixteen units of the largest term of "
          "the cubic, could move by more than 5e-4; what is seen are one to two units",
          true,
          [](const Judged& j) {
            const HostArray &got = find(j.outputs, "toi", "outputs"), &truth = find(*j.truth, "toi", "truth");
            Measured worst;
            worst.error = -1;
            for (std::int64_t i = 0; i < got.size(); ++i) {
              const double e = std::abs(got.value(i) - rounded(truth, i));
              if (!(e <= worst.error)) {
                worst = {e, fmt::format("worst at {}: got {:.9g}, expected {:.9g}", index_text(got, i),
                                        got.value(i), rounded(truth, i))};
                if (!std::isfinite(e)) break;
              }
            }
            return worst;
          }};
}

Check mismatched_events() {
  return {"toi_mismatched_events",
          CheckKind::local,
          "toi",
          "edges with an event in one solution only, or with times more than 1e-3 apart",
          0.5,
          "none: inputs hold no event that rounding in float32 can add or remove",
          true,
          [](const Judged& j) {
            const HostArray &got = find(j.outputs, "toi", "outputs"), &truth = find(*j.truth, "toi", "truth");
            Measured m;
            for (std::int64_t i = 0; i < got.size(); ++i) {
              const double g = got.value(i), r = rounded(truth, i);
              if ((g < 1) == (r < 1) && std::abs(g - r) <= 1e-3) continue;
              if (m.error == 0)
                m.detail = fmt::format("first at {}: got {:.9g}, expected {:.9g}", index_text(got, i), g, r);
              m.error += 1;
            }
            return m;
          }};
}

/// Every output within [0, 1].
Check within_the_step() {
  return {"within_the_step",
          CheckKind::invariant,
          "toi",
          "number of values outside [0, 1]",
          0.5,
          "an impact outside the step is none of it",
          false,
          [](const Judged& j) {
            const HostArray& toi = find(j.outputs, "toi", "outputs");
            Measured m;
            for (std::int64_t i = 0; i < toi.size(); ++i) {
              if (toi.value(i) >= 0 && toi.value(i) <= 1) continue;
              if (m.error == 0) m.detail = fmt::format("{} = {:.9g}", index_text(toi, i), toi.value(i));
              m.error += 1;
            }
            return m;
          }};
}

/// Every output equals what `expected` says of its edge, within `tolerance`.
Check known_times(std::string name, double tolerance, std::string why,
                  std::function<double(std::int64_t)> expected) {
  return {std::move(name),
          CheckKind::invariant,
          "toi",
          "largest distance from the known time",
          tolerance,
          std::move(why),
          false,
          [=](const Judged& j) {
            const HostArray& toi = find(j.outputs, "toi", "outputs");
            Measured worst;
            for (std::int64_t i = 0; i < toi.size(); ++i) {
              const double e = std::abs(toi.value(i) - expected(i));
              if (!(e <= worst.error)) {
                worst = {e, fmt::format("{}: got {:.9g}, known {:.9g}", index_text(toi, i), toi.value(i),
                                        expected(i))};
                if (!std::isfinite(e)) break;
              }
            }
            return worst;
          }};
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
      {{"either_answer", CheckKind::invariant, "toi", "largest distance from the nearer of t = height and 1",
        4e-6, "the impact is found at its time or not at all", false,
        [](const Judged& j) {
          const HostArray& toi = find(j.outputs, "toi", "outputs");
          Measured worst;
          for (std::int64_t i = 0; i < toi.size(); ++i) {
            const double e = std::min(std::abs(toi.value(i) - rod_time(i / 2)), std::abs(toi.value(i) - 1));
            if (!(e <= worst.error)) {
              worst = {e, fmt::format("{}: got {:.9g}, height {:.9g}", index_text(toi, i), toi.value(i),
                                      rod_time(i / 2))};
              if (!std::isfinite(e)) break;
            }
          }
          return worst;
        }},
       {"agreement_of_the_pair", CheckKind::invariant, "toi", "largest difference between the two rods",
        1e-12, "an event is found for both or for neither", false,
        [](const Judged& j) {
          const HostArray& toi = find(j.outputs, "toi", "outputs");
          Measured worst;
          for (std::int64_t i = 0; i + 1 < toi.size(); i += 2)
            worst.error = std::max(worst.error, std::abs(toi.value(i) - toi.value(i + 1)));
          return worst;
        }}},
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
  sets.push_back(hard("long_edges", "six edges a hundred times as long as the other 1494 around them",
                      long_edges, {}, true));
  sets.push_back(hard("far_from_the_origin", "sheets at 1e4: positions resolve 1e-3, differences are exact",
                      far_from_the_origin, {}, true));
  return sets;
}

}  // namespace

Task make_task() {
  Task task;
  task.name = "ccd_ee";
  task.family = "collision_query";
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
