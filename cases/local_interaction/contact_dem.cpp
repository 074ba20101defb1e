// Input sets and checks of contact_dem (specification: cases/local_interaction/contact_dem.md).
#include "cases/local_interaction/contact_dem.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "cases/local_interaction/grain_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::contact_dem {
namespace {

using grains::Grain;
using grains::Packing;

constexpr double kStiffness = 600, kDamping = 10;

Problem problem_of(const std::vector<Grain>& grains, double kn = kStiffness, double cn = kDamping) {
  Problem p =
      make_problem(describe<Inputs, Outputs<float>>(), {{"n", static_cast<std::int64_t>(grains.size())}});
  p.set_scalar("kn", kn);
  p.set_scalar("cn", cn);
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), radius = p.inputs[2].as<float>();
  for (std::size_t i = 0; i < grains.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      x[3 * i + c] = static_cast<float>(grains[i].x[c]);
      v[3 * i + c] = static_cast<float>(grains[i].v[c]);
    }
    radius[i] = static_cast<float>(grains[i].radius);
  }
  return p;
}

Packing public_packing(std::array<std::int64_t, 3> lattice) {
  return {lattice, 1, 0.12, 0.50, 0.60, 0.010, 0.50};
}
Packing hidden_packing(std::array<std::int64_t, 3> lattice) {
  return {lattice, 2, 0.10, 0.485, 0.605, 0.013, 0.48};
}

std::vector<Check> tight();

InputSet packing_set(std::string name, SetKind kind, Size size, const Packing& p) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{}x{}x{} lattice, jitter {}, radii {} to {}, shear {}, velocity noise {}, seed {}",
                        p.lattice[0], p.lattice[1], p.lattice[2], p.jitter, p.smallest, p.largest, p.shear,
                        p.noise, p.seed);
  s.make = [p] { return problem_of(grains::packing(p)); };
  if (size == Size::smoke) s.invariants = tight();
  return s;
}

// ---- checks ----

double norm(const HostArray& force, std::int64_t i) {
  return std::hypot(force.value(3 * i), force.value(3 * i + 1), force.value(3 * i + 2));
}

// Newton's third law.
Check force_balance() {
  return conserved_sum(
      {.name = "force_balance",
       .array = "force",
       .quantity = "sum of all forces over the sum of their sizes",
       .tolerance = 64 * 0x1p-24,
       .why = "the two forces of a pair are opposite, so the sum is zero up to the rounding of "
              "each grain's own sum: at most one unit roundoff of its size for each of the "
              "contacts that a grain has, 64 in the most crowded set",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray& force = output(j, "force");
        return Terms{force.shape()[0], [&force](std::int64_t i) {
                       return std::array{force.value(3 * i), force.value(3 * i + 1), force.value(3 * i + 2)};
                     }};
      });
}

// Grains that feel a force on one side only. Forces vanish with the overlap, so a pair decided differently by
// rounding carries next to none.
Check contact_mismatches() {
  return count_where(
      {.name = "contact_mismatches",
       .array = "force",
       .quantity = "grains whose force is zero on one side and above 1e-3 rms on the other",
       .tolerance = 0.5,
       .why =
           "none: rounding can decide a pair differently only if its overlap is below 3e-7 of its distance, "
           "where its force is at most a ten-thousandth of the rms"},
      [](const Judged& j) {
        const HostArray &force = output(j, "force"), &expected = truth(j, "force");
        const std::int64_t n = force.shape()[0];
        double square = 0;
        for (std::int64_t i = 0; i < n; ++i) square += norm(expected, i) * norm(expected, i);
        const double least = 1e-3 * std::sqrt(square / static_cast<double>(std::max<std::int64_t>(n, 1)));
        return Items{n,
                     [&force, &expected, least](std::int64_t i) {
                       const double got = norm(force, i), right = norm(expected, i);
                       return (got == 0) != (right == 0) && (got > least || right > least) ? 1.0 : 0.0;
                     },
                     [&force, &expected](std::int64_t i) {
                       return fmt::format("grain {}: got {:.6g} N, expected {:.6g} N", i, norm(force, i),
                                          norm(expected, i));
                     }};
      });
}

// Two grains: the law written out for a pair.
std::vector<double> law_of_a_pair(const Judged& j) {
  const Inputs in = bind_inputs<Inputs>(j.problem);
  double d[3], v[3];
  for (int c = 0; c < 3; ++c) {
    d[c] = static_cast<double>(in.x(0, c)) - static_cast<double>(in.x(1, c));
    v[c] = static_cast<double>(in.v(0, c)) - static_cast<double>(in.v(1, c));
  }
  const double distance = std::hypot(d[0], d[1], d[2]);
  const double a = in.radius(0), b = in.radius(1), overlap = a + b - distance;
  const double separation = (v[0] * d[0] + v[1] * d[1] + v[2] * d[2]) / distance;
  const double push = std::sqrt(a * b / (a + b) * overlap) *
                      (static_cast<double>(in.kn) * overlap - static_cast<double>(in.cn) * separation);
  std::vector<double> force;
  for (const double side : {1.0, -1.0})
    for (int c = 0; c < 3; ++c) force.push_back(side * push * d[c] / distance);
  return force;
}

Check closed_form() {
  return equals_known(
      {.name = "closed_form",
       .kind = CheckKind::invariant,
       .array = "force",
       .quantity = "error of a component over the largest one",
       .tolerance = 2e-6,
       .why = "the overlap is a tenth of the distance, so its rounding is worth ten times 2^-23 of "
              "the force, and the law adds a few units of its own",
       .needs_truth = false},
      law_of_a_pair);
}

// The paper's tolerances leave room for two million grains and their faintest contacts. A thousand grains
// need none of it.
std::vector<Check> tight() {
  return {as_invariant(relative_l2_check("force", 0, ""), "force_rel_l2_tight", 1e-5,
                       "the overlap, a fifth of the distance, carries five times its rounding: 6e-7 in all"),
          as_invariant(local_error_check("force", 0, ""), "force_local_tight", 3e-5,
                       "grains whose contacts have only just begun: the FP32 baseline stays below 4e-6")};
}

// ---- hard cases ----

// Stiffness and damping of a hard set; few sets have the public ones.
struct Law {
  double kn = kStiffness, cn = kDamping;
};

InputSet hard(const std::string& stress, const std::string& about, std::function<std::vector<Grain>()> make,
              std::vector<Check> invariants = tight(), Law law = {}) {
  return hard_case(
      stress, about, [make = std::move(make), law] { return problem_of(make(), law.kn, law.cn); },
      std::move(invariants));
}

double random11(std::uint64_t seed, std::uint64_t stream, std::size_t i) {
  return uniform11(seed, stream, static_cast<std::uint64_t>(i));
}

// Grains uniform in a cube of half width `half` about `centre`; radii uniform between the two given.
std::vector<Grain> cloud(std::uint64_t seed, std::size_t n, grains::Vec3 centre, double half, double smallest,
                         double largest) {
  std::vector<Grain> all(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      all[i].x[c] = centre[c] + half * random11(seed, 0, 3 * i + c);
      all[i].v[c] = 0.5 * random11(seed, 2, 3 * i + c);
    }
    all[i].radius = smallest + (largest - smallest) * (0.5 + 0.5 * random11(seed, 1, i));
  }
  return all;
}

std::vector<Grain> coincident() {
  std::vector<Grain> all = grains::packing(public_packing({9, 7, 8}));
  // Every fifth grain sits in the centre of the one before it, with its own radius and velocity.
  for (std::size_t i = 1; i < all.size(); i += 5) all[i].x = all[i - 1].x;
  return all;
}

std::vector<Grain> size_ratio() {
  // Three grains of 5 m, and grains of 5 cm, most of them in the shells where they touch one of the large.
  std::vector<Grain> all = cloud(21, 2500, {0, 0, 0}, 1.0, 0.045, 0.055);
  const std::array<grains::Vec3, 3> centres{{{-6, 0, 0.5}, {3.5, 1, -0.25}, {1, -7, 4}}};
  for (std::size_t i = 0; i < all.size(); ++i) {
    grains::Vec3& x = all[i].x;
    const double length = std::sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    const double shell = 5.0 + 0.05 * random11(21, 3, i);
    for (std::size_t c = 0; c < 3; ++c) x[c] = centres[i % 3][c] + x[c] / length * shell;
  }
  for (const grains::Vec3& c : centres) all.push_back({c, {0.25, -0.5, 0.125}, 5.0});
  return all;
}

std::vector<Grain> crowded_cell() {
  // The large grain makes a cell wider than the whole cloud.
  std::vector<Grain> all = cloud(22, 3000, {0.5, 0.5, 0.5}, 0.45, 0.01, 0.02);
  all.push_back({{0.5, 0.5, -0.4}, {0, 0, 0}, 0.5});
  return all;
}

std::vector<Grain> far_apart() {
  // Positions of a million metres resolve 1/16 m: lattices keep their contacts, on coarser displacements.
  std::vector<Grain> all;
  std::uint64_t seed = 31;
  for (const grains::Vec3& corner :
       {grains::Vec3{0, 0, 0}, grains::Vec3{1e6, 0, 0}, grains::Vec3{-1e6, 1e6, 3},
        grains::Vec3{0, -1e6, 1e6}, grains::Vec3{7, 1e3, -1e6}}) {
    Packing p = public_packing({5, 4, 6});
    p.seed = seed++;
    p.corner = corner;
    for (const Grain& g : grains::packing(p)) all.push_back(g);
  }
  return all;
}

std::vector<Grain> line(std::size_t axis) {
  std::vector<Grain> all(3001);
  for (std::size_t i = 0; i < all.size(); ++i) {
    const std::size_t at = i * 1000 % all.size();  // any order but that of the line
    all[i].x[axis] = static_cast<double>(at) + 0.12 * random11(23, 0, i);
    for (std::size_t c = 0; c < 3; ++c) all[i].v[c] = 0.5 * random11(23, 2, 3 * i + c);
    all[i].radius = 0.55 + 0.05 * random11(23, 1, i);
  }
  return all;
}

std::vector<Grain> just_touching() {
  std::vector<Grain> all;
  for (int i = 0; i < 6 * 5 * 7; ++i) {
    const grains::Vec3 x{static_cast<double>(i / 35), static_cast<double>(i / 7 % 5),
                         static_cast<double>(i % 7)};
    all.push_back({x, {0.5 * random11(24, 2, static_cast<std::size_t>(i)), -x[1], -x[2]}, 0.5});
  }
  return all;
}

std::vector<Grain> offset() {
  Packing p = public_packing({11, 12, 13});
  p.corner = {1e4, -1e4, 1e4};
  return grains::packing(p);
}

// Equal grains on a lattice whose spacing is 255/256 of a diameter: every contact is as wide as any can be.
std::vector<Grain> widest_contacts() {
  std::vector<Grain> all;
  constexpr int side = 13;
  for (int q = 0; q < side * side * side; ++q) {
    const int i = q * 1000 % (side * side * side);  // in another order than that of the lattice
    const grains::Vec3 site{static_cast<double>(i / (side * side)), static_cast<double>(i / side % side),
                            static_cast<double>(i % side)};
    Grain g{{}, {}, 0.5};
    for (std::size_t c = 0; c < 3; ++c) {
      g.x[c] = 0.99609375 * site[c];
      g.v[c] = 0.01 * random11(41, 2, 3 * static_cast<std::size_t>(i) + c);
    }
    all.push_back(g);
  }
  return all;
}

// Pairs far from each other, whose centres are 1e-1 to 1e-12 m apart. Close to zero float32 resolves such
// distances: along x the pairs are spread out, along y and z the two centres differ.
std::vector<Grain> nearly_coincident() {
  std::vector<Grain> all;
  for (std::size_t k = 0; k < 48; ++k) {
    const double distance = std::pow(10.0, -1.0 - static_cast<double>(k % 12));
    const double angle = 3.14159 * random11(42, 0, k);
    const double x = 4.0 * static_cast<double>(k) - 80.0;
    const grains::Vec3 v{0.0, 0.5 * random11(42, 1, k), 0.5 * random11(42, 2, k)};
    all.push_back({{x, 0.75 * distance * std::cos(angle), 0.5 * distance * std::sin(angle)}, v, 0.5});
    all.push_back({{x, -0.25 * distance * std::cos(angle), -0.5 * distance * std::sin(angle)},
                   {0.25, -0.0, 0.0},
                   0.5 + 0.1 * random11(42, 3, k)});
  }
  return all;
}

// A grain of 4 m, 33 others of 2 cm and 4 mm around it, each touching it alone.
std::vector<Grain> size_ratio_1000() {
  std::vector<Grain> all{{{0.5, -0.25, 1.0}, {0.125, 0.0, -0.25}, 4.0}};
  for (int i = 0; i < 33; ++i) {
    const double z = (2.0 * i + 1.0) / 33 - 1.0, angle = 2.399963 * i, around = std::sqrt(1.0 - z * z);
    const double radius = i % 2 == 0 ? 0.004 : 0.02, distance = 4.0 + 0.25 * radius;
    const auto at = static_cast<std::size_t>(3 * i);
    all.push_back({{0.5 + distance * around * std::cos(angle), -0.25 + distance * around * std::sin(angle),
                    1.0 + distance * z},
                   {random11(43, 2, at), random11(43, 2, at + 1), random11(43, 2, at + 2)},
                   radius});
  }
  return all;
}

// The public packing in another unit of length.
std::vector<Grain> scaled(std::array<std::int64_t, 3> lattice, double length, double speed) {
  std::vector<Grain> all = grains::packing(public_packing(lattice));
  for (Grain& g : all) {
    for (std::size_t c = 0; c < 3; ++c) g.x[c] *= length, g.v[c] *= speed;
    g.radius *= length;
  }
  return all;
}

// Neighbours along z recede so fast that the damping would pull; those along x and y do not.
std::vector<Grain> receding() {
  std::vector<Grain> all = grains::packing(hidden_packing({9, 6, 10}));
  for (Grain& g : all) g.v[2] = 40.0 * g.x[2];
  return all;
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  sets.push_back(
      hard("coincident", "every fifth grain has the centre of another: no direction, no force", coincident));
  sets.push_back(
      hard("size_ratio_100", "2500 grains of 5 cm in the contact shells of three of 5 m", size_ratio, {}));
  sets.push_back(hard("size_ratio_1000", "grains of 4 mm and 2 cm on one of 4 m", size_ratio_1000, {},
                      {.kn = 2.5e5, .cn = 12.3}));
  sets.push_back(hard("full_overlap", "64 grains within 20 cm, each in contact with all the others",
                      [] {
                        return cloud(25, 64, {3, -2, 1}, 0.1, 0.5, 0.6);
                      },
                      tight(), {.kn = 1234.5, .cn = 0}));
  sets.push_back(hard("crowded_cell", "3000 grains in one cell of the size that the largest asks for",
                      crowded_cell, {}));
  sets.push_back(hard("offset_1e4",
                      "a packing 10 km off the origin along each axis, where float32 resolves 1 mm", offset));
  sets.push_back(hard("far_apart", "five packings a thousand kilometres apart", far_apart));
  sets.push_back(hard("line_x", "3001 grains in a row along x: a box without width", [] { return line(0); }));
  sets.push_back(hard("line_z", "3001 grains in a row along z", [] { return line(2); }, tight(),
                      {.kn = 0.3, .cn = 77.7}));
  sets.push_back(
      hard("widest_contacts",
           "2197 equal grains, neighbours 255/256 of a diameter apart: contacts reach as far as the "
           "grains do, across all faces of any cells",
           widest_contacts, tight(), {.kn = 600, .cn = 0.7}));
  sets.push_back(hard("nearly_coincident", "pairs with centres 1e-1 to 1e-12 m apart", nearly_coincident,
                      tight(), {.kn = 333.3, .cn = 44.4}));
  sets.push_back(hard("micrometre", "a packing of grains of half a micrometre",
                      [] {
                        return scaled({7, 8, 6}, 1e-6, 1e-3);
                      },
                      tight(), {.kn = 6.6e10, .cn = 1.1e6}));
  sets.push_back(hard("picometre", "lengths near the lower end of what is valid",
                      [] {
                        return scaled({6, 5, 7}, 1e-12, 1e-12);
                      },
                      tight(), {.kn = 7e20, .cn = 1.3e19}));
  sets.push_back(hard("gigametre", "lengths near the upper end of what is valid",
                      [] {
                        return scaled({5, 7, 6}, 1e13, 1e3);
                      },
                      tight(), {.kn = 6e-10, .cn = 0.3}));
  sets.push_back(hard("receding", "layers that recede so fast that damping would pull: no tension", receding,
                      tight(), {.kn = 600, .cn = 9.9}));
  sets.push_back(hard("damping_only", "no stiffness: only what approaches pushes",
                      [] {
                        return scaled({6, 7, 5}, 1.0, 1.0);
                      },
                      tight(), {.kn = 0, .cn = 10}));
  std::vector<Check> nothing = {exactly_zero("force", "there is nothing to touch", "no_force")};
  sets.push_back(hard(
      "one_grain", "a single grain",
      [] {
        return std::vector<Grain>{{{1, 2, 3}, {4, 5, 6}, 0.5}};
      },
      nothing));
  sets.push_back(hard("two_grains", "one oblique contact",
                      [] {
                        return std::vector<Grain>{{{0.25, -0.5, 2}, {0.5, 0, -0.25}, 0.5},
                                                  {{0.75, -0.75, 2.8}, {-0.25, 0.5, 0.125}, 0.6}};
                      },
                      {closed_form()}, {.kn = 471.1, .cn = 7.3}));
  nothing = {exactly_zero("force", "no overlap, no contact", "no_force")};
  sets.push_back(hard("just_touching", "a lattice of grains in approach whose overlaps are exactly zero",
                      just_touching, nothing));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Normal contact forces between overlapping spherical DEM grains";
  t.paper_number = 47;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      packing_set("public", SetKind::open, Size::paper, public_packing({144, 128, 112})),
      packing_set("hidden", SetKind::hidden, Size::paper, hidden_packing({144, 128, 112})),
      packing_set("public_smoke", SetKind::open, Size::smoke, public_packing({23, 19, 27})),
      packing_set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_packing({19, 27, 22})),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_check("force", 4e-4, "the paper's table of inputs and checks"),
      local_error_check(
          "force", 1e-3,
          "the damping goes with the root of the overlap: rounding of 2e-7 m in a contact that has only just "
          "begun is worth sqrt(0.3 x 2e-7) x 10 x 2 = 0.005 N, against an rms above 15 N; a lost or invented "
          "contact is of the size of the rms"),
      force_balance(),
      contact_mismatches(),
  };
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 6.7;
  return t;
}

}  // namespace gpuphys::contact_dem
