// Input sets and checks of poisson_dirichlet (specification: cases/global_solve/poisson_dirichlet.md).
#include "cases/global_solve/poisson_dirichlet.hpp"

#include <fmt/format.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "cases/global_solve/poisson_inputs.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::poisson_dirichlet {
namespace {

using poisson::Boundary;
using poisson::Extents;

/// Height of the floor below cell column (i, j), in units of the box around its middle. It changes sign when
/// both indices are reflected, so exactly half of a grid with an even number of layers lies above it.
std::vector<double> floor_heights(const Extents& n) {
  std::vector<double> height(static_cast<std::size_t>(n[0] * n[1]));
  const double pi = std::numbers::pi;
  for (std::int64_t i = 0; i < n[0]; ++i) {
    for (std::int64_t j = 0; j < n[1]; ++j) {
      const double x = (static_cast<double>(i) + 0.5) / static_cast<double>(n[0]) - 0.5;
      const double y = (static_cast<double>(j) + 0.5) / static_cast<double>(n[1]) - 0.5;
      height[static_cast<std::size_t>(i * n[1] + j)] = 0.12 * std::sin(4 * pi * x) * std::cos(2 * pi * y) +
                                                       0.08 * std::sin(6 * pi * y) * std::cos(4 * pi * x);
    }
  }
  return height;
}

poisson::ActiveCell above_floor(const Extents& n, const std::vector<double>& height) {
  return [n, &height](std::int64_t i, std::int64_t j, std::int64_t k) {
    const double z = (static_cast<double>(k) + 0.5) / static_cast<double>(n[2]) - 0.5;
    return z > height[static_cast<std::size_t>(i * n[1] + j)];
  };
}

// Independent conductances in [low, high), one per face, the outside of the box included.
poisson::FaceConductance random_conductance(const Extents& n, std::uint64_t seed, double low, double high) {
  return [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    return low + (high - low) * poisson::face_uniform01(n, seed, axis, i, j, k);
  };
}

Problem wavy_half(const Extents& n, std::uint64_t seed, double low, double high, double scale = 1) {
  const std::vector<double> height = floor_heights(n);
  return poisson::system_with_rough_solution(n, Boundary::dirichlet, seed, above_floor(n, height),
                                             random_conductance(n, seed, low, high), scale);
}

InputSet paper_set(const std::string& name, SetKind kind, Size size, double low, double high,
                   std::uint64_t seed) {
  return poisson::paper_set(
      name, kind, size, seed,
      fmt::format("half a box above a wavy floor, conductances in [{:.2f}, {:.2f}]", low, high),
      [=](const Extents& n) { return wavy_half(n, seed, low, high); });
}

Problem with_rough_solution(const Extents& n, std::uint64_t seed, const poisson::ActiveCell& active,
                            const poisson::FaceConductance& conductance) {
  return poisson::system_with_rough_solution(n, Boundary::dirichlet, seed, active, conductance);
}

Problem contrast() {
  const Extents n{24, 20, 18};
  return with_rough_solution(n, 21, poisson::everywhere,
                             [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                               return std::pow(10.0, -6 * poisson::face_uniform01(n, 21, axis, i, j, k));
                             });
}

Problem weakly_held_layers() {
  const Extents n{20, 24, 18};
  return with_rough_solution(
      n, 22, poisson::everywhere, [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        return poisson::on_outside(n, axis, i, j, k) ? 0x1p-20 : poisson::layer_conductance(axis, i, j, k);
      });
}

// The sides insulate, only the two ends are held at zero.
Problem channel() {
  const Extents n{512, 4, 4};
  return with_rough_solution(n, 23, poisson::everywhere,
                             [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                               return axis == 0 || !poisson::on_outside(n, axis, i, j, k) ? 1.0 : 0.0;
                             });
}

Problem scattered_cells() {
  const Extents n{33, 17, 5};
  const std::vector<char> active = poisson::random_cells(n, 24, 0.5);
  return with_rough_solution(n, 24, poisson::cells_in(n, active), random_conductance(n, 24, 0.1, 1));
}

// The walls insulate: the tunnels are held at zero only where they meet the outside of the box.
Problem maze() {
  const std::vector<char> active = poisson::maze_cells({16, 16, 4}, 25);
  const Extents n{31, 31, 7};
  const poisson::ActiveCell tunnel = poisson::cells_in(n, active);
  return with_rough_solution(n, 25, tunnel, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    if (poisson::on_outside(n, axis, i, j, k)) return 1.0;
    return tunnel(i, j, k) && tunnel(i + (axis == 0), j + (axis == 1), k + (axis == 2)) ? 1.0 : 0.0;
  });
}

// One unknown, six faces of conductance 1/2 around it: x = 3/4.
Problem one_cell() {
  const Extents n{5, 4, 3};
  const std::uint64_t alone = poisson::flat(n, 2, 3, 1);
  Problem p = poisson::system_without_source(
      n, Boundary::dirichlet,
      [=](std::int64_t i, std::int64_t j, std::int64_t k) { return poisson::flat(n, i, j, k) == alone; },
      [](auto...) { return 0.5; });
  std::vector<double> x(60, 0.0);
  x[alone] = 0.75;
  poisson::set_right_hand_side(p, x);
  return p;
}

// One inner face in ten is closed, between active cells too.
Problem closed_faces() {
  const Extents n{13, 10, 17};
  return with_rough_solution(n, 61, poisson::everywhere,
                             [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                               const double u = poisson::face_uniform01(n, 61, axis, i, j, k);
                               return u < 0.1 ? 0.0 : u;
                             });
}

Problem with_tolerance(Problem p, double tol) {
  p.set_scalar("tol", tol);
  return p;
}

Problem no_active_cell() {
  return poisson::system_without_source(
      {6, 5, 7}, Boundary::dirichlet, [](auto...) { return false; }, poisson::unit_conductance);
}

// A solver that takes another tolerance than the problem's: tighter ones are held to, a looser one allows
// more.
std::vector<InputSet> other_tolerances() {
  std::vector<InputSet> sets;
  const Extents n{13, 17, 11};
  const auto system = [n] {
    return with_rough_solution(n, 62, poisson::everywhere,
                               [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                                 return 0.25 + 0.75 * poisson::face_uniform01(n, 62, axis, i, j, k);
                               });
  };
  for (const double tol : {5e-7, 3e-7}) {
    InputSet s = poisson::finite_hard_case(fmt::format("tol_{:.0e}", tol), fmt::format("tol = {}", tol),
                                           [=] { return with_tolerance(system(), tol); });
    s.invariants.push_back(poisson::residual_over_bound_check(
        "residual_tol", "tol", [tol](const Problem&) { return tol; },
        "storing x in float32 leaves 1.6e-7 of b: the tolerance is within reach"));
    sets.push_back(std::move(s));
  }
  InputSet s = poisson::finite_hard_case("tol_1e-04", "tol = 1e-4: a solver may stop early",
                                         [=] { return with_tolerance(system(), 1e-4); });
  s.use_task_checks = false;
  s.invariants.push_back(poisson::residual_over_bound_check(
      "residual_tol", "tol", [](const Problem&) { return 1e-4; }, "what the problem asks for"));
  s.invariants.push_back(poisson::zero_outside_check());
  sets.push_back(std::move(s));
  return sets;
}

std::vector<InputSet> hard_sets() {
  using poisson::finite_hard_case;
  const Extents zero{21, 19, 14}, scaled{22, 22, 20};
  std::vector<InputSet> sets{
      finite_hard_case("contrast_1e6", "every face has its own conductance between 1e-6 and 1 (log-uniform)",
                       contrast),
      finite_hard_case("weakly_held_layers",
                       "layers three cells thick of conductance 1 and 2^-20 (9.5e-7), held at zero through "
                       "faces of 2^-20 only",
                       weakly_held_layers),
      finite_hard_case("channel_512x4x4", "a long thin channel held at its ends: smallest eigenvalue 4e-5",
                       channel),
      finite_hard_case("odd_33x17x5",
                       "odd sizes, every other cell active at random: clusters of all sizes, single cells",
                       scattered_cells),
      finite_hard_case("maze", "a maze of one-cell-wide tunnels with insulating walls (a spanning tree)",
                       maze),
      poisson::zero_hard_case(
          "zero_rhs", "b = 0 above a wavy floor",
          [=] {
            const std::vector<double> height = floor_heights(zero);
            return poisson::system_without_source(zero, Boundary::dirichlet, above_floor(zero, height),
                                                  random_conductance(zero, 27, 0.1, 1));
          },
          "the system is definite: b = 0 has no solution but x = 0"),
      finite_hard_case("one_cell", "a single active cell: x = b / a_diag", one_cell),
      finite_hard_case("tiny_rhs", "b of size 1e-20: its squares are below the range of FP32",
                       [=] { return wavy_half(scaled, 28, 0.1, 1, 1e-20); }),
      finite_hard_case("huge_rhs", "b of size 1e20: its squares are above the range of FP32",
                       [=] { return wavy_half(scaled, 29, 0.1, 1, 1e20); }),
  };
  sets.push_back(poisson::finite_hard_case("closed_faces", "one inner face in ten is closed", closed_faces));
  sets.push_back(poisson::zero_hard_case("no_active_cell", "no cell is active: nothing to solve",
                                         no_active_cell, "inactive cells are 0"));
  for (const Extents n : {Extents{65537, 1, 2}, Extents{2, 65538, 1}, Extents{1, 2, 65539}}) {
    sets.push_back(finite_hard_case(
        fmt::format("long_{}x{}x{}", n[0], n[1], n[2]), "more cells along an axis than 16 bits count",
        [n] { return with_rough_solution(n, 67, poisson::everywhere, random_conductance(n, 67, 0.2, 1)); }));
  }
  for (InputSet& s : other_tolerances()) sets.push_back(std::move(s));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Poisson solve with homogeneous Dirichlet boundaries";
  t.paper_number = 1;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      paper_set("public", SetKind::open, Size::paper, 0.1, 1, 1),
      paper_set("hidden", SetKind::hidden, Size::paper, 0.12, 1.15, 2),
      paper_set("public_smoke", SetKind::open, Size::smoke, 0.1, 1, 1),
      paper_set("hidden_smoke", SetKind::hidden, Size::smoke, 0.12, 1.15, 2),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      poisson::paper_residual_check(),
      poisson::zero_outside_check(),
      poisson::single_equation_check(),
  };
  t.knob = poisson::tolerance_knob();
  t.target_floor_multiple = 25;
  return t;
}

}  // namespace gpuphys::poisson_dirichlet
