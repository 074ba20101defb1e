// Input sets and checks of dem (specification: cases/local_interaction/dem.md).
#include "cases/local_interaction/dem.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "cases/local_interaction/grain_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::dem {
namespace {

using grains::Grain;
using grains::Packing;
using grains::Vec3;

struct Scalars {
  double kn = 600, cn = 10, gt = 10, mu = 0.5, rho = 1, dt = 0.01;
};

Problem problem_of(const std::vector<Grain>& grains, const Scalars& s) {
  Problem p =
      make_problem(describe<Inputs, Outputs<float>>(), {{"n", static_cast<std::int64_t>(grains.size())}});
  for (const auto& [name, value] :
       {std::pair{"kn", s.kn}, {"cn", s.cn}, {"gt", s.gt}, {"mu", s.mu}, {"rho", s.rho}, {"dt", s.dt}}) {
    p.set_scalar(name, value);
  }
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), omega = p.inputs[2].as<float>(),
             radius = p.inputs[3].as<float>();
  for (std::size_t i = 0; i < grains.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      x[3 * i + c] = static_cast<float>(grains[i].x[c]);
      v[3 * i + c] = static_cast<float>(grains[i].v[c]);
      omega[3 * i + c] = static_cast<float>(grains[i].omega[c]);
    }
    radius[i] = static_cast<float>(grains[i].radius);
  }
  return p;
}

Packing public_packing(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 1,
          .jitter = 0.12,
          .smallest = 0.50,
          .largest = 0.60,
          .shear = 0.010,
          .noise = 0.50,
          .spin = 0.60};
}
Packing hidden_packing(std::array<std::int64_t, 3> lattice) {
  return {.lattice = lattice,
          .seed = 2,
          .jitter = 0.10,
          .smallest = 0.485,
          .largest = 0.605,
          .shear = 0.013,
          .noise = 0.45,
          .spin = 0.72};
}
/// Of the hard sets: as public, another seed.
Packing small_packing(std::uint64_t seed, std::array<std::int64_t, 3> lattice) {
  Packing p = public_packing(lattice);
  p.seed = seed;
  return p;
}

InputSet packing_set(std::string name, SetKind kind, Size size, const Packing& p) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "{}x{}x{} lattice, jitter {}, radii {} to {}, shear {}, velocity noise {}, spin {}, seed {}",
      p.lattice[0], p.lattice[1], p.lattice[2], p.jitter, p.smallest, p.largest, p.shear, p.noise, p.spin,
      p.seed);
  s.make = [p] { return problem_of(grains::packing(p), {}); };
  return s;
}

// ---- checks ----

double length(const Vec3& a) {
  return std::hypot(a[0], a[1], a[2]);
}
Vec3 vector_at(const HostArray& a, std::int64_t i) {
  return {a.value(3 * i), a.value(3 * i + 1), a.value(3 * i + 2)};
}
Vec3 minus(const Vec3& a, const Vec3& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

struct Weights {
  const HostArray& radius;
  double density;

  explicit Weights(const Judged& j) : radius(input(j, "radius")), density(j.problem.scalar("rho")) {}
  double mass(std::int64_t i) const {
    const double r = radius.value(i);
    return 4.0 / 3.0 * std::numbers::pi * density * r * r * r;
  }
  double inertia(std::int64_t i) const { return 0.4 * mass(i) * radius.value(i) * radius.value(i); }
};

constexpr double kBalance = 64 * 0x1p-24;

Check momentum() {
  return conserved_sum(
      {.name = "momentum",
       .array = "v_new",
       .quantity = "change of the sum of m v over the sum of m (|v| + |v'|)",
       .tolerance = kBalance,
       .why = "forces of a pair are opposite; each grain's own sum and v' are rounded, one unit roundoff for "
              "each of the contacts that a grain has, 64 in the most crowded set",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &before = input(j, "v"), &after = output(j, "v_new");
        const Weights weights(j);
        double scale = 0;
        for (std::int64_t i = 0; i < before.shape()[0]; ++i)
          scale += weights.mass(i) * (length(vector_at(before, i)) + length(vector_at(after, i)));
        return Terms{.count = before.shape()[0],
                     .term =
                         [weights, &before, &after](std::int64_t i) {
                           const Vec3 d = minus(vector_at(after, i), vector_at(before, i));
                           const double m = weights.mass(i);
                           return Vec3{m * d[0], m * d[1], m * d[2]};
                         },
                     .scale = scale};
      });
}

// About the mean position. x' = x + dt v', so m x' x v' is m x x v'.
Check angular_momentum() {
  return conserved_sum(
      {.name = "angular_momentum",
       .array = "v_new, omega_new",
       .quantity = "change of the sum of m x cross v + I omega over the sum of the sizes of its terms",
       .tolerance = kBalance,
       .why =
           "the arms of a contact add up to the distance, so friction turns the grains as much as it moves "
           "them; rounding as for the momentum",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &x = input(j, "x"), &v = input(j, "v"), &v_new = output(j, "v_new"),
                        &omega = input(j, "omega"), &omega_new = output(j, "omega_new");
        const std::int64_t n = x.shape()[0];
        const Weights weights(j);
        Vec3 centre{0, 0, 0};
        for (std::int64_t i = 0; i < n; ++i) {
          for (std::size_t c = 0; c < 3; ++c) centre[c] += vector_at(x, i)[c] / static_cast<double>(n);
        }
        double scale = 0;
        for (std::int64_t i = 0; i < n; ++i) {
          scale += weights.mass(i) * length(minus(vector_at(x, i), centre)) *
                       (length(vector_at(v, i)) + length(vector_at(v_new, i))) +
                   weights.inertia(i) * (length(vector_at(omega, i)) + length(vector_at(omega_new, i)));
        }
        return Terms{.count = n,
                     .term =
                         [&x, &v, &v_new, &omega, &omega_new, centre, weights](std::int64_t i) {
                           const Vec3 a = minus(vector_at(x, i), centre);
                           const Vec3 d = minus(vector_at(v_new, i), vector_at(v, i));
                           const Vec3 w = minus(vector_at(omega_new, i), vector_at(omega, i));
                           const double m = weights.mass(i), inertia = weights.inertia(i);
                           return Vec3{m * (a[1] * d[2] - a[2] * d[1]) + inertia * w[0],
                                       m * (a[2] * d[0] - a[0] * d[2]) + inertia * w[1],
                                       m * (a[0] * d[1] - a[1] * d[0]) + inertia * w[2]};
                         },
                     .scale = scale};
      });
}

// Grains that are pushed for one side only. Forces vanish with the overlap, so a pair decided differently by
// rounding carries next to none.
Check contact_mismatches() {
  return count_where(
      {.name = "contact_mismatches",
       .array = "v_new",
       .quantity = "grains whose velocity stays for one side and changes by more than 1e-3 rms for the other",
       .tolerance = 0.5,
       .why = "none: rounding can decide a pair differently only if its overlap is below 3e-7 of its "
              "distance, where it carries less"},
      [](const Judged& j) {
        const HostArray &v = input(j, "v"), &got = output(j, "v_new"), &expected = truth(j, "v_new");
        const std::int64_t n = v.shape()[0];
        const auto change = [&v](const HostArray& after, std::int64_t i) {
          const Vec3 a = vector_at(after, i);
          return length(minus(
              {static_cast<double>(static_cast<float>(a[0])), static_cast<double>(static_cast<float>(a[1])),
               static_cast<double>(static_cast<float>(a[2]))},
              vector_at(v, i)));
        };
        double square = 0;
        for (std::int64_t i = 0; i < n; ++i) square += change(expected, i) * change(expected, i);
        const double least = 1e-3 * std::sqrt(square / static_cast<double>(n));
        return Items{n, [=, &got, &expected](std::int64_t i) {
                       const double a = change(got, i), b = change(expected, i);
                       return (a == 0) != (b == 0) && !(a <= least && b <= least) ? 1.0 : 0.0;
                     }};
      });
}

constexpr const char* kPaper = "the paper's table of inputs and checks";

Check v_l2() {
  return relative_l2_of_change("v_new", "v", 2e-4, kPaper);
}
Check omega_l2() {
  return relative_l2_of_change("omega_new", "omega", 4e-4, kPaper);
}
Check v_local() {
  return local_error_of_change(
      "v_new", "v", 5e-4,
      "rounding is worth most where a contact has only just begun: 2e-7 m of overlap are 0.005 N of damping, "
      "against an rms of tens of newtons; a lost or invented contact is of the size of the rms");
}
Check omega_local() {
  return local_error_of_change("omega_new", "omega", 1e-3,
                               "as for the velocity; friction is capped by mu times such a force, and its "
                               "direction is as good as the slip velocity");
}

/// Positions where float32 is coarser than a step: the truth's number or its neighbour.
Check x_within_one_ulp() {
  return count_where(
      {.name = "x_within_one_ulp",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "coordinates more than a unit of the truth's last place, and 1e-7 m, from the truth",
       .tolerance = 0.5,
       .why = "float32 is coarser here than a step: relative errors of the displacement mean nothing"},
      [](const Judged& j) {
        const HostArray &got = output(j, "x_new"), &expected = truth(j, "x_new");
        return Items{got.size(), [&got, &expected](std::int64_t i) {
                       const float e = static_cast<float>(expected.value(i));
                       const double unit = std::nextafter(std::abs(e), INFINITY) - std::abs(e);
                       const double error = std::abs(got.value(i) - static_cast<double>(e));
                       return error <= std::max(unit, 1e-7) ? 0.0 : 1.0;
                     }};
      });
}

// Of small sets: ten times tighter than the paper, and the local errors with it.
std::vector<Check> tight() {
  const std::string why = "the FP32 baseline stays below a tenth of this";
  return {as_invariant(v_l2(), "v_tight", 1e-5, why), as_invariant(omega_l2(), "omega_tight", 2e-5, why),
          as_invariant(v_local(), "v_tight_local", 1e-4, why),
          as_invariant(omega_local(), "omega_tight_local", 2e-4, why)};
}

Check unchanged(const std::string& array, const std::string& from, const std::string& why) {
  return equals_known({.name = array + "_unchanged",
                       .kind = CheckKind::invariant,
                       .array = array,
                       .quantity = array + " - " + from,
                       .tolerance = 0,
                       .why = why,
                       .needs_truth = false},
                      [from](const Judged& j) {
                        const HostArray& a = input(j, from);
                        std::vector<double> values(static_cast<std::size_t>(a.size()));
                        for (std::int64_t i = 0; i < a.size(); ++i)
                          values[static_cast<std::size_t>(i)] = a.value(i);
                        return values;
                      });
}

/// `array` is `from` + dt change / what it acts on: mass (power 3) or moment of inertia (power 5).
Check changes_by(const std::string& array, const std::string& from, std::vector<double> load, double per_load,
                 const std::string& why) {
  return equals_known({.name = array + "_by_hand",
                       .kind = CheckKind::invariant,
                       .array = array,
                       .quantity = array + " against the change worked out in dem.md",
                       .tolerance = 1e-6,
                       .why = why,
                       .needs_truth = false},
                      [from, load = std::move(load), per_load](const Judged& j) {
                        std::vector<double> values(load.size());
                        for (std::size_t i = 0; i < load.size(); ++i)
                          values[i] = input(j, from).value(static_cast<std::int64_t>(i)) + per_load * load[i];
                        return values;
                      });
}

// ---- hard cases ----

using MakeGrains = std::function<std::vector<Grain>()>;

InputSet hard(const std::string& stress, const std::string& about, const Scalars& s, MakeGrains make,
              std::vector<Check> invariants) {
  return hard_case(
      stress, about, [make = std::move(make), s] { return problem_of(make(), s); }, std::move(invariants));
}
MakeGrains packing_of(const Packing& p) {
  return [p] { return grains::packing(p); };
}
std::vector<Check> and_tight(std::vector<Check> checks) {
  for (Check& c : tight()) checks.push_back(std::move(c));
  return checks;
}

double random11(std::uint64_t seed, std::uint64_t stream, std::size_t i) {
  return uniform11(seed, stream, static_cast<std::uint64_t>(i));
}

void stir(std::vector<Grain>& all, std::uint64_t seed, double speed, double spin) {
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      all[i].v[c] = speed * random11(seed, 2, 3 * i + c);
      all[i].omega[c] = spin * random11(seed, 3, 3 * i + c);
    }
  }
}

// Grains uniform in a cube of half width `half` about `centre`; radii uniform between the two given.
std::vector<Grain> cloud(std::uint64_t seed, std::size_t n, Vec3 centre, double half, double smallest,
                         double largest) {
  std::vector<Grain> all(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c) all[i].x[c] = centre[c] + half * random11(seed, 0, 3 * i + c);
    all[i].radius = smallest + (largest - smallest) * (0.5 + 0.5 * random11(seed, 1, i));
  }
  stir(all, seed, 0.5, 0.6);
  return all;
}

std::vector<Grain> coincident() {
  std::vector<Grain> all = grains::packing(small_packing(11, {9, 7, 8}));
  // Every fifth grain sits in the centre of the one before it, with its own radius and motion.
  for (std::size_t i = 1; i < all.size(); i += 5) all[i].x = all[i - 1].x;
  return all;
}

// Small grains in the contact shell of a large one, which comes last.
std::vector<Grain> around(std::uint64_t seed, std::size_t n, double small, double large) {
  std::vector<Grain> all = cloud(seed, n, {0, 0, 0}, 1.0, 0.9 * small, 1.1 * small);
  const Vec3 centre{0.5, -1, 0.25};
  for (std::size_t i = 0; i < n; ++i) {
    Vec3& x = all[i].x;
    const double size = length(x), shell = large + small * random11(seed, 4, i);
    for (std::size_t c = 0; c < 3; ++c) x[c] = centre[c] + x[c] / size * shell;
  }
  all.push_back({centre, {0.25, -0.5, 0.125}, large, {0.0625, 0.125, -0.25}});
  return all;
}

std::vector<Grain> crowded_cell() {
  // The large grain makes a cell wider than the whole cloud.
  std::vector<Grain> all = cloud(22, 4000, {0.5, 0.5, 0.5}, 0.45, 0.01, 0.03);
  all.push_back({{0.5, 0.5, -0.4}, {0, 0, 0}, 0.5, {1, 2, 3}});
  return all;
}

std::vector<Grain> far_apart() {
  // Positions of a million metres resolve 1/16 m: lattices keep their contacts, on coarser displacements.
  std::vector<Grain> all;
  std::uint64_t seed = 31;
  for (const Vec3& corner :
       {Vec3{0, 0, 0}, Vec3{1e6, 0, 0}, Vec3{-1e6, 1e6, 3}, Vec3{0, -1e6, 1e6}, Vec3{7, 1e3, -1e6}}) {
    Packing p = small_packing(seed++, {5, 4, 6});
    p.corner = corner;
    for (const Grain& g : grains::packing(p)) all.push_back(g);
  }
  return all;
}

std::vector<Grain> line(std::size_t axis, std::size_t n) {
  std::vector<Grain> all(n);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t at = i * 1000 % n;  // any order but that of the line
    all[i].x[axis] = static_cast<double>(at) + 0.12 * random11(23, 0, i);
    all[i].radius = 0.55 + 0.05 * random11(23, 1, i);
  }
  stir(all, 23, 0.5, 0.6);
  return all;
}

std::vector<Grain> just_touching() {
  std::vector<Grain> all;
  for (int i = 0; i < 6 * 5 * 7; ++i) {
    const Vec3 x{static_cast<double>(i / 35), static_cast<double>(i / 7 % 5), static_cast<double>(i % 7)};
    all.push_back(
        {x, {0.5 * random11(24, 2, static_cast<std::size_t>(i)), -x[1], -x[2]}, 0.5, {1, -2, x[1]}});
  }
  return all;
}

// Grains without any motion, of either sign of zero.
std::vector<Grain> at_rest() {
  std::vector<Grain> all = grains::packing(small_packing(26, {7, 6, 9}));
  for (std::size_t i = 0; i < all.size(); ++i) {
    const double zero = i % 2 == 0 ? 0.0 : -0.0;
    all[i].v = {zero, -zero, zero};
    all[i].omega = {-zero, zero, zero};
  }
  return all;
}

// Pairs 5 m apart whose centres are nearer than a thousandth of their radii.
std::vector<Grain> close_centres() {
  std::vector<Grain> all;
  for (int k = 3; k <= 12; ++k) {
    const double d = std::pow(10.0, -k), x = 5.0 * k;
    all.push_back({{x, 0, 0}, {}, 0.5});
    all.push_back({{x, 0.6 * d, k % 2 == 0 ? 0.8 * d : -0.8 * d}, {}, 0.55});
  }
  stir(all, 27, 0.5, 0.6);
  return all;
}

// Pairs along x that slide at 1e-2 to 1e-10 m/s and no more.
std::vector<Grain> slow_sliding() {
  std::vector<Grain> all;
  for (int k = 2; k <= 10; ++k) {
    const double s = std::pow(10.0, -k), y = 5.0 * k;
    all.push_back({{0.75, y, 0}, {0, k % 2 == 0 ? s : 0, k % 2 == 0 ? 0 : -s}, 0.5});
    all.push_back({{0, y, 0}, {0, 0, 0}, 0.5});
  }
  return all;
}

// n = (3/5, 4/5, 0), d = 5/4, overlap 1, sqrt(r* overlap) = 3/4, arms 5/8; slip (1/2, -3/8, 3/2) of size
// 13/8.
std::vector<Grain> three_four_five() {
  return {{{0.75, 1, 0}, {-0.5, -1, 1}, 1.125, {0, 0, 0.75}},
          {{0, 0, 0}, {0.25, 0, -0.5}, 1.125, {0, 0, 0.25}}};
}
// kn overlap = 16 N/m, cn s = -5 N/m: the normal force is 3/4 x 21 = 63/4 N.
constexpr Scalars kThreeFourFive{.kn = 16, .cn = 4, .gt = 2, .mu = 0.5, .rho = 2, .dt = 0x1p-6};

// The changes of both grains of three_four_five() under friction of `factor` times the slip.
std::vector<Check> three_four_five_by_hand(double factor, const std::string& why) {
  const Vec3 t{-factor * 0.5, factor * 0.375, -factor * 1.5}, n{0.6, 0.8, 0};
  const Vec3 force{15.75 * n[0] + t[0], 15.75 * n[1] + t[1], t[2]};
  const Vec3 torque{-0.625 * n[1] * t[2], 0.625 * n[0] * t[2], -0.625 * (n[0] * t[1] - n[1] * t[0])};
  const double r = 1.125, mass = 4.0 / 3.0 * std::numbers::pi * kThreeFourFive.rho * r * r * r;
  return {changes_by("v_new", "v", {force[0], force[1], force[2], -force[0], -force[1], -force[2]},
                     kThreeFourFive.dt / mass, why),
          changes_by("omega_new", "omega", {torque[0], torque[1], torque[2], torque[0], torque[1], torque[2]},
                     kThreeFourFive.dt / (0.4 * mass * r * r), why)};
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet s) { sets.push_back(std::move(s)); };
  add(hard("coincident", "every fifth grain has the centre of another: no direction, no force, no torque",
           {.kn = 900, .dt = 0.004}, coincident, tight()));
  add(hard("size_ratio_100", "2000 grains of 5 cm in the contact shell of one of 5 m",
           {.mu = 0.75, .rho = 2.5}, [] { return around(21, 2000, 0.05, 5.0); }, {}));
  add(hard("size_ratio_250", "600 grains of 5 cm in the contact shell of one of 12.5 m", {.rho = 400},
           [] { return around(28, 600, 0.05, 12.5); }, {}));
  Packing mixed = small_packing(29, {9, 11, 8});
  mixed.smallest = 0.25, mixed.largest = 0.75;
  add(hard("radii_1_to_3",
           "a packing whose radii differ by up to three: arms and inertia are each grain's own",
           {.cn = 4, .mu = 0.3}, packing_of(mixed), tight()));
  Packing equal = small_packing(32, {8, 9, 11});
  equal.smallest = equal.largest = 0.6;
  add(hard("monodisperse", "all radii 0.6: contacts out to the very edge of the cells searched",
           {.gt = 3, .rho = 1.5}, packing_of(equal), tight()));
  equal.lattice = {1, 11, 3};
  add(hard("grains_33", "33 grains in a slab: one more than a warp", {.dt = 0.02}, packing_of(equal),
           tight()));
  add(hard(
      "full_overlap", "64 grains within 20 cm, each in contact with all the others", {.kn = 300, .gt = 3},
      [] {
        return cloud(25, 64, {3, -2, 1}, 0.1, 0.2, 0.9);
      },
      tight()));
  add(hard("crowded_cell", "4000 grains in one cell of the size that the largest asks for",
           {.kn = 2e4, .cn = 300, .rho = 300, .dt = 0.001}, crowded_cell, {}));
  const auto line_of = [](std::size_t axis, std::size_t n) { return [axis, n] { return line(axis, n); }; };
  add(hard("line_x", "3001 grains in a row along x: a box without width", {.kn = 900}, line_of(0, 3001),
           tight()));
  add(hard("line_y", "1501 grains in a row along y", {.cn = 20}, line_of(1, 1501), tight()));
  add(hard("line_z", "3001 grains in a row along z", {.gt = 20}, line_of(2, 3001), tight()));
  Packing spinning = small_packing(33, {6, 7, 5});
  spinning.spin = 1e4;
  add(hard("spin_1e4", "surfaces slide at kilometres per second: friction at its cap everywhere", {},
           packing_of(spinning), {as_invariant(v_l2(), "v_tight", 1e-5, "as in other small sets")}));
  add(hard("rough", "mu = 100: the cap is never reached, friction is viscous", {.mu = 100, .dt = 0.005},
           packing_of(small_packing(34, {6, 9, 7})), tight()));
  add(hard("smooth", "mu = 0: no friction", {.mu = 0}, packing_of(small_packing(35, {7, 5, 9})),
           {unchanged("omega_new", "omega", "nothing turns a grain without friction"),
            as_invariant(v_l2(), "v_tight", 1e-5, "the FP32 baseline stays below a tenth of this")}));
  add(hard("without_gt", "gt = 0: no friction", {.gt = 0}, packing_of(small_packing(36, {5, 9, 6})),
           {unchanged("omega_new", "omega", "nothing turns a grain without friction"),
            as_invariant(v_l2(), "v_tight", 1e-5, "the FP32 baseline stays below a tenth of this")}));
  add(hard("stiff", "a stiff and dense material at a short step",
           {.kn = 5e7, .cn = 2e4, .gt = 5e3, .mu = 0.25, .rho = 2500, .dt = 2e-4},
           packing_of(small_packing(37, {8, 6, 9})), tight()));
  add(hard("at_rest", "no motion, zeros of either sign: no slip, so no friction", {}, at_rest,
           {exactly_zero("omega_new", "nothing slides"),
            as_invariant(v_l2(), "v_tight", 1e-5, "the FP32 baseline stays below a tenth of this")}));
  add(hard("close_centres", "pairs 1e-3 to 1e-12 m apart: a direction as good as any", {.mu = 2},
           close_centres, tight()));
  add(hard("slow_sliding", "pairs that slide at 1e-2 to 1e-10 m/s, with friction at its cap", {.gt = 1e12},
           slow_sliding, tight()));
  add(hard("one_grain", "a single grain flies on: dyadic numbers, so the position is exact", {.dt = 0x1p-6},
           [] {
             return std::vector<Grain>{{{1, 2, 3}, {4, 5, 6}, 0.5, {7, -8, 9}}};
           },
           {unchanged("v_new", "v", "there is nothing to touch"),
            unchanged("omega_new", "omega", "there is nothing to touch"),
            equals_known({.name = "x_by_hand",
                          .kind = CheckKind::invariant,
                          .array = "x_new",
                          .quantity = "x + v/64",
                          .tolerance = 0,
                          .why = "float32 holds it",
                          .needs_truth = false},
                         [](const Judged&) {
                           return std::vector<double>{1.0625, 2.078125, 3.09375};
                         })}));
  add(hard("just_touching", "a lattice of grains in approach whose overlaps are exactly zero", {},
           just_touching,
           {unchanged("v_new", "v", "no overlap, no contact"),
            unchanged("omega_new", "omega", "no overlap, no contact")}));
  add(hard(
      "sticking_pair", "one oblique contact of a 3-4-5 triangle, friction below its cap", kThreeFourFive,
      three_four_five,
      and_tight(three_four_five_by_hand(2, "the law by hand; gt slip = 3.25 N is below the cap of 7.875"))));
  Scalars slipping = kThreeFourFive;
  slipping.mu = 0.125;
  add(hard("slipping_pair", "the same with friction at its cap", slipping, three_four_five,
           and_tight(three_four_five_by_hand(63.0 / 52,
                                             "the law by hand; the cap of 63/32 N over the slip of 13/8"))));
  // Along x, arms 3/8: (3/8)(omega_i + omega_j) x n = (0, 9/8, -3/4), which is the relative velocity.
  add(hard("rolling_pair", "two grains that roll upon each other without slip", {.dt = 0x1p-6},
           [] {
             return std::vector<Grain>{{{0.75, 0, 0}, {0, 1.125, -0.75}, 0.5, {5, 4, 2}},
                                       {{0, 0, 0}, {0, 0, 0}, 0.5, {-3, -2, 1}}};
           },
           {changes_by("v_new", "v", {37.5, 0, 0, -37.5, 0, 0},
                       0x1p-6 / (4.0 / 3.0 * std::numbers::pi * 0.125), "no slip, no friction"),
            changes_by("omega_new", "omega", std::vector<double>(6, 0.0), 0, "no slip, no friction")}));
  // Float32 is coarser than a step here.
  const std::vector<Check> apart{v_l2(),     omega_l2(),           v_local(),         omega_local(),
                                 momentum(), contact_mismatches(), x_within_one_ulp()};
  Packing offset = small_packing(38, {11, 12, 13});
  offset.corner = {1e4, -1e4, 1e4};
  for (auto& [stress, about, make] :
       {std::tuple{"offset_1e4",
                   "a packing 10 km off the origin along each axis, where float32 resolves 1 mm",
                   packing_of(offset)},
        {"far_apart", "five packings a thousand kilometres apart", MakeGrains(far_apart)}}) {
    InputSet s = hard(stress, about, {}, make, apart);
    s.use_task_checks = false;
    add(std::move(s));
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "One DEM time step with frictional contacts between spherical grains";
  t.paper_number = 48;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      packing_set("public", SetKind::open, Size::paper, public_packing({144, 128, 112})),
      packing_set("hidden", SetKind::hidden, Size::paper, hidden_packing({144, 128, 112})),
      packing_set("public_smoke", SetKind::open, Size::smoke, public_packing({23, 19, 27})),
      packing_set("hidden_smoke", SetKind::hidden, Size::smoke, hidden_packing({19, 27, 22})),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_of_change("x_new", "x", 3e-4, kPaper),
      v_l2(),
      omega_l2(),
      local_error_of_change(
          "x_new", "x", 1e-2,
          "a step is 0.005 m and float32 resolves 1.5e-5 m at 144 m, so that one rounding the "
          "other way is worth 4e-3 of it"),
      v_local(),
      omega_local(),
      momentum(),
      angular_momentum(),
      contact_mismatches(),
  };
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 8;
  return t;
}

}  // namespace gpuphys::dem
