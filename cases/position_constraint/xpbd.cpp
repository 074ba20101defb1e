// Input sets, checks and hard cases of xpbd (specification: cases/position_constraint/xpbd.md).
#include "cases/position_constraint/xpbd.hpp"

#include <fmt/format.h>

#include <cmath>
#include <utility>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "cases/position_constraint/contact_inputs.hpp"
#include "cases/position_constraint/spring_inputs.hpp"
#include "core/base/error.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::xpbd {
namespace {

namespace pc = position_constraint;
using pc::Positions;

struct Solver {
  double dt = 0.1, spring_compliance = 0.005, contact_compliance = 0, thickness = 0.5, radius = 0.625,
         relaxation = 0.25;
  int iterations = 8;
};

/// Particles, velocities and springs in FP64, as they will be rounded.
struct Cloth {
  Positions x, v;
  std::vector<double> inv_mass;  ///< empty: 1 everywhere
  std::vector<std::array<std::int32_t, 2>> springs;
  std::vector<double> rest;
};

double narrow(double x) {
  return static_cast<double>(static_cast<float>(x));
}

Problem problem_of(const Cloth& c, const Solver& s) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(c.x.size())}, {"m", static_cast<std::int64_t>(c.springs.size())}});
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), w = p.inputs[2].as<float>();
  const auto springs = p.inputs[3].as<std::int32_t>();
  const auto rest = p.inputs[4].as<float>();
  for (std::size_t i = 0; i < c.x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      x[3 * i + d] = static_cast<float>(c.x[i][d]);
      v[3 * i + d] = static_cast<float>(c.v[i][d]);
    }
    w[i] = c.inv_mass.empty() ? 1.0f : static_cast<float>(c.inv_mass[i]);
  }
  for (std::size_t j = 0; j < c.springs.size(); ++j) {
    springs[2 * j] = c.springs[j][0];
    springs[2 * j + 1] = c.springs[j][1];
    rest[j] = static_cast<float>(c.rest[j]);
  }
  p.set_scalar("dt", s.dt);
  p.set_scalar("spring_compliance", s.spring_compliance);
  p.set_scalar("contact_compliance", s.contact_compliance);
  p.set_scalar("thickness", s.thickness);
  p.set_scalar("search_radius", s.radius);
  p.set_scalar("relaxation", s.relaxation);
  p.set_scalar("iters", s.iterations);
  return p;
}

// Moves particles of pairs whose predicted distance is at the search radius a little, until there are none.
void clear_the_radius(Cloth& c, const Solver& s, std::uint64_t seed) {
  const double clear = 1e-5 * s.thickness, radius = narrow(s.radius), dt = narrow(s.dt);
  for (std::size_t i = 0; i < c.x.size(); ++i) {
    pc::round_to_float(c.x[i]);
    pc::round_to_float(c.v[i]);
  }
  for (std::uint64_t round = 0; round < 50; ++round) {
    Positions predicted = c.x;
    for (std::size_t i = 0; i < c.x.size(); ++i) {
      const bool moves = c.inv_mass.empty() || c.inv_mass[i] > 0;
      for (std::size_t d = 0; d < 3 && moves; ++d) predicted[i][d] += dt * c.v[i][d];
    }
    bool any = false;
    for (const auto& [i, j] : pc::near_pairs(predicted, radius + clear)) {
      const auto a = static_cast<std::size_t>(i), b = static_cast<std::size_t>(j);
      const double length = std::hypot(predicted[a][0] - predicted[b][0], predicted[a][1] - predicted[b][1],
                                       predicted[a][2] - predicted[b][2]);
      if (length < radius - clear) continue;
      any = true;
      for (std::size_t d = 0; d < 3; ++d)
        c.x[a][d] = narrow(c.x[a][d] + 1e-3 * s.thickness * uniform11(seed, 200 + round, 3 * a + d));
    }
    if (!any) return;
  }
  pc::fail_to_settle();
}

Cloth rolled(const pc::RolledCloth& parameters, const Solver& solver,
             const std::vector<double>& inv_mass = {}) {
  pc::Cloth made = pc::make_rolled_cloth(parameters);
  Cloth c{std::move(made.position), std::move(made.velocity), inv_mass, std::move(made.springs),
          std::move(made.rest)};
  clear_the_radius(c, solver, parameters.seed);
  return c;
}

pc::RolledCloth roll(std::int64_t rows, std::int64_t columns, std::int64_t free_side, bool hidden) {
  pc::RolledCloth c;
  c.rows = rows;
  c.columns = columns;
  c.free_side = free_side;
  if (hidden) {
    c.start_radius = 6;
    c.turn_gap = 0.42;
    c.strain = 0.006;
    c.periods = 5;
    c.jitter = 0.004;
    c.noise = 0.12;
    c.seed = 2;
  }
  return c;
}

InputSet roll_set(const std::string& name, SetKind kind, Size size, const pc::RolledCloth& c) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about =
      fmt::format("sheet of {} x {} rolled up from radius {} with a gap of {}, {}^3 free particles, seed {}",
                  c.rows, c.columns, c.start_radius, c.turn_gap, c.free_side, c.seed);
  s.make = [c] { return problem_of(rolled(c, {}), {}); };
  return s;
}

// ---- checks ----

Check free_flight(double tolerance) {
  return worst_over(
      {.name = "free_flight",
       .kind = CheckKind::paper,
       .array = "x_new",
       .quantity = "relative L2 error of x_new against x + dt v, of particles that nothing acts on",
       .tolerance = tolerance,
       .why = "the paper's table of inputs and checks"},
      [](const Judged& j) {
        const HostArray &x = input(j, "x"), &v = input(j, "v"), &w = input(j, "inv_mass");
        const HostArray &got = output(j, "x_new"), &expected = truth(j, "x_new");
        const double dt = j.problem.scalar("dt");
        return Items{1, [&, dt](std::int64_t) {
                       double error = 0, square = 0;
                       for (std::int64_t i = 0; i < w.size(); ++i) {
                         double distance = 0, of_truth = 0, length = 0;
                         for (std::int64_t d = 3 * i; d < 3 * i + 3; ++d) {
                           const double flown = x.value(d) + (w.value(i) > 0 ? dt * v.value(d) : 0);
                           of_truth = std::max(of_truth, std::abs(expected.value(d) - flown));
                           distance += (got.value(d) - flown) * (got.value(d) - flown);
                           length += flown * flown;
                         }
                         if (of_truth > 1e-12 * std::sqrt(length)) continue;
                         error += distance;
                         square += length;
                       }
                       return std::sqrt(square > 0 ? error / square : error);
                     }};
      });
}

Check tight_v(double tolerance) {
  return as_invariant(local_error_check("v_new", tolerance, ""), "v_new_tight", tolerance,
                      "what the serial float32 builds show on this set, ten times");
}

// sum (v_new - v) / w over what rounding explains.
Check momentum() {
  return conserved_sum({.name = "momentum",
                        .kind = CheckKind::invariant,
                        .array = "v_new",
                        .quantity = "|sum (v_new - v)/w| / sum |v_new - v|/w",
                        .tolerance = 1e-5,
                        .why = "springs and contacts move their ends by opposite impulses",
                        .needs_truth = false},
                       [](const Judged& j) {
                         const HostArray &v = input(j, "v"), &w = input(j, "inv_mass"),
                                         &got = output(j, "v_new");
                         return Terms{w.size(), [&](std::int64_t i) {
                                        std::array<double, 3> term{0, 0, 0};
                                        if (w.value(i) == 0) return term;
                                        for (std::size_t d = 0; d < 3; ++d) {
                                          const std::int64_t at = 3 * i + static_cast<std::int64_t>(d);
                                          term[d] = (got.value(at) - v.value(at)) / w.value(i);
                                        }
                                        return term;
                                      }};
                       });
}

// Pinned particles keep their positions and have no velocity, whatever v is.
Check pinned_stay() {
  return worst_over({.name = "pinned_stay",
                     .kind = CheckKind::invariant,
                     .array = "x_new, v_new",
                     .quantity = "largest |x_new - x| and |v_new| of particles with w = 0",
                     .tolerance = 0,
                     .why = "a pinned particle keeps its position, and x + 0 = x in any precision",
                     .needs_truth = false},
                    [](const Judged& j) {
                      const HostArray &x = input(j, "x"), &w = input(j, "inv_mass");
                      const HostArray &got = output(j, "x_new"), &v = output(j, "v_new");
                      return Items{x.size(), [&](std::int64_t i) {
                                     if (w.value(i / 3) > 0) return 0.0;
                                     return std::max(std::abs(got.value(i) - x.value(i)),
                                                     std::abs(v.value(i)));
                                   }};
                    });
}

// ---- hard cases ----

constexpr std::int64_t kRows = 37, kColumns = 29;

pc::RolledCloth small_roll(std::uint64_t seed) {
  pc::RolledCloth c = roll(kRows, kColumns, 3, false);
  c.start_radius = 1;  // two turns and a half
  c.seed = seed;
  return c;
}

std::vector<double> masses(std::uint64_t seed) {
  std::vector<double> w;
  for (std::uint64_t i = 0; i < kRows * kColumns + 27; ++i) {
    const double u = uniform01(seed, 50, i);
    w.push_back(u < 0.2 ? 0.0 : std::pow(10.0, 4 * u - 2.4));
  }
  return w;
}

/// Free particles along x that meet; thickness 1, search radius 1.25, relaxation 1/2, dt 1/2, four
/// iterations.
struct KnownGroup {
  std::vector<double> x, v, inv_mass, x_new;
};
std::vector<KnownGroup> known_groups() {
  return {
      {{0, 3}, {0, -5}, {1, 1}, {-0.234375, 0.734375}},  // predicted 1/2 apart: 15/32 of it is closed
      {{0, 3}, {0, -3.5}, {1, 1}, {0, 1.25}},            // predicted at exactly the radius: no contact
      {{0, 3}, {0, -4}, {1, 1}, {0, 1}},                 // predicted at exactly the thickness
      {{0, 3}, {8, -5}, {0, 1}, {0, 0.96875}},           // the first is pinned, whatever its velocity
      {{0, 0.5}, {0, 8}, {1, 1}, {0, 4.5}},  // near at the start, but not where they are predicted
      // Predicted at 0, -1/4 and 5/2: 45/64 of what the first two lack is closed by equal parts.
      {{0, 3, 1.5}, {0, -6.5, 2}, {1, 1, 1}, {0.3515625, -0.6015625, 2.5}},
      {{5}, {-2}, {1}, {4}},
      {{5}, {-2}, {0}, {5}},
      {{-0.0}, {-0.0}, {1}, {-0.0}},
  };
}

Problem known_problem() {
  Cloth c;
  double y = 0;
  for (const KnownGroup& g : known_groups()) {
    for (std::size_t i = 0; i < g.x.size(); ++i) {
      c.x.push_back({g.x[i], y, 0});
      c.v.push_back({g.v[i], 0, -0.0});
      c.inv_mass.push_back(g.inv_mass[i]);
    }
    y += 8;
  }
  c.springs = {{0, 0}};  // a spring from a particle to itself has no effect
  c.rest = {1};
  return problem_of(c, {0.5, 0, 0, 1, 1.25, 0.5, 4});
}

Check known_positions() {
  return equals_known(
      {.name = "known_positions",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "largest distance from the known position, m",
       .tolerance = 0x1p-20,
       .why = "every number is exact in float32; allows for inexact square roots",
       .needs_truth = false},
      [](const Judged&) {
        std::vector<double> known;
        double y = 0;
        for (const KnownGroup& g : known_groups()) {
          for (const double x : g.x_new) known.insert(known.end(), {x, y, 0});
          y += 8;
        }
        return known;
      },
      1);
}

// Free particles shot at the outside of the roll.
Cloth shot_at(const Solver& solver) {
  Cloth c = rolled(small_roll(33), solver);
  const std::size_t sheet = c.x.size();
  for (std::size_t k = 0; k < 200; ++k) {
    const double angle = 0.1 * static_cast<double>(k), y = 14 * uniform11(33, 61, k);
    const double r = 4 + 2 * uniform01(33, 62, k);
    c.x.push_back({r * std::cos(angle), y, r * std::sin(angle)});
    c.v.push_back({-25 * std::cos(angle), 0.5, -25 * std::sin(angle)});
    if (k % 2 == 0)
      c.springs.push_back({static_cast<std::int32_t>(sheet + k), static_cast<std::int32_t>(sheet + k)});
    if (k % 2 == 0) c.rest.push_back(1);
  }
  // Springs from particles of the sheet to themselves: not counted in the valence.
  for (std::int32_t i = 0; i < 300; i += 3) {
    c.springs.push_back({i, i});
    c.rest.push_back(0.5);
  }
  clear_the_radius(c, solver, 33);
  return c;
}

Cloth scaled(Cloth c, double factor) {
  for (Positions* p : {&c.x, &c.v}) {
    for (auto& q : *p) {
      for (double& d : q) d *= factor;
    }
  }
  for (double& r : c.rest) r = narrow(r) * factor;
  return c;
}

Problem far_away() {
  const Solver solver;
  Cloth c = rolled(small_roll(34), solver);
  for (auto& p : c.x) {
    for (double& d : p) d += 1e4;
  }
  clear_the_radius(c, solver, 34);
  return problem_of(c, solver);
}

// Particles of a row with springs to the next ones, and another row beside it, too near.
Cloth two_rows(const Solver& solver) {
  constexpr std::int32_t length = 33000;
  Cloth c;
  for (std::int32_t i = 0; i < 2 * length; ++i) {
    const auto draw = [&](std::uint64_t stream, std::uint64_t d) {
      return uniform11(35, stream, 3 * static_cast<std::uint64_t>(i) + d);
    };
    c.x.push_back({0.4 * (i % 2) + 0.02 * draw(0, 0), i / 2 + 0.02 * draw(0, 1), 0.02 * draw(0, 2)});
    c.v.push_back({0.3 * draw(1, 0), 0.3 * draw(1, 1), 0.3 * draw(1, 2)});
    if (i + 2 < 2 * length) {
      c.springs.push_back({i, i + 2});
      c.rest.push_back(1);
    }
  }
  clear_the_radius(c, solver, 35);
  return c;
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet s) { sets.push_back(std::move(s)); };
  add(hard_case(
      "known_groups",
      "free particles that meet, with known results: predicted at exactly the radius and the thickness, "
      "pinned ones with a velocity",
      known_problem, {known_positions(), pinned_stay()}));
  add(hard_case("two_compliances",
                "contacts softer than springs, odd iterations, a list to twice the thickness",
                [] {
                  const Solver s{0.05, 0.001, 0.02, 0.5, 1, 0.5, 7};
                  return problem_of(rolled(small_roll(21), s), s);
                },
                {momentum(), tight_v(2e-5)}));
  add(hard_case("soft_springs",
                "springs softer than contacts, a list that ends at the thickness, relaxation 1",
                [] {
                  const Solver s{0.2, 1, 0.01, 0.6, 0.6, 1, 3};
                  return problem_of(rolled(small_roll(22), s), s);
                },
                {momentum(), tight_v(2e-5)}));
  add(hard_case("one_iteration", "a single iteration of rigid springs and contacts",
                [] {
                  const Solver s{0.1, 0, 0, 0.55, 0.7, 0.75, 1};
                  return problem_of(rolled(small_roll(23), s), s);
                },
                {momentum(), tight_v(2e-5)}));
  add(hard_case("pinned_and_heavy",
                "a fifth of the particles pinned, with velocities; the others with masses over four decades",
                [] { return problem_of(rolled(small_roll(24), {}, masses(24)), {}); },
                {pinned_stay(), tight_v(5e-5)}));
  add(hard_case("shot_at", "free particles that hit the roll; springs from particles to themselves",
                [] { return problem_of(shot_at({}), {}); }, {momentum(), tight_v(2e-5)}));
  add(hard_case("two_rows", "66,000 particles in two rows beside each other",
                [] { return problem_of(two_rows({}), {}); }, {momentum(), tight_v(5e-5)}));
  add(hard_case("small_scale", "a cloth 2^20 times smaller",
                [] {
                  const Solver s{0.1, 0.005, 0.001, 0.5 * 0x1p-20, 0.625 * 0x1p-20, 0.25, 8};
                  Solver unscaled = s;
                  unscaled.thickness = 0.5;
                  unscaled.radius = 0.625;
                  return problem_of(scaled(rolled(small_roll(25), unscaled), 0x1p-20), s);
                },
                {momentum(), tight_v(2e-5)}));
  add(hard_case(
      "offset_1e4", "a cloth 1e4 m away from the origin along every axis", far_away,
      {pc::within_units_check("x_new", 13, 1,
                              "displacements are known to far less than a unit in the last place, so two "
                              "correct results are the same float32 number or neighbours"),
       momentum(), tight_v(2e-5)},
      false));
  add(hard_case("no_contacts", "a thickness below every distance: springs only",
                [] {
                  const Solver s{0.1, 0.005, 0, 0.01, 0.0125, 0.25, 8};
                  return problem_of(rolled(small_roll(26), s), s);
                },
                {momentum(), tight_v(2e-5)}));
  add(hard_case("one_particle", "n = 1, in free flight",
                [] {
                  Cloth c{{{1, -2, 3}}, {{4, 0.5, -1}}, {}, {{0, 0}}, {1}};
                  return problem_of(c, {0.25, 0.005, 0, 0.5, 0.625, 0.25, 8});
                },
                {}));
  add(hard_case("zero_iterations", "a prediction and nothing else",
                [] {
                  Solver s;
                  s.iterations = 0;
                  return problem_of(rolled(small_roll(27), s, masses(27)), s);
                },
                {pinned_stay(), tight_v(1e-6)}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "XPBD cloth step with springs and self-contact";
  t.paper_number = 14;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      roll_set("public", SetKind::open, Size::paper, roll(1024, 1024, 16, false)),
      roll_set("hidden", SetKind::hidden, Size::paper, roll(1024, 1024, 16, true)),
      roll_set("public_smoke", SetKind::open, Size::smoke, roll(211, 167, 7, false)),
      roll_set("hidden_smoke", SetKind::hidden, Size::smoke, roll(167, 211, 7, true)),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_check("x_new", 2.3e-7, "the paper's table of inputs and checks"),
      relative_l2_check("v_new", 2.6e-4, "the paper's table of inputs and checks"),
      free_flight(1e-5),
      local_error_check(
          "v_new", 1e-3,
          "from displacements, velocities are good to 1e-6 of the rms; from rounded positions single ones "
          "are off by 2.6e-4 of it at |y| = 512 m, which is allowed"),
  };
  t.unordered = {{"n", {"springs"}}, {"m", {}}};
  t.knob = AccuracyKnob{"iters", {1, 2, 4, 8, 16}};
  t.target_floor_multiple = 40;
  return t;
}

}  // namespace gpuphys::xpbd
