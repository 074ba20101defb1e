// Input sets and checks of pbf (specification: cases/position_constraint/pbf.md).
#include "cases/position_constraint/pbf.hpp"

#include <algorithm>
#include <cmath>

#include "cases/position_constraint/fluid_checks.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::pbf {
namespace {

using fluid::Block, fluid::Particle, fluid::Particles;

Block public_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 1,
          .jitter = 0.15,
          .wave = 0.15,
          .wave_length = 16,
          .flow = 1,
          .flow_length = 8};
}
Block hidden_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 2,
          .jitter = 0.12,
          .wave = 0.18,
          .wave_length = 20,
          .flow = 1,
          .flow_length = 10};
}

Particles small_block() {
  return fluid::moved(fluid::block(public_block({9, 7, 8})), 1, {-14, -13, -13.5});
}

// The values of the public set unless named otherwise.
struct Step {
  double h = 2, rho0 = 1.009775, eps = 0.5, k_corr = 0.1, dq = 0.3;
  int iters = 5;
  double dt = 0.1, gx = 0, gy = 0, gz = -1, c_visc = 0.01, vort_eps = 0.083;
};

InputSet with(InputSet s, const Step& step) {
  s.make = [make = std::move(s.make), step] {
    Problem p = make();
    for (const auto& [name, value] :
         std::initializer_list<std::pair<const char*, double>>{{"h", step.h},
                                                               {"rho0", step.rho0},
                                                               {"eps", step.eps},
                                                               {"k_corr", step.k_corr},
                                                               {"dq", step.dq},
                                                               {"iters", step.iters},
                                                               {"dt", step.dt},
                                                               {"gx", step.gx},
                                                               {"gy", step.gy},
                                                               {"gz", step.gz},
                                                               {"c_visc", step.c_visc},
                                                               {"vort_eps", step.vort_eps}}) {
      p.set_scalar(name, value);
    }
    return p;
  };
  return s;
}

// x + dt (v + dt g) and v + dt g: what particles without neighbours do.
Check ballistic(const std::string& array, bool position) {
  return equals_known({.name = array + "_ballistic",
                       .kind = CheckKind::invariant,
                       .array = array,
                       .quantity = "largest error of a component / the largest",
                       .tolerance = 0,
                       .why = "values and time step are powers of two or sums of few: nothing is rounded",
                       .needs_truth = false},
                      [=](const Judged& j) {
                        const Inputs in = bind_inputs<Inputs>(j.problem);
                        const double dt = in.dt, g[3] = {in.gx, in.gy, in.gz};
                        std::vector<double> known;
                        for (std::int64_t k = 0; k < in.x.size(); ++k) {
                          const double v = static_cast<double>(in.v.data[k]) + dt * g[k % 3];
                          known.push_back(position ? static_cast<double>(in.x.data[k]) + dt * v : v);
                        }
                        return known;
                      });
}

// Particles deep inside a perfect lattice at rest see as much on one side as on the other.
Check interior_at_rest() {
  return worst_over({.name = "interior_at_rest",
                     .kind = CheckKind::invariant,
                     .array = "v_new",
                     .quantity = "velocity component more than 4.5 m inside the surface, m/s",
                     .tolerance = 1e-5,
                     .why = "forces of opposite neighbours cancel up to rounding, 1e-7 m over 0.1 s",
                     .needs_truth = false},
                    [](const Judged& j) {
                      const Inputs in = bind_inputs<Inputs>(j.problem);
                      const HostArray& v = output(j, "v_new");
                      return Items{v.size(), [in, &v](std::int64_t k) {
                                     for (std::int64_t c = 0; c < 3; ++c) {
                                       const double x = in.x(k / 3, c), far = c == 0 ? 13 : c == 1 ? 12 : 11;
                                       if (std::min(x, far - x) < 4.5) return 0.0;
                                     }
                                     return v.value(k);
                                   }};
                    });
}

std::vector<Check> tight_step() {
  std::vector<Check> checks = fluid::tight("x_new", "x", 2e-5, 2e-4);
  checks.push_back(as_invariant(relative_l2_check("v_new", 1, ""), "v_new_tight_rel_l2", 1e-5,
                                "small sets are held to ten times less than the paper's size or better"));
  checks.push_back(as_invariant(local_error_check("v_new", 1, ""), "v_new_tight_local", 1e-4,
                                "small sets are held to ten times less than the paper's size or better"));
  return checks;
}

std::vector<InputSet> hard_sets(const Contract& contract) {
  std::vector<InputSet> sets;
  const auto hard = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        const Step& step, std::vector<Check> invariants = tight_step()) {
    sets.push_back(
        with(fluid::hard_set(contract, stress, about, std::move(make), {}, std::move(invariants)), step));
  };
  const auto only = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        const Step& step, std::vector<Check> invariants) {
    hard(stress, about, std::move(make), step, std::move(invariants));
    sets.back().use_task_checks = false;
  };
  hard("crushed", "a block at 0.8 of its spacing: the last move is large",
       [] {
         return fluid::moved(small_block(), 0.8, {0, 0, 0});
       },
       {.iters = 3, .c_visc = 0.05, .vort_eps = 0.5});
  hard("gravity_x", "gravity along x, rest density and relaxation of their own", small_block,
       {.rho0 = 1.2, .eps = 1, .iters = 4, .gx = 30, .gz = 0});
  hard("gravity_y", "gravity along y", small_block,
       {.rho0 = 0.8, .eps = 0.3, .iters = 2, .gy = -20, .gz = 0.5});
  hard("no_viscosity", "c_visc 0", small_block, {.dt = 0.05, .c_visc = 0, .vort_eps = 0.3});
  hard("no_confinement", "vort_eps 0", small_block, {.dt = 0.2, .c_visc = 0.1, .vort_eps = 0});
  hard("strong_confinement", "confinement and viscosity that change velocities by as much as they are",
       small_block, {.iters = 1, .dt = 0.05, .c_visc = 0.5, .vort_eps = 3});
  hard("pressure", "k_corr 0.5 at dq 0.1", small_block, {.k_corr = 0.5, .dq = 0.1});
  hard("no_pressure", "k_corr 0; h of 1.7 m", small_block, {.h = 1.7, .k_corr = 0, .dq = 0.5});
  hard("h_2_5", "h of 2.5 m", small_block, {.h = 2.5, .rho0 = 1, .dq = 0});
  hard("zero_iterations", "iters 0: the velocity stages alone", small_block, {.iters = 0});
  hard("far_thrown", "dt v of several h: predicted positions are far from the given ones",
       [] {
         Particles all = small_block();
         for (Particle& p : all) {
           p.v = {0.5 * p.x[1] + 100, -0.5 * p.x[0], 40 + 0.1 * p.x[2]};
         }
         return all;
       },
       {.iters = 2, .gz = -100});
  hard("line_z", "201 particles in a row along z", [] { return fluid::line(52, 201, 2, 1); },
       {.rho0 = 0.4, .iters = 2});
  hard("coincident", "every fifth particle where another one is, with its velocity; one iteration",
       [] {
         Particles all = small_block();
         for (std::size_t i = 1; i < all.size(); i += 5) all[i] = all[i - 1];
         return all;
       },
       {.iters = 1});
  hard("thirty_three", "33 particles: one more than a warp",
       [] {
         return fluid::block(
             {.lattice = {1, 3, 11}, .seed = 55, .corner = {0, 0, 0}, .jitter = 0.2, .noise = 1});
       },
       {.rho0 = 0.6, .iters = 3});
  hard("millimetres", "the block at 2^-10 of its size",
       [] {
         Particles all = fluid::moved(small_block(), 0x1p-10, {0, 0, 0});
         for (Particle& p : all) {
           for (double& v : p.v) v *= 0x1p-10;
         }
         return all;
       },
       {.h = 0x1p-9,
        .rho0 = 1.009775 * 0x1p30,
        .eps = 0.5 * 0x1p20,
        .k_corr = 0.1 * 0x1p-20,
        .gz = -0x1p-10,
        .c_visc = 0.01 * 0x1p-30,
        .vort_eps = 0.083 * 0x1p-40});
  only("offset_1e4", "a block 10 km off the origin, where float32 resolves 1 mm",
       [] {
         Block b = public_block({11, 9, 7});
         b.corner = {-1e4, 1e4, -1e4};
         return fluid::block(b);
       },
       {}, {fluid::equal_or_next("x_new"), relative_l2_check("v_new", 3e-4, "the paper's table")});
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
       {.iters = 1}, {fluid::equal_or_next("x_new"), relative_l2_check("v_new", 3e-4, "the paper's table")});
  only("lattice_at_rest", "a perfect lattice at its rest density, without gravity",
       [] {
         return fluid::block({.lattice = {14, 13, 12}, .corner = {0, 0, 0}});
       },
       {.iters = 1, .gz = 0}, {interior_at_rest()});
  hard("one_particle", "no neighbour: x + dt (v + dt g)",
       [] {
         return Particles{{{1, 2, 3}, {4, -5, 0}}};
       },
       {.dt = 0.125, .gx = 0.5, .gy = 2, .gz = -8}, {ballistic("x_new", true), ballistic("v_new", false)});
  hard("meet_at_h", "two particles that are predicted to be exactly h apart",
       [] {
         return Particles{{{3, 2, 1}, {0, 0, -1}}, {{3, 2, 2.75}, {0, 0, 1}}};
       },
       {.dt = 0.125, .gz = -4}, {ballistic("x_new", true), ballistic("v_new", false)});
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "A step of a position-based fluid";
  t.paper_number = 11;
  t.contract = describe<Inputs, Outputs<float>>();
  const auto set = [&](const char* name, SetKind kind, Size size, const Block& b, double vort_eps) {
    t.sets.push_back(with(fluid::block_set(t.contract, name, kind, size, b, {}), {.vort_eps = vort_eps}));
  };
  set("public", SetKind::open, Size::paper, public_block({160, 160, 160}), 0.083);
  set("hidden", SetKind::hidden, Size::paper, hidden_block({160, 160, 160}), 0.104);
  set("public_smoke", SetKind::open, Size::smoke, public_block({27, 21, 23}), 0.083);
  set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_block({21, 25, 27}), 0.104);
  for (InputSet& s : hard_sets(t.contract)) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("x_new", "x", 2e-3, "the paper's table of inputs and checks"),
      relative_l2_check("v_new", 3e-4, "the paper's table of inputs and checks"),
      local_error_of_change(
          "x_new", "x", 5e-3,
          "two correct results are equal or neighbours in float32: 1.5e-5 m above 128 m, of "
          "an rms change near 0.1 m"),
      local_error_check("v_new", 1e-3,
                        "the displacement over the time step; where positions are rounded before, 1.5e-5 m "
                        "over 0.1 s is 1e-4 of the rms velocity"),
  };
  t.knob = AccuracyKnob{"iters", {1, 2, 3, 4, 5}};
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 70;
  return t;
}

}  // namespace gpuphys::pbf
