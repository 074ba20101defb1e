// Input sets and checks of viscosity_pbf (specification: cases/local_interaction/viscosity_pbf.md).
#include "cases/local_interaction/viscosity_pbf.hpp"

#include <cmath>
#include <numbers>

#include "cases/position_constraint/fluid_checks.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::viscosity_pbf {
namespace {

using fluid::Block, fluid::Particles, fluid::Scalars;

Block public_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice, .seed = 1, .jitter = 0.15, .flow = 1, .flow_length = 8, .noise = 0.15};
}
Block hidden_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 2,
          .corner = {12.5, 12.5, 12.5},
          .jitter = 0.12,
          .flow = 1,
          .flow_length = 7,
          .noise = 0.18};
}

Particles small_block() {
  return fluid::moved(fluid::block(public_block({9, 7, 8})), 1, {-10, -10, -10});
}

// Two particles at h/2: W(h/2) = (27/64) 315/(64 pi h^3).
Check closed_form() {
  return equals_known({.name = "closed_form",
                       .kind = CheckKind::invariant,
                       .array = "v_new",
                       .quantity = "largest error of a component / largest velocity",
                       .tolerance = 3e-7,
                       .why = "rounding of the weight and of the sum, two units in the last place",
                       .needs_truth = false},
                      [](const Judged& j) {
                        const Inputs in = bind_inputs<Inputs>(j.problem);
                        const double weight = 27.0 / 64 * 315 / (64 * std::numbers::pi) /
                                              std::pow(static_cast<double>(in.h), 3) *
                                              static_cast<double>(in.c);
                        std::vector<double> known;
                        for (std::int64_t k = 0; k < 6; ++k) {
                          const double own = in.v.data[k], other = in.v.data[(k + 3) % 6];
                          known.push_back(own + weight * (other - own));
                        }
                        return known;
                      });
}

std::vector<InputSet> hard_sets(const Contract& contract) {
  std::vector<InputSet> sets;
  const auto hard = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        Scalars scalars,
                        std::vector<Check> invariants = fluid::tight("v_new", "v", 1e-5, 1e-4)) {
    sets.push_back(fluid::hard_set(contract, stress, about, std::move(make), scalars, std::move(invariants)));
  };
  hard("coincident", "every fifth particle where another one is, at another velocity",
       [] { return fluid::with_coincident(small_block(), 5); }, {{"h", 2}, {"c", 0.3}});
  hard("crowded", "2000 particles within h of each other",
       [] {
         return fluid::cloud(11, 2000, {0.5, 0.25, -1}, 0.55, 1);
       },
       {{"h", 2}, {"c", 0.001}});
  hard("line_x", "70001 particles in a row along x: a box without width",
       [] { return fluid::line(12, 70001, 0, 1); }, {{"h", 2}, {"c", 0.5}});
  hard("line_z", "3001 particles in a row along z", [] { return fluid::line(13, 3001, 2, 1); },
       {{"h", 2}, {"c", 0.5}});
  hard("far_apart", "five blocks a thousand kilometres apart, which a grid over the box cannot resolve",
       [] {
         Particles all;
         std::uint64_t seed = 31;
         for (const fluid::Vec3& corner :
              {fluid::Vec3{0, 0, 0}, fluid::Vec3{1e6, 0, 0}, fluid::Vec3{-1e6, 1e6, 3},
               fluid::Vec3{0, -1e6, 1e6}, fluid::Vec3{7, 1e3, -1e6}}) {
           Block b = public_block({5, 4, 6});
           b.seed = seed++;
           b.corner = corner;
           all = fluid::joined(std::move(all), fluid::block(b));
         }
         return all;
       },
       {{"h", 2}, {"c", 0.3}});
  hard("offset_1e4", "a block 10 km off the origin, where float32 resolves 1 mm",
       [] {
         Block b = public_block({11, 9, 7});
         b.corner = {-1e4, 1e4, -1e4};
         return fluid::block(b);
       },
       {{"h", 2}, {"c", 0.3}});
  hard("negative_c", "c below zero sharpens differences", small_block, {{"h", 1}, {"c", -0.01}});
  hard("h_1_37", "h of 1.37 m, where cells and lattice have no common measure", small_block,
       {{"h", 1.37}, {"c", 0.1}});
  hard("micrometres", "the block at 2^-20 of its size",
       [] {
         return fluid::moved(small_block(), 0x1p-20, {0, 0, 0});
       },
       {{"h", 0x1p-19}, {"c", 0.25 * 0x1p-60}});
  hard("megametres", "the block at 2^18 of its size",
       [] {
         return fluid::moved(small_block(), 0x1p18, {0, 0, 0});
       },
       {{"h", 0x1p19}, {"c", 0.25 * 0x1p54}});
  hard("fast", "velocities up to 1e10 m/s",
       [] {
         Particles all = small_block();
         for (fluid::Particle& p : all) {
           for (double& v : p.v) v *= 4e9;
         }
         return all;
       },
       {{"h", 2}, {"c", 0.3}});
  hard("faint", "velocities of 1e-30 m/s",
       [] {
         Particles all = small_block();
         for (fluid::Particle& p : all) {
           for (double& v : p.v) v *= 1e-30;
         }
         return all;
       },
       {{"h", 2}, {"c", 0.3}});
  hard("thirty_three", "33 particles: one more than a warp",
       [] {
         return fluid::cloud(14, 33, {0, 0, 0}, 1.5, 1);
       },
       {{"h", 2}, {"c", 0.1}});
  hard("constant_velocity", "nothing to even out",
       [] {
         Particles all = small_block();
         for (fluid::Particle& p : all) p.v = {1.25, -0.0, -3e5};
         return all;
       },
       {{"h", 2}, {"c", 0.3}}, {fluid::unchanged("v_new", "v", "all differences are zero")});
  hard("one_particle", "no neighbour",
       [] {
         return Particles{{{1, 2, 3}, {4, -5, 0}}};
       },
       {{"h", 2}, {"c", 0.3}}, {fluid::unchanged("v_new", "v", "there is nothing to meet")});
  hard("two_particles", "a pair at h/2: the law written out",
       [] {
         return Particles{{{3, 2, 1}, {1, -2, 0.5}}, {{3, 3, 1}, {-1, 0.25, 0}}};
       },
       {{"h", 2}, {"c", 0.75}}, {closed_form()});
  hard("at_h", "a pair at a distance of exactly h",
       [] {
         return Particles{{{3, 2, 1}, {1, -2, 0.5}}, {{3, 2, 3}, {-1, 0.25, 0}}};
       },
       {{"h", 2}, {"c", 1e6}}, {fluid::unchanged("v_new", "v", "h itself is no longer near")});
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "XSPH viscosity of position-based fluid particles";
  t.paper_number = 49;
  t.contract = describe<Inputs, Outputs<float>>();
  const Scalars scalars{{"h", 2}, {"c", 0.01}};
  const auto set = [&](const char* name, SetKind kind, Size size, const Block& b) {
    t.sets.push_back(fluid::block_set(t.contract, name, kind, size, b, scalars));
  };
  set("public", SetKind::open, Size::paper, public_block({160, 160, 160}));
  set("hidden", SetKind::hidden, Size::paper, hidden_block({160, 160, 160}));
  set("public_smoke", SetKind::open, Size::smoke, public_block({37, 29, 33}));
  set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_block({29, 37, 31}));
  for (InputSet& s : hard_sets(t.contract)) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("v_new", "v", 1e-4, "the paper's table of inputs and checks"),
      local_error_of_change("v_new", "v", 1e-3,
                            "two correct results are equal or neighbours in float32: 1.2e-7 m/s below 2 m/s, "
                            "of an rms change of 2e-3 m/s; a lost neighbour is of the size of the rms"),
      fluid::momentum_kept("v_new", "v"),
  };
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 12;
  return t;
}

}  // namespace gpuphys::viscosity_pbf
