// Input sets and checks of solve_constraint_pbf (specification:
// cases/position_constraint/solve_constraint_pbf.md).
#include "cases/position_constraint/solve_constraint_pbf.hpp"

#include <cmath>
#include <numbers>

#include "cases/position_constraint/fluid_checks.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::solve_constraint_pbf {
namespace {

using fluid::Block, fluid::Particles;

Block public_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice, .seed = 1, .jitter = 0.15, .wave = 0.3, .wave_length = 16};
}
Block hidden_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice, .seed = 2, .jitter = 0.12, .wave = 0.26, .wave_length = 20};
}

Particles small_block() {
  return fluid::moved(fluid::block(public_block({9, 7, 8})), 1, {-14, -13, -13.5});
}

// The values of the paper's sets unless named otherwise.
struct Law {
  double h = 2, rho0 = 1.009775, eps = 0.5, k_corr = 0.1, dq = 0.3;
  int iters = 5;
};

InputSet with(InputSet s, const Law& law) {
  s.make = [make = std::move(s.make), law] {
    Problem p = make();
    p.set_scalar("h", law.h);
    p.set_scalar("rho0", law.rho0);
    p.set_scalar("eps", law.eps);
    p.set_scalar("k_corr", law.k_corr);
    p.set_scalar("dq", law.dq);
    p.set_scalar("iters", law.iters);
    return p;
  };
  return s;
}

// Two particles at a distance of 1 along an axis, h = 2, one iteration.
Check closed_form() {
  return equals_known(
      {.name = "closed_form",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "largest error of a coordinate / 0.1 m",
       .tolerance = 3e-6,
       .why = "coordinates below 1 m are rounded to 3e-8 m; the law adds a few units in the last place",
       .needs_truth = false},
      [](const Judged& j) {
        const Inputs in = bind_inputs<Inputs>(j.problem);
        const double rho0 = in.rho0, eps = in.eps, k_corr = in.k_corr, dq = in.dq;
        const double w0 = 315 / (64 * std::numbers::pi * 8), w1 = w0 * 27 / 64;
        const double slope = 45 / (std::numbers::pi * 16) / 4 / rho0;
        const double lambda = -((w0 + w1) / rho0 - 1) / (2 * slope * slope + eps);
        const double pressure = -k_corr * std::pow(0.75 / (1 - dq * dq), 12);
        std::vector<double> known;
        for (std::int64_t k = 0; k < 6; ++k) {
          const double own = in.x.data[k], other = in.x.data[(k + 3) % 6];
          known.push_back(own - slope * (2 * lambda + pressure) * (own - other));
        }
        return known;
      },
      0.1);
}

std::vector<InputSet> hard_sets(const Contract& contract) {
  std::vector<InputSet> sets;
  const auto hard = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        const Law& law,
                        std::vector<Check> invariants = fluid::tight("x_new", "x", 5e-5, 5e-4)) {
    sets.push_back(
        with(fluid::hard_set(contract, stress, about, std::move(make), {}, std::move(invariants)), law));
  };
  // Beside the task's own: tight bounds, but no comparison with the truth.
  const auto only = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        const Law& law, std::vector<Check> invariants) {
    hard(stress, about, std::move(make), law, std::move(invariants));
    sets.back().use_task_checks = false;
  };
  hard("crushed", "a block at 0.8 of its spacing: density 1.9 times the rest density",
       [] {
         return fluid::moved(small_block(), 0.8, {0, 0, 0});
       },
       {.iters = 6});
  hard("stretched", "a block at 1.3 times its spacing: C below zero pulls",
       [] {
         return fluid::moved(small_block(), 1.3, {0, 0, 0});
       },
       {.iters = 3});
  hard("dense_rest", "twice the rest density", small_block, {.rho0 = 2.01955, .iters = 2});
  hard("thin_rest", "half the rest density", small_block, {.rho0 = 0.5048875, .iters = 2});
  hard("soft", "eps 5", small_block, {.eps = 5});
  hard("stiff", "eps 0.05: iterations overshoot", small_block, {.eps = 0.05, .iters = 3});
  hard("no_pressure", "k_corr 0", small_block, {.k_corr = 0});
  hard("pressure_at_0", "dq 0 and a pressure that dominates", small_block, {.k_corr = 3, .dq = 0},
       fluid::tight("x_new", "x", 1e-4, 2e-3));
  hard("pressure_at_half", "dq 0.5", small_block, {.dq = 0.5});
  hard("h_1_5", "h of 1.5 m", small_block, {.h = 1.5, .rho0 = 1.1});
  hard("h_2_7", "h of 2.7 m: 80 neighbours", small_block, {.h = 2.7, .rho0 = 1.0, .iters = 7});
  hard(
      "line_x", "201 particles in a row along x: a box without width",
      [] { return fluid::line(42, 201, 0, 0); }, {.rho0 = 0.4, .iters = 2},
      fluid::tight("x_new", "x", 1e-4, 1e-3));
  hard(
      "line_z", "201 particles in a row along z", [] { return fluid::line(43, 201, 2, 0); },
      {.rho0 = 0.4, .iters = 2}, fluid::tight("x_new", "x", 1e-4, 1e-3));
  hard("crowded", "1000 particles within h of each other, one iteration",
       [] {
         return fluid::cloud(44, 1000, {0.5, 0.25, -1}, 0.55, 0);
       },
       {.rho0 = 100, .iters = 1});
  hard("coincident", "every fifth particle where another one is, one iteration",
       [] { return fluid::with_coincident(small_block(), 5); }, {.iters = 1});
  hard("millimetres", "the block at 2^-10 of its size",
       [] {
         return fluid::moved(small_block(), 0x1p-10, {0, 0, 0});
       },
       {.h = 0x1p-9, .rho0 = 1.009775 * 0x1p30, .eps = 0.5 * 0x1p20, .k_corr = 0.1 * 0x1p-20});
  hard("kilometres", "the block at 2^8 of its size",
       [] {
         return fluid::moved(small_block(), 0x1p8, {0, 0, 0});
       },
       {.h = 0x1p9, .rho0 = 1.009775 * 0x1p-24, .eps = 0.5 * 0x1p-16, .k_corr = 0.1 * 0x1p16});
  hard("thirty_three", "33 particles: one more than a warp",
       [] {
         return fluid::block({.lattice = {1, 3, 11}, .seed = 45, .corner = {0, 0, 0}, .jitter = 0.2});
       },
       {.rho0 = 0.6});
  only("far_apart", "blocks a thousand kilometres apart, where float32 resolves 1/8 m",
       [] {
         Particles all;
         for (const fluid::Vec3& corner :
              {fluid::Vec3{0, 0, 0}, fluid::Vec3{-1e6, 1e6, 3}, fluid::Vec3{7, 1e3, -1e6}}) {
           Block b = public_block({5, 6, 7});
           b.corner = corner;
           all = fluid::joined(std::move(all), fluid::block(b));
         }
         return all;
       },
       {.iters = 2}, {fluid::equal_or_next("x_new"), fluid::momentum_kept("x_new", "x")});
  only("offset_1e4", "a block 10 km off the origin, where float32 resolves 1 mm",
       [] {
         Block b = public_block({11, 9, 7});
         b.corner = {-1e4, 1e4, -1e4};
         return fluid::block(b);
       },
       {}, {fluid::equal_or_next("x_new"), fluid::momentum_kept("x_new", "x")});
  only("coincident_often", "coincident particles over five iterations: rounding decides whether they part",
       [] { return fluid::with_coincident(small_block(), 5); }, {},
       {fluid::momentum_kept("x_new", "x"),
        within("x_new", -30, 30, "nothing is thrown out of the block's surroundings", "bounded")});
  hard("zero_iterations", "iters 0", small_block, {.iters = 0},
       {fluid::unchanged("x_new", "x", "no iteration, no move")});
  hard("one_particle", "no neighbour: lambda is finite, nothing moves",
       [] {
         return Particles{{{1, 2, 3}, {}}};
       },
       {}, {fluid::unchanged("x_new", "x", "no gradient to move along")});
  hard("at_h", "a pair at a distance of exactly h, and a third one alone",
       [] {
         return Particles{{{3, 2, 1}, {}}, {{3, 2, 3}, {}}, {{-8, 2, 3}, {}}};
       },
       {}, {fluid::unchanged("x_new", "x", "the gradient is zero at h")});
  hard("two_particles", "a pair at h/2: one iteration written out",
       [] {
         return Particles{{{0.5, 0.25, 0}, {}}, {{-0.5, 0.25, 0}, {}}};
       },
       {.rho0 = 0.7, .eps = 0.25, .k_corr = 0.05, .dq = 0.25, .iters = 1}, {closed_form()});
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Density constraints of position-based fluid particles, projected by Jacobi iterations";
  t.paper_number = 10;
  t.contract = describe<Inputs, Outputs<float>>();
  const auto set = [&](const char* name, SetKind kind, Size size, const Block& b) {
    t.sets.push_back(with(fluid::block_set(t.contract, name, kind, size, b, {}), {}));
  };
  set("public", SetKind::open, Size::paper, public_block({160, 160, 160}));
  set("hidden", SetKind::hidden, Size::paper, hidden_block({160, 160, 160}));
  set("public_smoke", SetKind::open, Size::smoke, public_block({27, 21, 23}));
  set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_block({21, 25, 27}));
  for (InputSet& s : hard_sets(t.contract)) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("x_new", "x", 1e-3, "the paper's table of inputs and checks"),
      local_error_of_change(
          "x_new", "x", 5e-3,
          "two correct results are equal or neighbours in float32: 1.5e-5 m above 128 m, of "
          "an rms change near 0.1 m; a lost neighbour is worth a tenth of the rms"),
      fluid::momentum_kept("x_new", "x"),
  };
  t.knob = AccuracyKnob{"iters", {1, 2, 3, 4, 5}};
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 90;
  return t;
}

}  // namespace gpuphys::solve_constraint_pbf
