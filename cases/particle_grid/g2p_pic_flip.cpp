// Input sets and checks of g2p_pic_flip (specification: cases/particle_grid/g2p_pic_flip.md).
#include "cases/particle_grid/g2p_pic_flip.hpp"

#include <fmt/format.h>

#include <cmath>

#include "cases/particle_grid/entry_checks.hpp"
#include "cases/particle_grid/mac_gather_sets.hpp"

namespace gpuphys::g2p_pic_flip {
namespace {

using mac_particles::BlockSet;
using mac_particles::FaceStress;
using mac_particles::Vec3;

constexpr double kFlip = 0.95;
constexpr double kChange = 0.2;  // of the second field, in the paper's sets

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

// The inputs after x and v: the old field, then the new one.
constexpr std::size_t field_at(int field, int c) {
  return static_cast<std::size_t>(2 + 3 * field + c);
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
    p.set_scalar("flip", kFlip);
    mac_particles::fill_positions(s, p.inputs[0]);
    mac_particles::fill_velocity(s, p.inputs[0], p.inputs[1]);
    for (int c = 0; c < 3; ++c) {
      HostArray &before = p.inputs[field_at(0, c)], &after = p.inputs[field_at(1, c)];
      mac_particles::fill_faces(s, s.seed + 1000, 1, c, before);
      mac_particles::fill_faces(s, s.seed + 2000, kChange, c, after);
      const auto from = before.as<float>(), to = after.as<float>();
      for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
    }
    return p;
  };
  return set;
}

/// Blends over the sets: 0, 1 and what lies between.
double flip_of(const std::string& stress) {
  if (stress == "walls" || stress == "constant") return 0;
  if (stress == "every_cell" || stress == "dx_tenth") return 0.25;
  if (stress == "offset" || stress == "no_change") return 1;
  if (stress == "dx_three" || stress == "linear") return 0.5;
  return kFlip;
}

Check equals_v(const std::string& why) {
  return count_where({.name = "v_kept",
                      .kind = CheckKind::invariant,
                      .array = "v_new",
                      .quantity = "components that differ from v",
                      .tolerance = 0,
                      .why = why,
                      .needs_truth = false},
                     [](const Judged& j) {
                       const HostArray &got = output(j, "v_new"), &v = input(j, "v");
                       return Items{got.size(), [&got, &v](std::int64_t i) {
                                      return got.value(i) == v.value(i) ? 0.0 : 1.0;
                                    }};
                     });
}

std::vector<Check> invariants_of(const std::string& stress) {
  std::vector<Check> checks;
  if (stress == "no_change") {
    checks.push_back(equals_v("flip = 1 and no change of the field: v + 0, bit by bit"));
    return checks;
  }
  const std::string why =
      "tighter than the paper's bound, which is for 33 million particles: eight terms round to 1e-7";
  checks.push_back(as_invariant(relative_l2_check("v_new", 0, ""), "v_new_tight", 3e-7, why));
  if (stress == "constant") {
    checks.push_back(equals_known({.name = "v_constant",
                                   .kind = CheckKind::invariant,
                                   .array = "v_new",
                                   .quantity = "velocity of a constant field, flip = 0",
                                   .tolerance = 5e-7,
                                   .why = "weights add up to 1",
                                   .needs_truth = false},
                                  [](const Judged& j) {
                                    std::vector<double> known;
                                    for (std::int64_t i = 0; i < output(j, "v_new").size(); ++i)
                                      known.push_back(static_cast<double>(static_cast<float>(
                                          mac_particles::kConstantFaces[static_cast<std::size_t>(i % 3)])));
                                    return known;
                                  }));
  }
  if (stress == "linear") {
    checks.push_back(equals_known({.name = "v_linear",
                                   .kind = CheckKind::invariant,
                                   .array = "v_new",
                                   .quantity = "1/2 new + 1/2 (v + new - old) of two linear fields",
                                   .tolerance = 0x1p-22,
                                   .why = "dyadic numbers: every product and sum is exact in float32",
                                   .needs_truth = false},
                                  [](const Judged& j) {
                                    const HostArray &x = input(j, "x"), &v = input(j, "v");
                                    std::vector<double> known;
                                    for (std::int64_t i = 0; i < v.size(); ++i) {
                                      const int c = static_cast<int>(i % 3);
                                      const Vec3 g{x.value(i - c), x.value(i - c + 1), x.value(i - c + 2)};
                                      const double before = mac_particles::linear_at(c, g),
                                                   after =
                                                       mac_particles::linear_at(c, {2 * g[2], g[0], -g[1]});
                                      known.push_back(0.5 * after + 0.5 * (v.value(i) + (after - before)));
                                    }
                                    return known;
                                  }));
  }
  return checks;
}

/// The stresses of all gathers, and two of fields that change little.
std::vector<FaceStress> stresses() {
  std::vector<FaceStress> list = mac_particles::face_stresses();
  FaceStress same = list.front();
  for (const FaceStress& s : list) {
    if (s.particles.stress == "every_cell") same = s;
  }
  const auto field = same.u;
  same.particles.stress = "no_change";
  same.particles.about = "the field does not change, and flip = 1: v_new is v";
  same.u = [field](int, int c, std::int64_t i, std::int64_t j, std::int64_t k) {
    return field(0, c, i, j, k);
  };
  list.push_back(same);
  same.particles.stress = "small_change";
  same.particles.about =
      "the field changes by 1e-9 of itself and less, v is small: changes must not drown in the field";
  same.particles.v = [](std::uint64_t q) {
    Vec3 v = mac_particles::random_vector(90, 4, q);
    for (double& c : v) c *= 1e-9;
    return v;
  };
  // One sample in three by a step of float32, the others not at all: differences are exact.
  same.u = [field](int which, int c, std::int64_t i, std::int64_t j, std::int64_t k) {
    const double before = 1e-3 * field(0, c, i, j, k);
    if (which == 0 || (i + j + k) % 3 != 0) return before;
    return static_cast<double>(std::nextafter(static_cast<float>(before), 1.0f));
  };
  list.push_back(same);
  return list;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Grid-to-particle transfer of velocities (PIC/FLIP, trilinear, MAC grid)";
  t.paper_number = 30;
  t.contract = contract();
  t.unordered = {{"n", {}}};
  for (const BlockSet& s : mac_particles::block_sets()) t.sets.push_back(block_set(s));
  for (const FaceStress& s : stresses()) {
    const std::string& name = s.particles.stress;
    const double flip = name == "small_change" ? 1 : flip_of(name);
    t.sets.push_back(hard_case(
        name, s.particles.about,
        [s, flip] {
          Problem p = mac_particles::placed_problem(contract(), s.particles);
          p.set_scalar("flip", flip);
          for (int field = 0; field < 2; ++field) {
            for (int c = 0; c < 3; ++c)
              mac_particles::fill_samples(s, field, c, p.inputs[field_at(field, c)]);
          }
          return p;
        },
        invariants_of(name)));
  }
  for (const std::int64_t c : {0, 1, 2}) {
    const std::string label = fmt::format("v{}", "xyz"[c]);
    t.checks.push_back(entry_checks::relative_l2_of_entry("v_new", c, label, 1e-6,
                                                          "the paper's table of inputs and checks"));
    t.checks.push_back(entry_checks::local_error_of_entry(
        "v_new", c, label, 3e-6, "ten times the largest error of the FP32 baseline, some 3e-7 of the rms"));
  }
  t.target_floor_multiple = 3.2;
  return t;
}

}  // namespace gpuphys::g2p_pic_flip
