// Input sets and checks of mass_spring_explicit (specification:
// cases/local_interaction/mass_spring_explicit.md).
#include "cases/local_interaction/mass_spring_explicit.hpp"

#include <fmt/format.h>

#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::mass_spring_explicit {
namespace {

using elastic::Deformation;
using elastic::SpringBody;
using elastic::Vec3;

struct Scalars {
  double k = 1000, dt = 0.005;
};

Problem problem_of(const SpringBody& body, Scalars s = {}) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(body.x.size())}, {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", s.k);
  p.set_scalar("dt", s.dt);
  return p;
}

Deformation public_field() {
  return {.periods = 4, .strain = 0.010, .jitter = 0.010, .speed = 1, .noise = 0.10, .seed = 1};
}
Deformation hidden_field() {
  return {.periods = 5, .strain = 0.012, .jitter = 0.008, .speed = 1, .noise = 0.12, .seed = 2};
}

// Bounds that small sets keep: what the FP32 baselines show, with some room.
constexpr double kChange = 1e-5, kChangeLocal = 6e-5;

Check tight_change() {
  return relative_l2_of_change(
      "v_new", "v", kChange,
      "a length of 1 m is known to 1e-7, a hundredth of which is stretch; lengths differ in "
      "their rounding, and the sum of a particle's springs averages it");
}
Check tight_local() {
  return local_error_of_change("v_new", "v", kChangeLocal,
                               "ten times the relative L2 error: the largest of some thousand errors");
}

InputSet lattice_set(std::string name, SetKind kind, Size size, std::array<std::int64_t, 3> points,
                     std::int64_t free_side, const Deformation& f) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "{}x{}x{} lattice and {}^3 free particles, {} periods, strain {}, jitter {}, noise {}, seed {}",
      points[0], points[1], points[2], free_side, f.periods, f.strain, f.jitter, f.noise, f.seed);
  s.make = [=] { return problem_of(elastic::spring_lattice(points, free_side, f)); };
  if (size == Size::smoke) s.invariants = {tight_change(), tight_local()};
  return s;
}

// ---- hard cases ----

SpringBody small_lattice(std::uint64_t seed) {
  Deformation f = public_field();
  f.seed = seed;
  f.periods = 1;
  return elastic::spring_lattice({9, 11, 10}, 3, f);
}

InputSet hard(const std::string& stress, const std::string& about, std::function<SpringBody()> make,
              Scalars s = {}, std::vector<Check> invariants = {}) {
  invariants.push_back(elastic::momentum_check(
      0x1p-20,
      "the two forces of a spring are opposite; what remains is the rounding of sums, a few 2^-24 each"));
  return hard_case(
      stress, about, [=] { return problem_of(make(), s); }, std::move(invariants));
}

// As hard(), with the bounds that hold where stretches are small and many.
InputSet hard_tight(const std::string& stress, const std::string& about, std::function<SpringBody()> make,
                    Scalars s = {}) {
  return hard(stress, about, std::move(make), s, {tight_change(), tight_local()});
}

SpringBody masses_over_six_decades() {
  SpringBody b = small_lattice(21);
  for (std::size_t i = 0; i < b.mass.size(); ++i) b.mass[i] = std::pow(10.0, 3 * uniform11(21, 50, i));
  return b;
}

SpringBody scaled(double factor) {
  SpringBody b = small_lattice(22);
  for (Vec3& x : b.x) {
    for (double& c : x) c *= factor;
  }
  for (Vec3& v : b.v) v = {0, 0, 0};
  for (double& r : b.rest) r *= factor;
  return b;
}

// Pairs at one place, with and without rest length: no direction, no force.
SpringBody coincident_pairs() {
  SpringBody b;
  for (std::int32_t i = 0; i < 66; ++i) {
    const Vec3 x{i % 7 == 0 ? -0.0 : 0.25 * (i / 2), -3.5 * (i / 2), 1e3};
    b.x.push_back(x);
    b.v.push_back({uniform11(24, 50, 3u * static_cast<unsigned>(i)), 0, -1});
    b.mass.push_back(1 + i);
    if (i % 2 == 0) continue;
    b.x[static_cast<std::size_t>(i)] = b.x[static_cast<std::size_t>(i - 1)];
    b.springs.push_back({i - 1, i});
    b.rest.push_back(i % 4 == 1 ? 1 : 0);
  }
  return b;
}

SpringBody offset() {
  SpringBody b = small_lattice(26);
  for (Vec3& x : b.x) x = {x[0] + 1e4, x[1] - 1e4, x[2] + 1e4};
  return b;
}

// 3-4-5 triangles around a column of points: every length is an integer and met exactly.
SpringBody exact_rest() {
  SpringBody b;
  for (std::int32_t i = 0; i < 37; ++i) {
    const double y = 4 * i;
    b.x.insert(b.x.end(), {{i % 2 ? 0.0 : -0.0, y, 0}, {3, y, 0}, {0, y, -3}});
    const std::int32_t p = 3 * i;
    const auto add = [&](std::int32_t a, std::int32_t c, double rest) {
      b.springs.push_back({a, c});
      b.rest.push_back(rest);
    };
    add(p, p + 1, 3);
    add(p + 2, p, 3);
    if (i == 0) continue;
    add(p, p - 3, 4);
    add(p - 3, p + 1, 5);
    add(p + 2, p - 3, 5);
  }
  b.v.assign(b.x.size(), {0, 0, 0});
  b.mass.assign(b.x.size(), 0.5);
  return b;
}

// One spring along y, 2 m long instead of 1 m, k = 8, dt = 1/4, masses 2 and 4: forces of 8 N, changes of 1
// and 1/2 m/s.
SpringBody one_spring() {
  SpringBody b;
  b.x = {{1, 2, 3}, {1, 4, 3}};
  b.v = {{0, 1, 0}, {0, 0, 2}};
  b.mass = {2, 4};
  b.springs = {{1, 0}};
  b.rest = {1};
  return b;
}

Check known(const std::string& array, std::vector<double> values) {
  return equals_known({.name = array + "_known",
                       .kind = CheckKind::invariant,
                       .array = array,
                       .quantity = "error over the largest value",
                       .tolerance = 1e-7,
                       .why = "every number of it is a small multiple of a power of two",
                       .needs_truth = false},
                      [values = std::move(values)](const Judged&) { return values; });
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  sets.push_back(hard_tight("soft", "k = 1, dt = 0.25", [] { return small_lattice(27); }, {1, 0.25}));
  sets.push_back(hard_tight("stiff", "k = 1e6, dt = 1e-4", [] { return small_lattice(28); }, {1e6, 1e-4}));
  sets.push_back(hard_case("no_stiffness", "k = 0",
                           [] {
                             return problem_of(small_lattice(29), {0, 0.125});
                           },
                           {elastic::velocity_kept_check(0, "no force")}));
  sets.push_back(hard("masses", "masses over six decades", masses_over_six_decades));
  sets.push_back(hard_tight("tiny", "a lattice 2^-49 times smaller: springs of 2e-15 m",
                            [] { return scaled(0x1p-49); }));
  sets.push_back(
      hard_tight("huge", "a lattice 2^49 times larger: springs of 6e14 m", [] { return scaled(0x1p49); }));
  sets.push_back(
      hard("degenerate", "repeated springs, springs to the same particle, of rest length 0, of length 0", [] {
        SpringBody b = small_lattice(23);
        elastic::make_degenerate(b);
        return b;
      }));
  sets.push_back(hard("coincident", "pairs at one place, held by nothing else", coincident_pairs, {},
                      {elastic::velocity_kept_check(0, "a spring without a direction has no force")}));
  sets.push_back(hard("hub_10000", "one particle holds 10000 springs",
                      [] { return elastic::hub_of_springs(10000, 25); }));
  sets.push_back(hard_tight("offset_1e4", "a lattice 10 km off the origin along each axis", offset));
  sets.push_back(hard("random_graph", "1025 particles, 10007 springs between any two",
                      [] { return elastic::random_graph(30, 1025, 10007); }, {1, 1e-3}));
  sets.push_back(
      hard("odd_33", "33 particles, 31 springs", [] { return elastic::random_graph(31, 33, 31); }));
  sets.push_back(
      hard("exact_rest", "every spring has its rest length exactly", exact_rest, {},
           {elastic::velocity_kept_check(1000 * 0.005 / 0.5 * 5 * 5 * 0x1p-22,
                                         "two units in the last place of five lengths of up to 5 m, for "
                                         "inexact square roots")}));
  sets.push_back(hard("one_spring", "two particles, numbers that are exact", one_spring, {8, 0.25},
                      {known("v_new", {0, 2, 0, 0, -0.5, 2}), known("x_new", {1, 2.5, 3, 1, 3.875, 3.5})}));
  sets.push_back(hard("one_particle", "a single particle with a spring to itself",
                      [] { return elastic::random_graph(32, 1, 1); }, {},
                      {elastic::velocity_kept_check(0, "nothing acts on it")}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Explicit step of a mass-spring system (symplectic Euler)";
  t.paper_number = 45;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      lattice_set("public", SetKind::open, Size::paper, {96, 96, 96}, 16, public_field()),
      lattice_set("hidden", SetKind::hidden, Size::paper, {96, 96, 96}, 16, hidden_field()),
      lattice_set("public_smoke", SetKind::open, Size::smoke, {31, 27, 34}, 5, public_field()),
      lattice_set("hidden_smoke", SetKind::hidden, Size::smoke, {26, 35, 29}, 6, hidden_field()),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  constexpr double v_local = 4e-5;
  t.checks = {
      relative_l2_check("x_new", 1e-6, "the paper's table of inputs and checks"),
      relative_l2_check("v_new", 5e-5, "the paper's table of inputs and checks"),
      local_error_check(
          "v_new", v_local,
          "a stretch of 0.01 m is a difference of lengths that are rounded to 1e-7 m; dt k / m = 5 per "
          "second makes 1e-6 m/s of the springs of a particle, and the rms is 0.5 m/s"),
      elastic::position_units_check(v_local),
      elastic::free_particles_check("springs"),
  };
  t.unordered = {{"n", {"springs"}}, {"m", {}}};
  t.target_floor_multiple = 3;
  return t;
}

}  // namespace gpuphys::mass_spring_explicit
