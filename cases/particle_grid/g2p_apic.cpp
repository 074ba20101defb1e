// Input sets and checks of g2p_apic (specification: cases/particle_grid/g2p_apic.md).
#include "cases/particle_grid/g2p_apic.hpp"

#include <fmt/format.h>

#include "cases/particle_grid/entry_checks.hpp"
#include "cases/particle_grid/mac_gather_sets.hpp"

namespace gpuphys::g2p_apic {
namespace {

using mac_particles::BlockSet;
using mac_particles::FaceStress;
using mac_particles::Vec3;

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
    for (int c = 0; c < 3; ++c)
      mac_particles::fill_faces(s, s.seed + 1000, 1, c, p.inputs[static_cast<std::size_t>(1 + c)]);
    return p;
  };
  return set;
}

std::vector<Check> invariants_of(const FaceStress& s) {
  const std::string& stress = s.particles.stress;
  const std::string why =
      "tighter than the paper's bound, which is for 33 million particles: 27 terms round to 2e-7";
  std::vector<Check> checks{as_invariant(relative_l2_check("v", 0, ""), "v_tight", 5e-7, why),
                            as_invariant(relative_l2_check("B", 0, ""), "B_tight", 5e-7, why)};
  if (s.flat) {
    const std::string whole = "as the task's local checks, over the rms of all entries together";
    checks.push_back(as_invariant(local_error_check("v", 0, ""), "v_local", 1e-5, whole));
    checks.push_back(as_invariant(local_error_check("B", 0, ""), "B_local", 1e-5, whole));
  }
  if (stress == "constant") {
    checks.push_back(equals_known(
        {.name = "no_affine_part",
         .kind = CheckKind::invariant,
         .array = "B",
         .quantity = "B of a constant field over 1000 m/s dx",
         .tolerance = 0x1p-20,
         .why =
             "first moments add up to 0; what is left is rounding, for codes that keep the absolute velocity",
         .needs_truth = false},
        [](const Judged& j) {
          return std::vector<double>(static_cast<std::size_t>(output(j, "B").size()), 0.0);
        },
        mac_particles::kConstantFaces[0] * mac_particles::kDx));
  }
  if (stress == "linear") {
    const std::string exact = "dyadic numbers: every product and sum is exact in float32";
    checks.push_back(equals_known({.name = "v_linear",
                                   .kind = CheckKind::invariant,
                                   .array = "v",
                                   .quantity = "velocity of a linear field",
                                   .tolerance = 0x1p-22,
                                   .why = exact,
                                   .needs_truth = false},
                                  [](const Judged& j) {
                                    const HostArray& x = input(j, "x");
                                    std::vector<double> known;
                                    for (std::int64_t i = 0; i < x.size(); ++i) {
                                      const int c = static_cast<int>(i % 3);
                                      known.push_back(mac_particles::linear_at(
                                          c, {x.value(i - c), x.value(i - c + 1), x.value(i - c + 2)}));
                                    }
                                    return known;
                                  }));
    checks.push_back(equals_known(
        {.name = "B_linear",
         .kind = CheckKind::invariant,
         .array = "B",
         .quantity = "dx^2/4 times the gradient of a linear field, dx = 1",
         .tolerance = 0x1p-22,
         .why = exact,
         .needs_truth = false},
        [](const Judged& j) {
          std::vector<double> known;
          for (std::int64_t e = 0; e < output(j, "B").size(); ++e)
            known.push_back(
                mac_particles::kSlope[static_cast<std::size_t>(e % 9 / 3)][static_cast<std::size_t>(e % 3)] /
                4);
          return known;
        }));
  }
  return checks;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Grid-to-particle transfer of velocities and affine state (APIC, quadratic B-splines, MAC grid)";
  t.paper_number = 32;
  t.contract = contract();
  t.unordered = {{"n", {}}};
  for (const BlockSet& s : mac_particles::block_sets()) t.sets.push_back(block_set(s));
  for (const FaceStress& s : mac_particles::face_stresses()) {
    if (s.particles.stress == "one_particle") continue;  // one entry is no sample
    const bool no_entries = s.flat || s.particles.stress == "constant";
    t.sets.push_back(hard_case(
        s.particles.stress, s.particles.about,
        [s] {
          const mac_particles::Placement& at = s.particles;
          Problem p = make_problem(
              contract(), {{"n", at.n}, {"nx", at.cells[0]}, {"ny", at.cells[1]}, {"nz", at.cells[2]}});
          p.set_scalar("dx", at.dx);
          const auto x = p.inputs[0].as<float>();
          for (std::size_t q = 0; q < static_cast<std::size_t>(at.n); ++q) {
            const Vec3 cells = at.at(q);
            for (std::size_t d = 0; d < 3; ++d) x[3 * q + d] = static_cast<float>(cells[d] * at.dx);
          }
          for (int c = 0; c < 3; ++c)
            mac_particles::fill_samples(s, 0, c, p.inputs[static_cast<std::size_t>(1 + c)]);
          return p;
        },
        invariants_of(s), !no_entries));
  }
  const std::string table = "the paper's table of inputs and checks",
                    local = "ten times the largest error of the FP32 baseline, some 1e-6 of the rms";
  for (const std::int64_t c : {0, 1, 2}) {
    const std::string label = fmt::format("v{}", "xyz"[c]);
    t.checks.push_back(entry_checks::relative_l2_of_entry("v", c, label, 1e-6, table));
    t.checks.push_back(entry_checks::local_error_of_entry("v", c, label, 1e-5, local));
  }
  for (std::int64_t e = 0; e < 9; ++e) {
    const std::string label = fmt::format("B{}{}", "xyz"[e / 3], "xyz"[e % 3]);
    t.checks.push_back(entry_checks::relative_l2_of_entry("B", e, label, 1e-6, table));
    t.checks.push_back(entry_checks::local_error_of_entry("B", e, label, 1e-5, local));
  }
  t.target_floor_multiple = 2.9;
  return t;
}

}  // namespace gpuphys::g2p_apic
