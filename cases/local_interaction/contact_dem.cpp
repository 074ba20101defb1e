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

InputSet packing_set(std::string name, SetKind kind, Size size, const Packing& p) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{}x{}x{} lattice, jitter {}, radii {} to {}, shear {}, velocity noise {}, seed {}",
                        p.lattice[0], p.lattice[1], p.lattice[2], p.jitter, p.smallest, p.largest, p.shear,
                        p.noise, p.seed);
  s.make = [p] { return problem_of(grains::packing(p)); };
  return s;
}

// ---- checks ----

double norm(const HostArray& force, std::int64_t i) {
  return std::sqrt(force.value(3 * i) * force.value(3 * i) + force.value(3 * i + 1) * force.value(3 * i + 1) +
                   force.value(3 * i + 2) * force.value(3 * i + 2));
}

// Newton's third law.
Check force_balance() {
  return {"force_balance",
          CheckKind::local,
          "force",
          "|sum of all forces| / sum of |force|",
          64 * 0x1p-24,
          "the two forces of a pair are opposite, so the sum is zero up to the rounding of each grain's own "
          "sum: at most "
          "one unit roundoff of its size for each of the contacts that a grain has, 64 in the most crowded "
          "set",
          false,
          [](const Judged& j) {
            const HostArray& force = find(j.outputs, "force", "outputs");
            double sum[3] = {0, 0, 0}, size = 0;
            for (std::int64_t i = 0; i < force.shape()[0]; ++i) {
              for (int c = 0; c < 3; ++c) sum[c] += force.value(3 * i + c);
              size += norm(force, i);
            }
            const double rest = std::sqrt(sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]);
            return Measured{
                size > 0 ? rest / size : rest,
                fmt::format("sum ({:.6g}, {:.6g}, {:.6g}) of {:.6g} N in all", sum[0], sum[1], sum[2], size)};
          }};
}

// Grains that feel a force for one side only. Forces vanish with the overlap, so a pair decided differently
// by rounding carries next to none.
Check contact_mismatches() {
  constexpr double bound = 1e-3;
  return {"contact_mismatches",
          CheckKind::local,
          "force",
          "grains whose force is zero on one side and above 1e-3 rms on the other",
          0.5,
          "none: rounding can decide a pair differently only if its overlap is below 3e-7 of its distance, "
          "where its "
          "force is at most sqrt(0.3 x 3e-7) x 10 x 2 = 0.006 N, against an rms above 30 N",
          true,
          [](const Judged& j) {
            const HostArray& force = find(j.outputs, "force", "outputs");
            const HostArray& truth = find(*j.truth, "force", "truth");
            const std::int64_t n = force.shape()[0];
            double square = 0;
            for (std::int64_t i = 0; i < n; ++i) square += norm(truth, i) * norm(truth, i);
            const double least = bound * std::sqrt(square / static_cast<double>(n));
            Measured m;
            for (std::int64_t i = 0; i < n; ++i) {
              const double got = norm(force, i), expected = norm(truth, i);
              if ((got == 0) == (expected == 0) || !(got > least || expected > least)) continue;
              if (m.error == 0)
                m.detail = fmt::format("grain {}: got {:.6g} N, expected {:.6g} N", i, got, expected);
              ++m.error;
            }
            return m;
          }};
}

Check no_force(const std::string& why) {
  return {"no_force",
          CheckKind::invariant,
          "force",
          "largest |component|, N",
          0,
          why,
          false,
          [](const Judged& j) {
            const HostArray& force = find(j.outputs, "force", "outputs");
            Measured worst;
            for (std::int64_t i = 0; i < force.size(); ++i) {
              const double e = std::abs(force.value(i));
              if (!(e <= worst.error)) {
                worst = {e, fmt::format("{} = {:.9g}", index_text(force, i), force.value(i))};
                if (!std::isfinite(e)) return worst;
              }
            }
            return worst;
          }};
}

// Two grains: the law written out for a pair.
Check closed_form() {
  return {"closed_form",
          CheckKind::invariant,
          "force",
          "largest error of a component / size of the force",
          2e-6,
          "overlap is a tenth of the distance, so its rounding is worth ten times 2^-23 of the force, and "
          "the law "
          "adds a few units of its own",
          false,
          [](const Judged& j) {
            const Inputs in = bind_inputs<Inputs>(j.problem);
            double d[3], distance = 0;
            for (int c = 0; c < 3; ++c) {
              d[c] = static_cast<double>(in.x(0, c)) - static_cast<double>(in.x(1, c));
              distance += d[c] * d[c];
            }
            distance = std::sqrt(distance);
            const double a = in.radius(0), b = in.radius(1), overlap = a + b - distance;
            double separation = 0;
            for (int c = 0; c < 3; ++c) {
              separation +=
                  (static_cast<double>(in.v(0, c)) - static_cast<double>(in.v(1, c))) * d[c] / distance;
            }
            const double root = std::sqrt(a * b / (a + b) * overlap);
            const double size =
                root * (static_cast<double>(in.kn) * overlap - static_cast<double>(in.cn) * separation);
            const HostArray& force = find(j.outputs, "force", "outputs");
            Measured worst;
            for (int i = 0; i < 2; ++i) {
              for (int c = 0; c < 3; ++c) {
                const double expected = (i == 0 ? 1 : -1) * size * d[c] / distance;
                const double e = std::abs(force.value(3 * i + c) - expected) / size;
                if (!(e <= worst.error)) {
                  worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(force, 3 * i + c),
                                          force.value(3 * i + c), expected)};
                  if (!std::isfinite(e)) return worst;
                }
              }
            }
            return worst;
          }};
}

// ---- hard cases ----

InputSet hard(const std::string& stress, const std::string& about, std::function<std::vector<Grain>()> make) {
  return hard_case(stress, about, [make = std::move(make)] { return problem_of(make()); });
}

InputSet with(InputSet s, Check invariant) {
  s.invariants.push_back(std::move(invariant));
  return s;
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
  std::vector<Grain> all = cloud(21, 4000, {0, 0, 0}, 1.0, 0.045, 0.055);
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
  std::vector<Grain> all = cloud(22, 10000, {0.5, 0.5, 0.5}, 0.45, 0.01, 0.02);
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

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  sets.push_back(
      hard("coincident", "every fifth grain has the centre of another: no direction, no force", coincident));
  sets.push_back(
      hard("size_ratio_100", "4000 grains of 5 cm in the contact shells of three of 5 m", size_ratio));
  sets.push_back(hard("full_overlap", "64 grains within 20 cm, each in contact with all the others", [] {
    return cloud(25, 64, {3, -2, 1}, 0.1, 0.5, 0.6);
  }));
  sets.push_back(
      hard("crowded_cell", "10000 grains in one cell of the size that the largest asks for", crowded_cell));
  sets.push_back(hard("offset_1e4",
                      "a packing 10 km off the origin along each axis, where float32 resolves 1 mm", offset));
  sets.push_back(hard("far_apart", "five packings a thousand kilometres apart", far_apart));
  sets.push_back(hard("line_x", "3001 grains in a row along x: a box without width", [] { return line(0); }));
  sets.push_back(hard("line_z", "3001 grains in a row along z", [] { return line(2); }));
  sets.push_back(with(hard("one_grain", "a single grain",
                           [] {
                             return std::vector<Grain>{{{1, 2, 3}, {4, 5, 6}, 0.5}};
                           }),
                      no_force("there is nothing to touch")));
  sets.push_back(with(hard("two_grains", "one oblique contact",
                           [] {
                             return std::vector<Grain>{{{0.25, -0.5, 2}, {0.5, 0, -0.25}, 0.5},
                                                       {{0.85, -0.5, 2.8}, {-0.25, 0.5, 0.125}, 0.6}};
                           }),
                      closed_form()));
  sets.push_back(with(
      hard("just_touching", "a lattice of grains in approach whose overlaps are exactly zero", just_touching),
      no_force("no overlap, no contact")));
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
