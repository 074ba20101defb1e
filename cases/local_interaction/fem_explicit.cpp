// Input sets and checks of fem_explicit (specification: cases/local_interaction/fem_explicit.md).
#include "cases/local_interaction/fem_explicit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::fem_explicit {
namespace {

using elastic::add_tet;
using elastic::Deformation;
using elastic::diagonal;
using elastic::kIdentity;
using elastic::Mat3;
using elastic::random_stretch;
using elastic::separate_tets;
using elastic::TetBody;
using elastic::Vec3;
using elastic::operator*;

// Young's modulus 1e4 Pa and Poisson's ratio 0.3 by default.
struct Scalars {
  double young = 1e4, poisson = 0.3, dt = 1e-3;
  double mu() const { return young / (2 * (1 + poisson)); }
  double lambda() const { return young * poisson / ((1 + poisson) * (1 - 2 * poisson)); }
};

Problem problem_of(const TetBody& body, Scalars s = {}) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(body.x.size())}, {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", s.mu());
  p.set_scalar("lambda", s.lambda());
  p.set_scalar("dt", s.dt);
  return p;
}

Deformation public_field() {
  return {.periods = 2, .strain = 0.08, .jitter = 0.05, .speed = 5, .noise = 0.10, .seed = 1};
}
Deformation hidden_field() {
  return {.periods = 3, .strain = 0.07, .jitter = 0.04, .speed = 5, .noise = 0.12, .seed = 2};
}

// Bounds that small sets keep: what the FP32 baselines show, with some room.
constexpr double kChange = 1e-5, kChangeLocal = 1e-4;

Check tight_change(double tolerance = kChange) {
  return relative_l2_of_change(
      "v_new", "v", tolerance,
      "F is known to some 2e-7, and a strain of 0.1 is made of it; v_new is rounded to 2^-24 "
      "of v, of which the change is some tenths");
}
Check tight_local() {
  return local_error_of_change("v_new", "v", kChangeLocal,
                               "ten times the relative L2 error: the largest of some thousand errors");
}

InputSet block_set(std::string name, SetKind kind, Size size, std::array<std::int64_t, 3> cells,
                   const Deformation& f) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about =
      fmt::format("{}x{}x{} cubes of six tetrahedra, {} periods, strain {}, jitter {}, noise {}, seed {}",
                  cells[0], cells[1], cells[2], f.periods, f.strain, f.jitter, f.noise, f.seed);
  s.make = [=] { return problem_of(elastic::tet_block(cells, f)); };
  if (size == Size::smoke) s.invariants = {tight_change(), tight_local()};
  return s;
}

// ---- hard cases ----

TetBody small_block(std::uint64_t seed, double jitter = 0.05) {
  Deformation f = public_field();
  f.seed = seed;
  f.periods = 1;
  f.jitter = jitter;
  return elastic::tet_block({7, 9, 8}, f);
}

InputSet hard(const std::string& stress, const std::string& about, std::function<TetBody()> make,
              Scalars s = {}, std::vector<Check> invariants = {}) {
  invariants.push_back(elastic::momentum_check(
      0x1p-20,
      "the forces of a tetrahedron add up to zero; what remains is the rounding of sums, a few 2^-24 each"));
  return hard_case(
      stress, about, [=] { return problem_of(make(), s); }, std::move(invariants));
}

InputSet hard_tight(const std::string& stress, const std::string& about, std::function<TetBody()> make,
                    Scalars s = {}) {
  return hard(stress, about, std::move(make), s, {tight_change(), tight_local()});
}

// Squeezed to a fiftieth along one direction, and stretched fifty times.
TetBody crushed_and_stretched() {
  TetBody b;
  for (std::uint64_t i = 0; i < 511; ++i) {
    const double s = i % 2 ? 50.0 : 0.02;
    const Mat3 f =
        elastic::random_rotation(41, 63, i) * diagonal(1, s, 1) * elastic::random_rotation(41, 64, i);
    add_tet(b, {}, 1, kIdentity, f, 2000, 41, i);
  }
  return b;
}

// A micrometre beside a metre and a kilometre.
TetBody three_sizes() {
  TetBody b;
  for (std::uint64_t i = 0; i < 300; ++i) {
    const double size = i % 3 == 0 ? 0x1p-20 : i % 3 == 1 ? 1 : 0x1p10;
    add_tet(b, {}, size, kIdentity, random_stretch(43, i, -0.1, 0.1), 10, 43, i);
  }
  return b;
}

// Tetrahedra that have one vertex in common, and nothing else.
TetBody hub() {
  TetBody b = separate_tets(44, 1000, -0.1, 0.1);
  for (auto& tet : b.tets) tet[0] = 0;
  b.mass[0] = 1000;
  return b;
}

TetBody offset() {
  TetBody b = small_block(45);
  for (Vec3& x : b.x) x = {x[0] + 1e3, x[1] - 1e3, x[2] + 1e3};
  return b;
}

// A block at rest, turned.
TetBody turned(std::uint64_t seed, const Mat3& rotation) {
  TetBody b = small_block(seed, 0);
  for (std::size_t i = 0; i < b.x.size(); ++i) b.x[i] = rotation * b.rest[i];
  return b;
}

TetBody loose_vertices() {
  TetBody b = small_block(46);
  for (std::uint64_t i = 0; i < 100; ++i) {
    b.rest.push_back({0, 0, static_cast<double>(i)});
    b.x.push_back({static_cast<double>(i), -0.0, 0});
    b.v.push_back({uniform11(46, 70, i), -0.0, 0});
    b.mass.push_back(1);
  }
  return b;
}

// The unit corner stretched twofold along x, mu = 6, lambda = 12, dt = 1/8, masses 1. V = 1/6, P = diag(2 -
// 1/2, 0, 0) mu + lambda ln 2 diag(1/2, 1, 1); the force on the vertex along axis a is -V P e_a.
TetBody unit_corner() {
  TetBody b;
  b.rest = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  b.x = {{0, 0, 0}, {2, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  b.v.assign(4, {0, 0, 0});
  b.mass.assign(4, 1);
  b.tets = {{0, 1, 2, 3}};
  return b;
}
Check unit_corner_known() {
  constexpr double ln2 = std::numbers::ln2;
  return equals_known({.name = "v_new_known",
                       .kind = CheckKind::invariant,
                       .array = "v_new",
                       .quantity = "error over the largest value",
                       .tolerance = 5e-7,
                       .why = "a handful of roundings",
                       .needs_truth = false},
                      [](const Judged&) {
                        const double x = (9 + 6 * ln2) / 48, y = 12 * ln2 / 48;  // dt V P_xx and dt V P_yy
                        return std::vector<double>{x, y, y, -x, 0, 0, 0, -y, 0, 0, 0, -y};
                      });
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  sets.push_back(hard_tight("soft_nu_0", "Young's modulus 1 Pa, Poisson's ratio 0, dt = 0.1 s",
                            [] { return small_block(31); }, {1, 0, 0.1}));
  sets.push_back(hard_tight("nu_0.49", "Young's modulus 1e6 Pa, Poisson's ratio 0.49",
                            [] { return small_block(32); }, {1e6, 0.49, 1e-4}));
  sets.push_back(hard("crushed_and_stretched", "separate tetrahedra, a fiftieth and fifty times as high",
                      crushed_and_stretched, {1e4, 0.3, 1e-2}, {tight_change(), tight_local()}));
  sets.push_back(hard("large_strains", "separate tetrahedra, stretches from 0.1 to 10 along three directions",
                      [] { return separate_tets(47, 1001, -1, 1); }, {1e4, 0.4, 1e-2},
                      {tight_change(), tight_local()}));
  sets.push_back(hard("slivers", "dihedral angles of one degree", [] { return elastic::slivers(42, 257); },
                      {1e4, 0.3, 1e-2}));
  sets.push_back(hard("three_sizes", "tetrahedra of 1 um, 1 m and 1 km", three_sizes, {1e4, 0.3, 1e-2},
                      {tight_change(), tight_local()}));
  sets.push_back(hard("hub_1000", "1000 tetrahedra have one vertex in common", hub, {1e4, 0.3, 1e-2},
                      {tight_change(), tight_local()}));
  sets.push_back(hard_tight("offset_1e3", "a block 1 km off its place at rest", offset));
  sets.push_back(
      hard("turned_90", "a block at rest, turned by 90 degrees",
           [] {
             return turned(48, {{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}});
           },
           {}, {elastic::velocity_kept_check(0, "every F is exactly a rotation: F - F^-T = 0, ln J = 0")}));
  sets.push_back(
      hard("turned", "a block at rest, turned at random",
           [] { return turned(49, elastic::random_rotation(49, 63, 0)); }, {},
           {elastic::velocity_kept_check(
               2.5e-4,
               "F is off by some 1e-7, from the rounding of positions: E = 1e4 Pa makes 1e-3 N m^-2 of it, "
               "or 2e-3 N at a vertex of 24 faces that do not add up, times dt / mass, 1e-3 s over 0.03 kg "
               "at a corner, with few faces, and 1 kg inside")}));
  sets.push_back(hard_tight("loose_vertices", "100 vertices that belong to no tetrahedron", loose_vertices));
  sets.push_back(hard("one_tet", "the unit corner stretched twofold: forces by hand", unit_corner, {},
                      {unit_corner_known()}));
  sets.back().make = [] {
    Problem p = problem_of(unit_corner());
    p.set_scalar("mu", 6);
    p.set_scalar("lambda", 12);
    p.set_scalar("dt", 0.125);
    return p;
  };
  sets.push_back(
      hard("odd_31", "31 separate tetrahedra", [] { return separate_tets(50, 31, -0.2, 0.2); }, {1, 0.2, 1}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Explicit step of Neo-Hookean tetrahedra (symplectic Euler)";
  t.paper_number = 46;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      block_set("public", SetKind::open, Size::paper, {96, 96, 96}, public_field()),
      block_set("hidden", SetKind::hidden, Size::paper, {96, 96, 96}, hidden_field()),
      block_set("public_smoke", SetKind::open, Size::smoke, {27, 23, 31}, public_field()),
      block_set("hidden_smoke", SetKind::hidden, Size::smoke, {22, 31, 26}, hidden_field()),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  constexpr double v_local = 3e-5;
  t.checks = {
      relative_l2_check("x_new", 1e-5, "the paper's table of inputs and checks"),
      relative_l2_check("v_new", 1e-4, "the paper's table of inputs and checks"),
      local_error_check(
          "v_new", v_local,
          "the stress is known to 4e-7 of mu; E = 1e4 Pa changes velocities by 1 m/s, of which this is "
          "1e-6, and the rms is 2.6 m/s"),
      elastic::position_units_check(v_local),
      elastic::free_particles_check("tets"),
  };
  t.unordered = {{"n", {"tets"}}, {"m", {}}};
  t.target_floor_multiple = 4.5;
  return t;
}

}  // namespace gpuphys::fem_explicit
