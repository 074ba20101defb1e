// Input sets and checks of mass_spring_newtonian_implicit (specification:
// cases/global_solve/mass_spring_newtonian_implicit.md).
#include "cases/global_solve/mass_spring_newtonian_implicit.hpp"

#include <fmt/format.h>

#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "cases/global_solve/newton_checks.hpp"
#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::mass_spring_newtonian_implicit {
namespace {

using elastic::Deformation;
using elastic::SpringBody;
using elastic::Vec3;

struct Scalars {
  double k = 1e4, dt = 0.02, tol = 1e-3;
};

Problem problem_of(const SpringBody& body, Scalars s = {}) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(body.x.size())}, {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", s.k);
  p.set_scalar("dt", s.dt);
  p.set_scalar("tol", s.tol);
  return p;
}

Deformation public_field() {
  return {.periods = 4, .strain = 0.010, .jitter = 0.005, .speed = 10, .noise = 0.10, .seed = 1};
}
Deformation hidden_field() {
  return {.periods = 3, .strain = 0.010, .jitter = 0.006, .speed = 10, .noise = 0.12, .seed = 2};
}

// For a lattice of a quarter of the points: the same wavelengths, so that a step deforms it as much.
Deformation lengthened(Deformation f) {
  f.periods /= 4;
  return f;
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
  return s;
}

// Springs in FP64 for the checks.
struct Spring {
  std::size_t a, b;  // first coordinates
  double d[3], length, rest;
};
template <class Visit>
void for_each_spring(const Problem& p, const std::vector<double>& z, Visit&& visit) {
  const auto ends = find(p.inputs, "springs", "inputs").as<std::int32_t>();
  const HostArray& rest = find(p.inputs, "rest", "inputs");
  for (std::int64_t j = 0; j < rest.size(); ++j) {
    Spring s{3 * static_cast<std::size_t>(ends[static_cast<std::size_t>(2 * j)]),
             3 * static_cast<std::size_t>(ends[static_cast<std::size_t>(2 * j + 1)]),
             {},
             0,
             rest.value(j)};
    for (std::size_t c = 0; c < 3; ++c) s.d[c] = z[s.a + c] - z[s.b + c];
    s.length = std::sqrt(s.d[0] * s.d[0] + s.d[1] * s.d[1] + s.d[2] * s.d[2]);
    visit(s);
  }
}

newton::Elastic springs() {
  return {.add_gradient =
              [](const Problem& p, const std::vector<double>& z, std::vector<double>& g) {
                const double k = p.scalar("k");
                for_each_spring(p, z, [&](const Spring& s) {
                  if (s.length == 0) return;
                  for (std::size_t c = 0; c < 3; ++c) {
                    const double f = k * (s.length - s.rest) * s.d[c] / s.length;
                    g[s.a + c] += f;
                    g[s.b + c] -= f;
                  }
                });
              },
          .energy =
              [](const Problem& p, const std::vector<double>& z) {
                double sum = 0;
                for_each_spring(p, z,
                                [&](const Spring& s) { sum += (s.length - s.rest) * (s.length - s.rest); });
                return 0.5 * p.scalar("k") * sum;
              }};
}

// ---- hard cases ----

SpringBody small_lattice(std::uint64_t seed) {
  Deformation f = public_field();
  f.seed = seed;
  f.periods = 1;
  return elastic::spring_lattice({9, 7, 8}, 3, f);
}

InputSet hard(const std::string& stress, const std::string& about, std::function<SpringBody()> make,
              Scalars s = {}) {
  return hard_case(stress, about, [=] { return problem_of(make(), s); },
                   {elastic::momentum_check(
                       1e-2, "what tol leaves of the gradient; the forces of a spring are opposite")});
}

SpringBody masses_over_three_decades() {
  SpringBody b = small_lattice(21);
  for (std::size_t i = 0; i < b.mass.size(); ++i) b.mass[i] = std::pow(10.0, 1.5 * uniform11(21, 50, i));
  return b;
}

// Springs twice as long as the distances of their ends: the Hessian is far from positive definite.
SpringBody compressed() {
  SpringBody b = small_lattice(22);
  for (double& r : b.rest) r *= 2;
  return b;
}

SpringBody zero_rest() {
  SpringBody b = small_lattice(24);
  for (double& r : b.rest) r = 0;
  return b;
}

SpringBody two_parts() {
  SpringBody b = small_lattice(27), other = small_lattice(28);
  const auto n = static_cast<std::int32_t>(b.x.size());
  for (std::size_t i = 0; i < other.x.size(); ++i) {
    b.x.push_back({other.x[i][0], other.x[i][1] - 40, other.x[i][2]});
    b.v.push_back(other.v[i]);
    b.mass.push_back(0.1 * other.mass[i]);
  }
  for (std::size_t j = 0; j < other.springs.size(); ++j) {
    b.springs.push_back({other.springs[j][0] + n, other.springs[j][1] + n});
    b.rest.push_back(other.rest[j]);
  }
  return b;
}

// 3-4-5 triangles that move as one by multiples of 2^-8: y is at rest exactly, and is the answer.
SpringBody rigid() {
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
  b.v.assign(b.x.size(), {1, -2, 0.5});
  b.mass.assign(b.x.size(), 0.75);
  return b;
}
Check rigid_known() {
  return equals_known(
      {.name = "x_new_known",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "x_new - (x + dt v), m",
       .tolerance = 1e-5,
       .why = "y is at rest; a few units in the last place of 150 m for what inexact roots make of it",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &x = input(j, "x"), &v = input(j, "v");
        std::vector<double> y(static_cast<std::size_t>(x.size()));
        for (std::int64_t c = 0; c < x.size(); ++c)
          y[static_cast<std::size_t>(c)] = x.value(c) + 0.125 * v.value(c);
        return y;
      },
      1);
}

// One spring along y, 3 m, rest length 1 m, dt^2 k = 1, unit masses: u + (3 - 2u - 1)(-1) = 0, u = 2/3.
SpringBody one_spring() {
  SpringBody b;
  b.x = {{1, 0, 0}, {1, 3, 0}};
  b.v = {{0, 0, 0}, {0, 0, 0}};
  b.mass = {1, 1};
  b.springs = {{0, 1}};
  b.rest = {1};
  return b;
}
Check one_spring_known() {
  return equals_known(
      {.name = "x_new_known",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "error over 1 m",
       .tolerance = 1e-3,
       .why = "a linear problem along the spring, solved to tol = 1e-4 of a force of 2 N",
       .needs_truth = false},
      [](const Judged&) { return std::vector<double>{1, 2.0 / 3, 0, 1, 3 - 2.0 / 3, 0}; }, 1);
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto lattice = [](std::uint64_t seed) { return [seed] { return small_lattice(seed); }; };
  sets.push_back(hard("loose", "tol = 0.1", lattice(31), {1e4, 0.02, 0.1}));
  sets.push_back(hard("tight", "tol = 2e-4", lattice(32), {1e4, 0.02, 2e-4}));
  sets.push_back(hard("soft", "k = 100, dt = 0.1", lattice(33), {100, 0.1, 1e-3}));
  sets.push_back(hard("stiff", "k = 1e8: dt^2 k / mass = 4e4", lattice(34), {1e8, 0.02, 1e-3}));
  sets.push_back(hard("masses", "masses over three decades", masses_over_three_decades));
  sets.push_back(hard("compressed", "springs twice as long as the distances of their ends", compressed));
  sets.push_back(hard("zero_rest", "rest lengths of zero", zero_rest));
  sets.push_back(
      hard("degenerate", "repeated springs, springs to the same particle, of rest length 0, of length 0", [] {
        SpringBody b = small_lattice(23);
        elastic::make_degenerate(b);
        return b;
      }));
  sets.push_back(
      hard("hub_1000", "one particle holds 1000 springs", [] { return elastic::hub_of_springs(1000, 25); }));
  sets.push_back(hard("odd_33", "33 particles, 31 springs", [] { return elastic::random_graph(31, 33, 31); },
                      {100, 0.1, 1e-3}));
  sets.push_back(hard("two_parts", "two lattices without a connection, masses ten times apart", two_parts));
  sets.push_back(
      hard("rigid", "3-4-5 triangles at rest, moving as one: y is the answer", rigid, {1e4, 0.125, 1e-3}));
  sets.back().use_task_checks = false;
  sets.back().invariants.push_back(rigid_known());
  sets.push_back(hard("one_spring", "two particles by hand", one_spring, {4, 0.5, 1e-4}));
  sets.back().invariants.push_back(one_spring_known());
  sets.push_back(hard("one_particle", "a single particle with a spring to itself",
                      [] { return elastic::random_graph(32, 1, 1); }));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Implicit step of a mass-spring system by Newton's method";
  t.paper_number = 4;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      lattice_set("public", SetKind::open, Size::paper, {96, 96, 96}, 16, public_field()),
      lattice_set("hidden", SetKind::hidden, Size::paper, {96, 96, 96}, 16, hidden_field()),
      lattice_set("public_smoke", SetKind::open, Size::smoke, {27, 23, 25}, 5, lengthened(public_field())),
      lattice_set("hidden_smoke", SetKind::hidden, Size::smoke, {22, 28, 24}, 6, lengthened(hidden_field())),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      newton::residual_check(springs(), 5e-5),
      newton::velocity_check(1e-5),
      newton::local_residual_check(
          springs(), 0.05, "the rms is at most a thousandth; a spring left out is of the size of one"),
      newton::velocity_units_check(),
      newton::free_particles_check("springs"),
      newton::energy_check(springs()),
  };
  t.knob = AccuracyKnob{"tol", {1e-1, 1e-2, 1e-3, 2e-4}};
  t.unordered = {{"n", {"springs"}}, {"m", {}}};
  t.target_floor_multiple = 230;
  return t;
}

}  // namespace gpuphys::mass_spring_newtonian_implicit
