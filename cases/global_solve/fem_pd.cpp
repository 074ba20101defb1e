// Input sets and checks of fem_pd (specification: cases/global_solve/fem_pd.md).
#include "cases/global_solve/fem_pd.hpp"

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

namespace gpuphys::fem_pd {
namespace {

using elastic::Deformation;
using elastic::Mat3;
using elastic::TetBody;
using elastic::Vec3;
using elastic::operator*;

struct Scalars {
  double mu = 1e4 / 2.6, dt = 0.05;  // Young's modulus 1e4 Pa, Poisson's ratio 0.3
  int iters = 8;
};

Problem problem_of(const TetBody& body, Scalars s = {}) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(body.x.size())}, {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", s.mu);
  p.set_scalar("dt", s.dt);
  p.set_scalar("iters", s.iters);
  return p;
}

Deformation public_field() {
  return {.periods = 2, .strain = 0.08, .jitter = 0.05, .speed = 5, .noise = 0.10, .seed = 1};
}
Deformation hidden_field() {
  return {.periods = 3, .strain = 0.07, .jitter = 0.04, .speed = 5, .noise = 0.12, .seed = 2};
}

// A bound that small sets keep: what FP32 solves show, with some room.
Check tight_change() {
  return relative_l2_of_change("v_new", "v", 3e-5,
                               "a tenth of the paper's tolerance for v: global steps solved to 1e-5 and FP32 "
                               "rounding leave some 1e-5");
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
  if (size == Size::smoke) s.invariants = {tight_change()};
  return s;
}

// ---- hard cases ----

TetBody small_block(std::uint64_t seed, double jitter = 0.05) {
  Deformation f = public_field();
  f.seed = seed;
  f.periods = 1;
  f.jitter = jitter;
  return elastic::tet_block({6, 8, 7}, f);
}

InputSet hard(const std::string& stress, const std::string& about, std::function<TetBody()> make,
              Scalars s = {}, bool tight = true) {
  std::vector<Check> invariants{
      elastic::momentum_check(1e-5, "every global step keeps it; what is left of a solve may not")};
  if (tight) invariants.push_back(tight_change());
  return hard_case(
      stress, about, [=] { return problem_of(make(), s); }, std::move(invariants));
}

// A block at rest, turned, then moving as a whole.
TetBody turned(std::uint64_t seed, const Mat3& rotation, double jitter) {
  TetBody b = small_block(seed, 0);
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    b.x[i] = rotation * b.rest[i];
    for (std::size_t d = 0; d < 3; ++d) b.x[i][d] += jitter * uniform11(seed, 50, 3 * i + d);
    if (jitter == 0) b.v[i] = {0, 0, 0};
  }
  return b;
}

// By 179 degrees about a random axis: half a turn about e is 2 e e^T - I, a degree about e by Rodrigues'
// formula.
Mat3 nearly_half_turn(std::uint64_t seed) {
  const Mat3 frame = elastic::random_rotation(seed, 60, 0);
  const double angle = std::numbers::pi * 179 / 180, c = std::cos(angle), s = std::sin(angle);
  return frame * Mat3{{{c, -s, 0}, {s, c, 0}, {0, 0, 1}}} * elastic::transposed(frame);
}

// Tetrahedra turned inside out, singular values (1.3, 1, 0.5): R is a rotation all the same.
TetBody inverted() {
  TetBody b;
  for (std::uint64_t i = 0; i < 255; ++i) {
    const Mat3 f = elastic::random_rotation(41, 63, i) * elastic::diagonal(1.3, 1, -0.5) *
                   elastic::random_rotation(41, 64, i);
    elastic::add_tet(b, {}, 1, elastic::kIdentity, f, 100, 41, i);
  }
  return b;
}

TetBody hub() {
  TetBody b = elastic::separate_tets(44, 1000, -0.1, 0.1);
  for (auto& tet : b.tets) tet[0] = 0;
  b.mass[0] = 100;
  return b;
}

TetBody flat() {
  TetBody b = elastic::separate_tets(45, 97, -0.1, 0.1);
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    b.x[i] = {0, 0, 0};  // F = 0
    b.v[i] = {0, 0, 0};
  }
  return b;
}

// From 1/8 to 2 m, cube by cube, so that volumes differ by a factor of 4096.
TetBody graded() {
  TetBody b = small_block(46);
  const auto map = [](double c) { return c * (0.25 + 0.05 * c * c); };
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      const double strain = b.x[i][d] - b.rest[i][d];
      b.rest[i][d] = map(b.rest[i][d]);
      b.x[i][d] = b.rest[i][d] + 0.1 * strain;
      b.v[i][d] *= 0.1;
    }
  }
  return b;
}

TetBody masses_over_three_decades() {
  TetBody b = small_block(47);
  for (std::size_t i = 0; i < b.mass.size(); ++i) b.mass[i] *= std::pow(10.0, 1.5 * uniform11(47, 70, i));
  return b;
}

TetBody offset() {
  TetBody b = small_block(48);
  for (Vec3& x : b.x) x = {x[0] + 1e3, x[1] - 1e3, x[2] + 1e3};
  return b;
}

TetBody loose_vertices() {
  TetBody b = small_block(49);
  for (std::uint64_t i = 0; i < 100; ++i) {
    b.rest.push_back({0, 0, static_cast<double>(i)});
    b.x.push_back({static_cast<double>(i), -0.0, 0});
    b.v.push_back({uniform11(49, 70, i), -0.0, 0});
    b.mass.push_back(1);
  }
  return b;
}

// The unit corner, stretched to 1 + s along x; vertex 0 and those of y and z weigh next to infinitely much. R
// = I, so the vertex along x sees P_xx = 2 mu (F_xx - 1) and comes to 1 + s / (1 + dt^2 2 mu V / mass) in one
// iteration: with mu = 12, V = 1/6, dt = 1/2, mass 1: half of s.
TetBody unit_corner() {
  TetBody b;
  b.rest = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  b.x = {{0, 0, 0}, {1.5, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  b.v.assign(4, {0, 0, 0});
  b.mass = {0x1p40, 1, 0x1p40, 0x1p40};
  b.tets = {{0, 1, 2, 3}};
  return b;
}
Check unit_corner_known() {
  return equals_known(
      {.name = "x_new_known",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "error over the largest value",
       .tolerance = 1e-4,
       .why = "a global step may leave a ten-thousandth of its change",
       .needs_truth = false},
      [](const Judged&) { return std::vector<double>{0, 0, 0, 1.25, 0, 0, 0, 1, 0, 0, 0, 1}; });
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto block = [](std::uint64_t seed) { return [seed] { return small_block(seed); }; };
  sets.push_back(hard("soft", "mu = 10 Pa, dt = 0.1 s, 9 iterations", block(31), {10, 0.1, 9}));
  sets.push_back(hard("stiff", "mu = 1e6 Pa, dt = 0.01 s: 5 times as stiff", block(32), {1e6, 0.01, 5}));
  sets.push_back(hard("one_iteration", "iters = 1", block(33), {1e4 / 2.6, 0.05, 1}));
  sets.push_back(
      hard_case("zero_iterations", "iters = 0: x + dt v",
                [] {
                  return problem_of(small_block(34), {1e4 / 2.6, 0.05, 0});
                },
                {elastic::velocity_kept_check(1e-6, "dt v / dt, rounded twice, of up to 5.5 m/s")}));
  sets.push_back(
      hard("inverted", "separate tetrahedra turned inside out, one iteration", inverted, {100, 0.5, 1}));
  sets.push_back(hard("crushed", "separate tetrahedra, stretches from 0.02 to 2, one iteration",
                      [] { return elastic::separate_tets(42, 301, -1.6, 0.3); }, {100, 0.5, 1}));
  sets.push_back(hard(
      "slivers", "dihedral angles of one degree", [] { return elastic::slivers(43, 257); }, {100, 0.2, 2},
      false));
  sets.push_back(hard("turned_179", "a block turned by 179 degrees, with jitter",
                      [] { return turned(35, nearly_half_turn(35), 0.05); }));
  sets.push_back(hard(
      "turned_90", "a block at rest, turned by 90 degrees",
      [] {
        return turned(36, {{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}}, 0);
      },
      {}, false));
  sets.back().invariants.push_back(
      elastic::velocity_kept_check(1e-5, "F = R up to the rounding of R, 1e-7 of 0.05 m per 0.05 s"));
  sets.push_back(hard("graded", "volumes that differ by a factor of a thousand", graded, {100, 0.02, 8}));
  sets.push_back(hard("masses", "masses over three decades", masses_over_three_decades));
  sets.push_back(hard("hub_1000", "1000 tetrahedra have one vertex in common", hub, {1000, 0.1, 3}));
  sets.push_back(hard("offset_1e3", "a block 1 km off its place at rest", offset));
  sets.push_back(hard("loose_vertices", "100 vertices that belong to no tetrahedron", loose_vertices));
  sets.push_back(hard("one_tet", "the unit corner, one iteration by hand", unit_corner, {12, 0.5, 1}, false));
  sets.back().invariants.push_back(unit_corner_known());
  sets.push_back(
      hard("collapsed", "every tetrahedron in one point: F = 0, any R", flat, {100, 0.1, 3}, false));
  sets.back().use_task_checks = false;
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Step of corotated tetrahedra by projective dynamics";
  t.paper_number = 7;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      block_set("public", SetKind::open, Size::paper, {64, 64, 64}, public_field()),
      block_set("hidden", SetKind::hidden, Size::paper, {64, 64, 64}, hidden_field()),
      block_set("public_smoke", SetKind::open, Size::smoke, {12, 9, 14}, public_field()),
      block_set("hidden_smoke", SetKind::hidden, Size::smoke, {10, 13, 11}, hidden_field()),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  constexpr double v_local = 3e-4;
  t.checks = {
      relative_l2_check("x_new", 6e-6, "the paper's table of inputs and checks"),
      relative_l2_check("v_new", 3e-4, "the paper's table of inputs and checks"),
      local_error_check(
          "v_new", v_local,
          "ten times what an error of 3e-5, a tenth of the paper's tolerance, amounts to in the worst "
          "component"),
      elastic::position_units_check(v_local),
      elastic::positions_follow_check(),
  };
  t.knob = AccuracyKnob{"iters", {1, 2, 4, 8, 16}};
  t.unordered = {{"n", {"tets"}}, {"m", {}}};
  t.target_floor_multiple = 100;
  return t;
}

}  // namespace gpuphys::fem_pd
