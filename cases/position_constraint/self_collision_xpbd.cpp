// Input sets, checks and hard cases of self_collision_xpbd (specification:
// cases/position_constraint/self_collision_xpbd.md).
#include "cases/position_constraint/self_collision_xpbd.hpp"

#include <fmt/format.h>

#include <cmath>

#include "cases/position_constraint/contact_inputs.hpp"
#include "cases/position_constraint/spring_inputs.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::self_collision_xpbd {
namespace {

namespace pc = position_constraint;
using pc::FoldedSheet;
using pc::Positions;

struct Solver {
  double thickness = 0.65, radius = 1.25 * 0.65, compliance = 0, dt = 0.1, relaxation = 0.25;
  int iterations = 8;
};

Problem problem_of(const Positions& x, const Solver& solver, const std::vector<double>& inv_mass = {}) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"n", static_cast<std::int64_t>(x.size())}});
  const auto to = p.inputs[0].as<float>(), w = p.inputs[1].as<float>();
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) to[3 * i + d] = static_cast<float>(x[i][d]);
    w[i] = inv_mass.empty() ? 1.0f : static_cast<float>(inv_mass[i]);
  }
  p.set_scalar("thickness", solver.thickness);
  p.set_scalar("search_radius", solver.radius);
  p.set_scalar("compliance", solver.compliance);
  p.set_scalar("dt", solver.dt);
  p.set_scalar("relaxation", solver.relaxation);
  p.set_scalar("iters", solver.iterations);
  return p;
}

FoldedSheet sheet(std::int64_t rows, std::int64_t columns, std::int64_t width, bool hidden) {
  FoldedSheet f;
  f.rows = rows;
  f.columns = columns;
  f.width = width;
  if (hidden) {
    f.gap = 0.68;
    f.warp = 0.40;
    f.periods = 2;
    f.jitter = 0.018;
    f.seed = 2;
  }
  return f;
}

Problem folded(const FoldedSheet& f, const Solver& solver = {}, const std::vector<double>& inv_mass = {}) {
  return problem_of(pc::folded_sheet(f, solver.radius, solver.thickness), solver, inv_mass);
}

InputSet sheet_set(const std::string& name, SetKind kind, Size size, const FoldedSheet& f) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("sheet of {} x {} folded into layers of {} rows {:.2f} m apart, seed {}", f.rows,
                        f.columns, f.width, f.gap, f.seed);
  s.make = [f] { return folded(f); };
  return s;
}

// ---- hard cases ----

FoldedSheet small_sheet(std::uint64_t seed) {
  FoldedSheet f = sheet(60, 37, 20, false);
  f.seed = seed;
  return f;
}

/// Two to three particles along x with nothing else near; thickness 1, search radius 1.25, relaxation 1/2.
struct KnownGroup {
  std::vector<double> x, inv_mass, x_new;
};

constexpr int kKnownSweeps = 4;

// Each sweep closes half of what is left: after four, of a gap of c remains c/16.
std::vector<KnownGroup> known_groups() {
  return {
      {{0, 1}, {1, 1}, {0, 1}},                     // at exactly the thickness
      {{0, 0.5}, {1, 1}, {-0.234375, 0.734375}},    // 0.46875 of the gap of 0.5, half each
      {{0, 0.5}, {0, 1}, {0, 0.96875}},             // one end pinned
      {{0, 0.5}, {1, 3}, {-0.1171875, 0.8515625}},  // the lighter one moves three times as far
      {{0, 0.5}, {0, 0}, {0, 0.5}},                 // both pinned
      {{0, 1.125}, {1, 1}, {0, 1.125}},             // in the list, farther than the thickness: no pull
      {{0, 0}, {1, 1}, {0, 0}},                     // coincident
      {{-0.25, 0, 1.25},
       {1, 1, 1},
       {-0.6015625, 0.3515625, 1.25}},  // the third is at exactly the radius: no contact
      {{-1, 0, 1}, {1, 1, 1}, {-1, 0, 1}},
      {{-0.5, 0, 0.5}, {1, 0, 1}, {-0.96875, 0, 0.96875}},  // between two, pinned
      {{-0.0}, {1}, {-0.0}},
  };
}

Problem known_problem() {
  Positions x;
  std::vector<double> w;
  double y = 0;
  for (const KnownGroup& g : known_groups()) {
    for (std::size_t i = 0; i < g.x.size(); ++i) {
      x.push_back({g.x[i], y, -0.0});
      w.push_back(g.inv_mass[i]);
    }
    y += 8;
  }
  return problem_of(x, {1, 1.25, 0, 0.5, 0.5, kKnownSweeps}, w);
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

// `count` particles in a ball.
Positions ball(std::int64_t count, double radius, const Solver& solver, std::uint64_t seed) {
  return pc::clear_of_radius(count, solver.radius, 1e-5 * solver.thickness, [=](std::int64_t i, int attempt) {
    for (std::uint64_t k = 0;; ++k) {
      std::array<double, 3> p;
      double square = 0;
      for (std::size_t d = 0; d < 3; ++d) {
        p[d] = radius * uniform11(seed, 100 * static_cast<std::uint64_t>(attempt) + k,
                                  3 * static_cast<std::uint64_t>(i) + d);
        square += p[d] * p[d];
      }
      if (square <= radius * radius) return p;
    }
  });
}

// A row of particles closer than the thickness.
Positions row(std::int64_t count, const Solver& solver) {
  return pc::clear_of_radius(count, solver.radius, 1e-5 * solver.thickness, [=](std::int64_t i, int attempt) {
    const auto draw = [&](std::uint64_t d) {
      return 0.1 * uniform11(37, static_cast<std::uint64_t>(attempt), 3 * static_cast<std::uint64_t>(i) + d);
    };
    return std::array<double, 3>{draw(0), 0.9 * static_cast<double>(i) + draw(1), draw(2)};
  });
}

std::vector<double> masses(std::size_t n) {
  std::vector<double> w;
  for (std::size_t i = 0; i < n; ++i) {
    const double u = uniform01(38, 50, i);
    w.push_back(u < 0.2 ? 0.0 : std::pow(10.0, 4 * u - 2.4));
  }
  return w;
}

Check tight(double tolerance) {
  return as_invariant(local_error_of_change("x_new", "x", tolerance, ""), "x_new_change_tight", tolerance,
                      "what the serial float32 builds show on this set, ten times");
}

Check tight_l2() {
  return as_invariant(relative_l2_of_change("x_new", "x", 1e-5, ""), "x_new_change_tight_l2", 1e-5,
                      "what the serial float32 builds show on this set, ten times");
}

Problem scaled(double factor) {
  Solver solver;
  Positions x = pc::folded_sheet(small_sheet(31), solver.radius, solver.thickness);
  for (auto& p : x) {
    for (double& c : p) c *= factor;
  }
  solver.thickness = static_cast<double>(static_cast<float>(solver.thickness)) * factor;
  solver.radius = static_cast<double>(static_cast<float>(solver.radius)) * factor;
  return problem_of(x, solver);
}

Problem far_away() {
  const Solver solver;
  const FoldedSheet f = small_sheet(32);
  const Positions near = pc::folded_sheet(f, solver.radius, solver.thickness);
  return problem_of(
      pc::clear_of_radius(static_cast<std::int64_t>(near.size()), solver.radius, 1e-5 * solver.thickness,
                          [&](std::int64_t i, int attempt) {
                            std::array<double, 3> p = near[static_cast<std::size_t>(i)];
                            for (std::size_t d = 0; d < 3; ++d)
                              p[d] += 1e4 + (attempt > 0 ? 0.01 : 0) *
                                                uniform11(39, static_cast<std::uint64_t>(attempt),
                                                          3 * static_cast<std::uint64_t>(i) + d);
                            return p;
                          }),
      solver);
}

std::vector<InputSet> hard_sets() {
  const Check still = pc::unmoved_check(0, "nothing acts on any particle, and x + 0 = x in any precision");
  std::vector<InputSet> sets;
  const auto add = [&](InputSet s) { sets.push_back(std::move(s)); };
  add(hard_case(
      "known_groups",
      "two or three particles each, with known results: at exactly the thickness and the radius, pinned, "
      "unequal masses, coincident",
      known_problem, {known_positions(), pc::pinned_check()}));
  add(hard_case("compliant", "alpha~ = 1, nine sweeps of relaxation 1/2, list to twice the thickness",
                [] {
                  return folded(small_sheet(21), {0.65, 1.3, 0.01, 0.1, 0.5, 9});
                },
                {pc::momentum_check(), tight(3e-4), tight_l2()}));
  add(hard_case("soft", "alpha~ = 2.5, relaxation 1, list that ends at the thickness",
                [] {
                  return folded(small_sheet(22), {0.7, 0.7, 10, 2, 1, 5});
                },
                {pc::momentum_check(), tight(3e-4), tight_l2()}));
  add(hard_case("one_sweep", "a single sweep, alpha~ = 40",
                [] {
                  return folded(small_sheet(23), {0.8, 1, 0.1, 0.05, 0.75, 1});
                },
                {pc::momentum_check(), tight(3e-4), tight_l2()}));
  add(hard_case("pinned_and_heavy",
                "a fifth of the particles pinned, the others with masses over four decades",
                [] {
                  const FoldedSheet f = small_sheet(24);
                  return folded(f, {}, masses(static_cast<std::size_t>(f.rows * f.columns)));
                },
                {pc::pinned_check(), tight(3e-4), tight_l2()}));
  add(hard_case(
      "light_between_heavy",
      "stacks of three whose middle one is a thousand times lighter; two in one point that a third one parts",
      [] {
        Positions x;
        std::vector<double> w;
        for (int k = 0; k < 50; ++k) {
          for (int l = 0; l < 3; ++l) {
            x.push_back({3.0 * k, 0.01 * uniform11(25, 0, static_cast<std::uint64_t>(3 * k + l)), 0.6 * l});
            w.push_back(l == 1 ? 1000 : 1);
          }
        }
        // And two in one point, of different masses, that a third one pushes apart: no contact of each other.
        for (int k = 0; k < 20; ++k) {
          for (int l = 0; l < 3; ++l) {
            x.push_back({3.0 * k, 8, l < 2 ? 0.0 : 0.4});
            w.push_back(l == 0 ? 1 : l == 1 ? 3 : 0.5);
          }
        }
        return problem_of(x, {1, 1.1, 0, 0.1, 0.25, 8}, w);
      },
      {pc::momentum_check()}));
  add(hard_case("ball", "200 particles in a ball of a tenth of the thickness: 199 contacts each",
                [] {
                  const Solver solver{1, 1.25, 0, 0.1, 0.02, 8};
                  return problem_of(ball(200, 0.1, solver, 26), solver);
                },
                {pc::momentum_check()}));
  add(hard_case(
      "row", "70,001 particles in a row, each too near to its neighbours",
      [] {
        const Solver solver{1, 1.5, 0, 0.1, 0.25, 3};
        return problem_of(row(70001, solver), solver);
      },
      {pc::within_units_check("x_new", 15, 1, "as for hard_offset_1e4: coordinates reach 63,000 m")}, false));
  add(hard_case("small_scale", "a sheet 2^20 times smaller", [] { return scaled(0x1p-20); },
                {pc::momentum_check(), tight(3e-4), tight_l2()}));
  add(hard_case("large_scale", "a sheet 8192 times as large", [] { return scaled(0x1p13); },
                {pc::momentum_check(), tight(3e-4), tight_l2()}));
  add(hard_case(
      "offset_1e4", "a sheet 1e4 m away from the origin along every axis", far_away,
      {pc::within_units_check("x_new", 13, 1,
                              "displacements are known to far less than a unit in the last place, so two "
                              "correct results are the same float32 number or neighbours"),
       pc::momentum_check()},
      false));
  add(hard_case("no_contacts", "layers farther apart than the search radius",
                [] {
                  FoldedSheet f = small_sheet(27);
                  f.gap = 1.5;
                  return folded(f);
                },
                {still}));
  add(hard_case("one_particle", "n = 1", [] { return problem_of({{1, -2, 3}}, {}); }, {still}));
  add(hard_case("zero_iterations", "contacts, and no sweep to do",
                [] {
                  return folded(small_sheet(28), {0.65, 0.8125, 0, 0.1, 0.25, 0});
                },
                {still}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "XPBD self-collision of cloth particles (Jacobi)";
  t.paper_number = 13;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      sheet_set("public", SetKind::open, Size::paper, sheet(1024, 1024, 128, false)),
      sheet_set("hidden", SetKind::hidden, Size::paper, sheet(1024, 1024, 128, true)),
      sheet_set("public_smoke", SetKind::open, Size::smoke, sheet(200, 233, 40, false)),
      sheet_set("hidden_smoke", SetKind::hidden, Size::smoke, sheet(210, 187, 42, true)),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("x_new", "x", 2e-3, "the paper's table of inputs and checks"),
      pc::left_in_place_check(1e-6, "the paper's table of inputs and checks"),
      local_error_of_change(
          "x_new", "x", 1e-2,
          "float32 numbers at |y| < 512 m are up to 3.05e-5 m apart, 1e-3 of the rms displacement, "
          "and two correct results are equal or neighbours"),
  };
  t.unordered = {{"n", {}}};
  t.knob = AccuracyKnob{"iters", {1, 2, 4, 8, 16}};
  t.target_floor_multiple = 35;
  return t;
}

}  // namespace gpuphys::self_collision_xpbd
