// Input sets and checks of p2g_apic (specification: cases/particle_grid/p2g_apic.md).
#include "cases/particle_grid/p2g_apic.hpp"

#include <algorithm>
#include <cmath>

#include "cases/particle_grid/mac_transfer_sets.hpp"

namespace gpuphys::p2g_apic {
namespace {

using mac_particles::BlockSet;
using mac_particles::kDx;
using mac_particles::kNames;
using mac_particles::Placement;
using mac_particles::Vec3;

constexpr double kTolerance = 2e-6, kLocalTolerance = 2e-5;
constexpr double kTight = 8e-7, kTightLocal = 8e-6;
constexpr double kGradient = 25.6;  // 1/s: 0.1 m/s a cell of 2^-8 m
constexpr std::uint64_t kAffineStream = 16;

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

InputSet block_set(const BlockSet& s) {
  InputSet set;
  set.name = s.name;
  set.kind = s.hidden ? SetKind::hidden : SetKind::open;
  set.size = s.paper ? Size::paper : Size::smoke;
  set.about = mac_particles::describe(s) +
              (s.hidden ? "; gradients of 20.48 U per second" : "; gradients of 25.6 U per second");
  set.make = [s] {
    Problem p =
        make_problem(contract(), {{"n", s.n}, {"nx", s.cells[0]}, {"ny", s.cells[1]}, {"nz", s.cells[2]}});
    p.set_scalar("dx", kDx);
    mac_particles::fill_positions(s, p.inputs[0]);
    mac_particles::fill_velocity(s, p.inputs[0], p.inputs[1]);
    const double scale = s.hidden ? 0.8 : 1.0;
    mac_particles::fill_uniform(s.seed, kAffineStream, 0.25 * kDx * kDx * kGradient * scale, p.inputs[2]);
    return p;
  };
  return set;
}

// The task's own placements: what particles carry is affine.

constexpr std::array<Vec3, 3> kSlopes{
    {{0.25, -0.5, 1.0}, {-0.75, 0.125, 0.375}, {0.5, -1.0, -0.25}}};  // m/s a cell
constexpr Vec3 kOrigin{0.5, -1.25, 2};                                // m/s

Placement affine(const std::string& stress, const std::string& about, double dx, std::uint64_t seed) {
  return {.stress = stress,
          .about = about,
          .cells = {20, 13, 17},
          .dx = dx,
          .n = 9001,
          .at =
              [=](std::uint64_t q) {
                return mac_particles::off_planes(seed, q, {-1, -1, -1}, {21, 14, 18}, 0x1p-7);
              },
          .v = [](std::uint64_t) { return Vec3{}; }};
}

std::vector<Placement> all_placements() {
  std::vector<Placement> all = mac_particles::placements();
  all.push_back(
      affine("affine_field",
             "every particle carries the velocity and the gradient of one affine field: so must every face",
             kDx, 61));
  all.push_back(affine("affine_tenth", "the same with dx = 0.1", static_cast<double>(0.1f), 62));
  all.push_back({.stress = "lightest_faces",
                 .about = "of each component one face with a mass of 2^-92 of a particle or less",
                 .cells = {11, 12, 13},
                 .n = 3,
                 .at =
                     [](std::uint64_t q) {
                       Vec3 x{8.25, 8.25, 8.25};
                       x[q] = 0.5 + 0x1p-24;
                       x[(q + 1) % 3] = 0x1p-20;
                       return x;
                     },
                 .v = [](std::uint64_t q) { return mac_particles::random_vector(59, 4, q); }});
  for (const char* stress : {"single_entries", "affine_only"}) {
    const bool single = stress == std::string("single_entries");
    all.push_back(
        {.stress = stress,
         .about = single ? "each particle has one entry of B that is not 0, and no velocity along two axes"
                         : "velocities of 1e-6 m/s beside affine parts of 1e3 m/s a cell",
         .cells = {14, 17, 16},
         .n = 8009,
         .at =
             [=](std::uint64_t q) {
               return mac_particles::off_planes(single ? 63 : 64, q, {-1, -1, -1}, {15, 18, 17}, 0x1p-10);
             },
         .v =
             [=](std::uint64_t q) {
               Vec3 v = mac_particles::random_vector(single ? 63 : 64, 4, q);
               if (single) v[q % 3] = v[(q + 1) % 3] = 0;
               for (double& c : v) c *= single ? 1 : 1e-6;
               return v;
             }});
  }
  return all;
}

// Gradients in m/s a cell: D = 4 B / dx.
double slope_scale(const Placement& s) {
  if (s.stress == "drift" || s.stress == "one_particle") return 0;
  if (s.stress == "affine_only") return 1e3;
  if (s.stress == "smallest") return 1e20;
  if (s.stress == "largest") return 1e-20;
  if (s.stress == "dx_three") return 1e-3;
  return 0.5;
}

Problem placed_problem(const Placement& s) {
  Problem p = mac_particles::placed_problem(contract(), s);
  const double dx = p.scalar("dx"), scale = 0.25 * dx * slope_scale(s);
  mac_particles::fill_uniform(60, kAffineStream, scale, p.inputs[2]);
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), b = p.inputs[2].as<float>();
  for (std::size_t q = 0; q < x.size() / 3; ++q) {
    for (std::size_t e = 0; e < 9; ++e) {
      if (s.stress == "single_entries" && e != q % 9) b[9 * q + e] = 0;
      if (s.stress.starts_with("affine_f") || s.stress.starts_with("affine_t"))
        b[9 * q + e] = static_cast<float>(0.25 * dx * kSlopes[e / 3][e % 3]);
    }
    if (!s.stress.starts_with("affine_f") && !s.stress.starts_with("affine_t")) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      double sum = kOrigin[c];
      for (std::size_t d = 0; d < 3; ++d) sum += kSlopes[c][d] * static_cast<double>(x[3 * q + d]) / dx;
      v[3 * q + c] = static_cast<float>(sum);
    }
  }
  return p;
}

Check is_affine(int component, double tolerance) {
  const std::string name = kNames[static_cast<std::size_t>(component)];
  return worst_over({.name = name + "_affine",
                     .kind = CheckKind::invariant,
                     .array = name,
                     .quantity = "largest |u - affine field| over faces that are not exactly 0, over the "
                                 "field's largest value of 30 "
                                 "m/s",
                     .tolerance = tolerance,
                     .why = "the transfer of an affine field with its gradient is exact; the particles' "
                            "velocities are rounded to "
                            "6e-8 of themselves, sums a few times that",
                     .needs_truth = false},
                    [name, component](const Judged& j) {
                      const HostArray& u = output(j, name);
                      return Items{
                          u.size(),
                          [&, component](std::int64_t i) {
                            if (u.value(i) == 0) return 0.0;
                            const Shape& n = u.shape();
                            const std::array<std::int64_t, 3> at{i / n[2] / n[1], i / n[2] % n[1], i % n[2]};
                            double sum = kOrigin[static_cast<std::size_t>(component)];
                            for (std::size_t d = 0; d < 3; ++d) {
                              const double offset = static_cast<int>(d) == component ? 0.0 : 0.5;
                              sum += kSlopes[static_cast<std::size_t>(component)][d] *
                                     (static_cast<double>(at[d]) + offset);
                            }
                            return (u.value(i) - sum) / 30;
                          },
                          [&](std::int64_t i) { return index_text(u, i); }};
                    });
}

std::vector<Check> invariants_of(const Placement& s) {
  std::vector<Check> checks;
  for (int c = 0; c < 3; ++c) {
    const std::string& name = kNames[static_cast<std::size_t>(c)];
    if (s.stress == "all_outside") {
      checks.push_back(exactly_zero(name, "a face that no particle reaches has velocity exactly 0"));
      continue;
    }
    const bool affine_field = s.stress.starts_with("affine_f") || s.stress.starts_with("affine_t");
    if (!affine_field) checks.push_back(mac_particles::same_support(c));  // that field is 0 at some faces
    if (!s.use_task_checks) {
      checks.push_back(
          mac_particles::error_over_largest(c, 1e-4,
                                            "running float32 sums of 1e5 terms wander by some sqrt(1e5) "
                                            "units of 2^-24 of themselves, 2e-5; sums in "
                                            "parts do better"));
      continue;
    }
    if (s.stress == "drift" || s.stress == "one_particle") {
      checks.push_back(
          mac_particles::moves_with(c, mac_particles::kDrift[static_cast<std::size_t>(c)], 1e-6,
                                    "B is 0 and both sums have the same weights; each rounds a few times"));
    }
    if (s.stress.starts_with("affine_f") || s.stress.starts_with("affine_t"))
      checks.push_back(is_affine(c, 1e-6));
    const std::string why =
        "tighter than the paper's bound, which is for 33 million particles: some tens of terms a face round "
        "to 3e-7";
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
  t.title = "Particle-to-grid transfer of affine velocities (APIC, quadratic B-splines, MAC grid)";
  t.paper_number = 31;
  t.contract = contract();
  t.unordered = {{"n", {}}};
  for (const BlockSet& s : mac_particles::block_sets()) t.sets.push_back(block_set(s));
  for (const Placement& s : all_placements()) {
    t.sets.push_back(hard_case(
        s.stress, s.about, [s] { return placed_problem(s); }, invariants_of(s), s.use_task_checks));
  }
  for (const std::string& name : kNames) {
    t.checks.push_back(relative_l2_check(name, kTolerance, "the paper's table of inputs and checks"));
    t.checks.push_back(
        local_error_check(name, kLocalTolerance,
                          "a face is the quotient of two sums of up to 216 terms; the float32 baseline "
                          "stays near 2e-6 of the rms, ten times that is left for other orders"));
  }
  t.target_floor_multiple = 3.1;
  return t;
}

}  // namespace gpuphys::p2g_apic
