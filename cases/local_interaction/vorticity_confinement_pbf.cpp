// Input sets and checks of vorticity_confinement_pbf (specification:
// cases/local_interaction/vorticity_confinement_pbf.md).
#include "cases/local_interaction/vorticity_confinement_pbf.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "cases/position_constraint/fluid_checks.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::vorticity_confinement_pbf {
namespace {

using fluid::Block, fluid::Particle, fluid::Particles, fluid::Scalars;

Block public_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice, .seed = 1, .jitter = 0.15, .flow = 1, .flow_length = 16};
}
Block hidden_block(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 2,
          .corner = {12.5, 12.5, 12.5},
          .jitter = 0.13,
          .flow = 1,
          .flow_length = 13};
}

Particles small_block() {
  return fluid::moved(fluid::block(public_block({9, 7, 8})), 1, {-10, -10, -10});
}
Particles with_speed(Particles all, double factor) {
  for (Particle& p : all) {
    for (double& v : p.v) v *= factor;
  }
  return all;
}

constexpr double kTurn = 0.5;  // of the rigid rotation, rad/s

// |dv| <= dt epsilon |omega|, and no particle's omega exceeds that of terms that all point one way.
Check rotation_bound() {
  return worst_over(
      {.name = "confinement_bound",
       .kind = CheckKind::invariant,
       .array = "v_new",
       .quantity = "|v_new - v| / (dt epsilon sum of |(v_j - v_i)| |grad W|)",
       .tolerance = 1,
       .why = "|N| is at most 1; where vorticity is uniform, N is a direction made of rounding and must not "
              "become more",
       .needs_truth = false},
      [](const Judged& j) {
        const Inputs in = bind_inputs<Inputs>(j.problem);
        const HostArray& after = output(j, "v_new");
        const double h = in.h;
        // Of a particle inside the lattice of spacing 1, at 26 distances below 2.
        double terms = 0;
        for (const auto& [count, r] : {std::pair{6, 1.0}, {12, std::sqrt(2.0)}, {8, std::sqrt(3.0)}}) {
          terms += count * kTurn * r * 45 / (std::numbers::pi * std::pow(h, 4)) * std::pow(1 - r / h, 2);
        }
        const double bound = static_cast<double>(in.dt) * static_cast<double>(in.epsilon) * terms;
        return Items{after.shape()[0], [=, &after](std::int64_t i) {
                       double square = 0;
                       for (std::int64_t c = 0; c < 3; ++c) {
                         const double d = after.value(3 * i + c) - static_cast<double>(in.v.data[3 * i + c]);
                         square += d * d;
                       }
                       return std::sqrt(square) / bound;
                     }};
      });
}

std::vector<InputSet> hard_sets(const Contract& contract) {
  std::vector<InputSet> sets;
  const auto hard = [&](const std::string& stress, const std::string& about, std::function<Particles()> make,
                        Scalars scalars,
                        std::vector<Check> invariants = fluid::tight("v_new", "v", 2e-5, 2e-4)) {
    sets.push_back(fluid::hard_set(contract, stress, about, std::move(make), scalars, std::move(invariants)));
  };
  hard("faint", "a flow of 1e-4 m/s, where the regulariser of N counts",
       [] { return with_speed(small_block(), 1e-4); }, {{"h", 2}, {"epsilon", 1.7}, {"dt", 0.1}});
  hard("fast", "velocities up to 1e6 m/s", [] { return with_speed(small_block(), 4e5); },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.02}});
  hard("coincident", "every fifth particle where another one is, at another velocity",
       [] { return fluid::with_coincident(small_block(), 5); }, {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}});
  hard(
      "crowded", "500 particles within h of each other",
      [] {
        return fluid::cloud(21, 500, {0.5, 0.25, -1}, 0.55, 1);
      },
      {{"h", 2}, {"epsilon", 0.001}, {"dt", 0.05}}, fluid::tight("v_new", "v", 5e-5, 1e-3));
  hard("line_x", "2001 particles in a row along x: a box without width",
       [] { return fluid::line(22, 2001, 0, 1); }, {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}});
  hard("line_z", "2001 particles in a row along z", [] { return fluid::line(23, 2001, 2, 1); },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}});
  hard("far_apart", "blocks a thousand kilometres apart, which a grid over the box cannot resolve",
       [] {
         Particles all;
         std::uint64_t seed = 31;
         for (const fluid::Vec3& corner :
              {fluid::Vec3{0, 0, 0}, fluid::Vec3{-1e6, 1e6, 3}, fluid::Vec3{7, 1e3, -1e6}}) {
           Block b = public_block({5, 6, 7});
           b.seed = seed++;
           b.corner = corner;
           all = fluid::joined(std::move(all), fluid::block(b));
         }
         return all;
       },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}});
  hard("offset_1e4", "a block 10 km off the origin, where float32 resolves 1 mm",
       [] {
         Block b = public_block({11, 9, 7});
         b.corner = {-1e4, 1e4, -1e4};
         return fluid::block(b);
       },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}});
  hard("h_1_37", "h of 1.37 m; confinement that damps, epsilon below zero", small_block,
       {{"h", 1.37}, {"epsilon", -0.5}, {"dt", 0.1}});
  hard("millimetres", "the block at 2^-10 of its size: |grad W| of 1e12",
       [] {
         return fluid::moved(small_block(), 0x1p-10, {0, 0, 0});
       },
       {{"h", 0x1p-9}, {"epsilon", 0.5 * 0x1p-40}, {"dt", 0.1}});
  hard("kilometres", "the block at 2^8 of its size",
       [] {
         return fluid::moved(small_block(), 0x1p8, {0, 0, 0});
       },
       {{"h", 0x1p9}, {"epsilon", 1e6}, {"dt", 0.5}});
  hard("thirty_three", "33 particles: one more than a warp",
       [] {
         return fluid::cloud(24, 33, {0, 0, 0}, 1.5, 1);
       },
       {{"h", 2}, {"epsilon", 0.3}, {"dt", 0.1}});
  hard("constant_velocity", "no vorticity at all: 0/0 without the regulariser",
       [] {
         Particles all = small_block();
         for (Particle& p : all) p.v = {1.25, -0.0, -3e5};
         return all;
       },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}},
       {fluid::unchanged("v_new", "v", "all differences are zero")});
  hard("at_rest", "velocities of zero", [] { return with_speed(small_block(), 0); },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}},
       {fluid::unchanged("v_new", "v", "all differences are zero")});
  hard("one_particle", "no neighbour",
       [] {
         return Particles{{{1, 2, 3}, {4, -5, 0}}};
       },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}},
       {fluid::unchanged("v_new", "v", "there is nothing to meet")});
  hard("two_particles", "a pair alone: both have the same vorticity, so its size has no slope",
       [] {
         return Particles{{{3, 2, 1}, {1, -2, 0.5}}, {{3.25, 2.5, 1.125}, {-1, 0.25, 0}}};
       },
       {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}},
       {fluid::unchanged("v_new", "v", "the vorticities of the two are equal bit by bit")});
  InputSet rotation = fluid::hard_set(
      contract, "rigid_rotation", "uniform vorticity: the direction of its slope is made of rounding",
      [] {
        Particles all = fluid::block({.lattice = {9, 8, 7}, .corner = {-4, -3.5, -3}});
        for (Particle& p : all) p.v = {-kTurn * p.x[1], kTurn * p.x[0], 0};
        return all;
      },
      {{"h", 2}, {"epsilon", 0.5}, {"dt", 0.1}}, {rotation_bound()});
  rotation.use_task_checks = false;
  sets.push_back(std::move(rotation));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Vorticity confinement of position-based fluid particles";
  t.paper_number = 50;
  t.contract = describe<Inputs, Outputs<float>>();
  const auto set = [&](const char* name, SetKind kind, Size size, const Block& b, double epsilon) {
    t.sets.push_back(
        fluid::block_set(t.contract, name, kind, size, b, {{"h", 2}, {"epsilon", epsilon}, {"dt", 0.1}}));
  };
  set("public", SetKind::open, Size::paper, public_block({160, 160, 160}), 0.315);
  set("hidden", SetKind::hidden, Size::paper, hidden_block({160, 160, 160}), 0.256);
  set("public_smoke", SetKind::open, Size::smoke, public_block({37, 29, 33}), 0.315);
  set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_block({29, 37, 31}), 0.256);
  for (InputSet& s : hard_sets(t.contract)) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("v_new", "v", 1e-3, "the paper's table of inputs and checks"),
      local_error_of_change("v_new", "v", 1e-2,
                            "where eta is a thousandth of its mean, rounding turns N by a thousand times "
                            "more than elsewhere; a wrong N is of the size of the rms"),
  };
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 20;
  return t;
}

}  // namespace gpuphys::vorticity_confinement_pbf
