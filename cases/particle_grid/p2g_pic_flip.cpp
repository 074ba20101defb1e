// Input sets and checks of p2g_pic_flip (specification: cases/particle_grid/p2g_pic_flip.md).
#include "cases/particle_grid/p2g_pic_flip.hpp"

#include <array>

#include "cases/particle_grid/mac_transfer_sets.hpp"

namespace gpuphys::p2g_pic_flip {
namespace {

using mac_particles::BlockSet;
using mac_particles::kNames;
using mac_particles::Placement;

constexpr double kTolerance = 1e-6, kLocalTolerance = 1e-5;
constexpr double kTight = 5e-7, kTightLocal = 5e-6;

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

InputSet block_set(const BlockSet& s) {
  InputSet set;
  set.name = s.name;
  set.kind = s.hidden ? SetKind::hidden : SetKind::open;
  set.size = s.paper ? Size::paper : Size::smoke;
  set.about = mac_particles::describe(s);
  set.make = [s] {
    Problem p =
        make_problem(contract(), {{"n", s.n}, {"nx", s.cells[0]}, {"ny", s.cells[1]}, {"nz", s.cells[2]}});
    p.set_scalar("dx", mac_particles::kDx);
    mac_particles::fill_positions(s, p.inputs[0]);
    mac_particles::fill_velocity(s, p.inputs[0], p.inputs[1]);
    return p;
  };
  return set;
}

/// Of each component one face that owns nothing but a weight of 2^-74 or 2^-78.
mac_particles::Vec3 next_to_nothing(std::uint64_t q) {
  constexpr std::array<mac_particles::Vec3, 3> at{{{0x1p-30, 0.5 + 0x1p-24, 0.5 + 0x1p-24},
                                                   {8.5 + 0x1p-20, 0x1p-30, 0.5 + 0x1p-24},
                                                   {0.5 + 0x1p-24, 8.5 + 0x1p-20, 0x1p-30}}};
  return at[q % 3];
}

std::vector<Placement> all_placements() {
  std::vector<Placement> all = mac_particles::placements();
  all.push_back({.stress = "lightest_faces",
                 .about = "of each component one face with a mass of 2^-74 of a particle or less",
                 .cells = {11, 12, 5},
                 .n = 3,
                 .at = next_to_nothing,
                 .v = [](std::uint64_t q) { return mac_particles::random_vector(59, 4, q); }});
  return all;
}

std::vector<Check> invariants_of(const Placement& s) {
  std::vector<Check> checks;
  for (int c = 0; c < 3; ++c) {
    const std::string& name = kNames[static_cast<std::size_t>(c)];
    if (s.stress == "all_outside") {
      checks.push_back(exactly_zero(name, "a face that no particle reaches has velocity exactly 0"));
      continue;
    }
    checks.push_back(mac_particles::same_support(c));
    if (!s.use_task_checks) {
      checks.push_back(
          mac_particles::error_over_largest(c, 1e-4,
                                            "running float32 sums of 1e5 terms wander by some sqrt(1e5) "
                                            "units of 2^-24 of themselves, 2e-5; sums in "
                                            "parts do better"));
      continue;
    }
    if (s.stress == "drift" || s.stress == "one_particle") {
      checks.push_back(mac_particles::moves_with(c, mac_particles::kDrift[static_cast<std::size_t>(c)], 1e-6,
                                                 "both sums have the same weights; each rounds a few times"));
    }
    const std::string why =
        "tighter than the paper's bound, which is for 33 million particles: some ten terms a face round to "
        "1e-7";
    checks.push_back(as_invariant(relative_l2_check(name, kTight, why), name + "_rel_l2_tight", kTight, why));
    // Nearly all faces of a long row are empty, so that the rms is small.
    const double local = s.stress.starts_with("long") ? 4 * kTightLocal : kTightLocal;
    checks.push_back(as_invariant(local_error_check(name, local, why), name + "_local_tight", local, why));
  }
  return checks;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Particle-to-grid transfer of velocities (PIC/FLIP, trilinear, MAC grid)";
  t.paper_number = 29;
  t.contract = contract();
  t.unordered = {{"n", {}}};
  for (const BlockSet& s : mac_particles::block_sets()) t.sets.push_back(block_set(s));
  for (const Placement& s : all_placements()) {
    t.sets.push_back(hard_case(
        s.stress, s.about, [s] { return mac_particles::placed_problem(contract(), s); }, invariants_of(s),
        s.use_task_checks));
  }
  for (const std::string& name : kNames) {
    t.checks.push_back(relative_l2_check(name, kTolerance, "the paper's table of inputs and checks"));
    t.checks.push_back(
        local_error_check(name, kLocalTolerance,
                          "a face is the quotient of two sums of up to 64 terms; the float32 baseline "
                          "stays below 1e-6 of the rms, ten times that is left for other orders"));
  }
  t.target_floor_multiple = 3.5;
  return t;
}

}  // namespace gpuphys::p2g_pic_flip
