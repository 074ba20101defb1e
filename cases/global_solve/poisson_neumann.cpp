// Input sets and checks of poisson_neumann (specification: cases/global_solve/poisson_neumann.md).
#include "cases/global_solve/poisson_neumann.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "cases/global_solve/poisson_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/cut_cell_cylinder.hpp"

namespace gpuphys::poisson_neumann {
namespace {

using poisson::assemble;
using poisson::Boundary;
using poisson::Extents;
using poisson::kTolerance;
using poisson::make_system;

Problem cylinder_matrix(std::int64_t nx, std::int64_t ny, std::int64_t nz, double radius) {
  Problem p = make_system(nx, ny, nz, kTolerance);
  const CutCellCylinder c(nx, ny, nz, radius);
  // All planes k are alike: the fractions are computed once per column.
  std::vector<double> open_x(static_cast<std::size_t>(nx * ny)), open_y(open_x), open_z(open_x);
  std::vector<char> active(open_x.size());
  for (std::int64_t i = 0; i < nx; ++i) {
    for (std::int64_t j = 0; j < ny; ++j) {
      const std::size_t column = static_cast<std::size_t>(i * ny + j);
      active[column] = c.active(i, j);
      open_x[column] = c.face_x(i + 1, j);
      open_y[column] = c.face_y(i, j + 1);
      open_z[column] = c.area(i, j);
    }
  }
  const std::vector<double>* open[3] = {&open_x, &open_y, &open_z};
  assemble(
      p, Boundary::neumann,
      [&](std::int64_t i, std::int64_t j, std::int64_t) {
        return active[static_cast<std::size_t>(i * ny + j)] != 0;
      },
      [&](int axis, std::int64_t i, std::int64_t j, std::int64_t) {
        return (*open[axis])[static_cast<std::size_t>(i * ny + j)];
      });
  return p;
}

Problem cylinder(std::int64_t nx, std::int64_t ny, std::int64_t nz, double radius, std::uint64_t seed,
                 double scale = 1) {
  Problem p = cylinder_matrix(nx, ny, nz, radius);
  poisson::set_right_hand_side(p, poisson::rough_solution(p, seed), scale);
  return p;
}

// The paper's sets: radius as a fraction of the width in x.
InputSet paper_set(const std::string& name, SetKind kind, Size size, double fraction, std::uint64_t seed) {
  return poisson::paper_set(name, kind, size, seed,
                            fmt::format("cut-cell cylinder of radius {:.2f} of the width", fraction),
                            [=](const Extents& n) {
                              return cylinder(n[0], n[1], n[2], fraction * static_cast<double>(n[0]), seed);
                            });
}

Problem with_rough_solution(const Extents& n, std::uint64_t seed, const poisson::ActiveCell& active,
                            const poisson::FaceConductance& conductance) {
  return poisson::system_with_rough_solution(n, Boundary::neumann, seed, active, conductance);
}

Problem contrast() {
  const Extents n{24, 20, 18};
  return with_rough_solution(
      n, 11, poisson::everywhere, [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        return std::pow(10.0, -6 * poisson::inner_face_uniform01(n, 11, axis, i, j, k));
      });
}

Problem layers() {
  return with_rough_solution({20, 24, 18}, 12, poisson::everywhere, poisson::layer_conductance);
}

Problem slivers() {
  const Extents n{28, 28, 20};
  const CutCellCylinder c(n[0], n[1], n[2], 0.2 * 28);
  return with_rough_solution(
      n, 13, [&](std::int64_t i, std::int64_t j, std::int64_t) { return c.active(i, j); },
      [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        const auto sliver = [&](std::int64_t a, std::int64_t b, std::int64_t d) {
          return a < n[0] && b < n[1] && d < n[2] && poisson::cell_uniform01(n, 13, a, b, d) < 0.1;
        };
        const double open = axis == 0   ? c.face_x(i + 1, j)
                            : axis == 1 ? c.face_y(i, j + 1)
                                        : c.face_z(i, j, k + 1);
        const bool thin = sliver(i, j, k) || sliver(i + (axis == 0), j + (axis == 1), k + (axis == 2));
        return thin ? 1e-6 * open : open;
      });
}

constexpr Extents kChannel{512, 4, 4};

Problem channel() {
  return with_rough_solution(kChannel, 14, poisson::everywhere, poisson::unit_conductance);
}

// Unit flux through each of the 16 columns: the solution falls by 1 per cell, exactly representable.
std::vector<double> source_sink_solution() {
  std::vector<double> x;
  for (std::int64_t i = 0; i < kChannel[0]; ++i) {
    x.insert(x.end(), static_cast<std::size_t>(kChannel[1] * kChannel[2]),
             0.5 * static_cast<double>(kChannel[0] - 1) - static_cast<double>(i));
  }
  return x;
}

Problem channel_source_sink() {
  Problem p = make_system(kChannel[0], kChannel[1], kChannel[2], kTolerance);
  assemble(p, Boundary::neumann, poisson::everywhere, poisson::unit_conductance);
  poisson::set_right_hand_side(p, source_sink_solution());
  return p;
}

Problem one_cell() {
  Problem p = make_system(5, 4, 3, kTolerance);
  assemble(
      p, Boundary::neumann,
      [](std::int64_t i, std::int64_t j, std::int64_t k) { return i == 2 && j == 3 && k == 1; },
      poisson::unit_conductance);
  // A cell without neighbours has no couplings to sum up, but valid input has a positive diagonal.
  for (HostArray& a : p.inputs) {
    if (a.name() == "a_diag") a.as<float>()[poisson::flat({5, 4, 3}, 2, 3, 1)] = 1e-6f;
  }
  return p;
}

Problem two_cells() {
  Problem p = make_system(3, 9, 17, kTolerance);
  assemble(
      p, Boundary::neumann,
      [](std::int64_t i, std::int64_t j, std::int64_t k) { return i == 2 && j == 8 && (k == 7 || k == 8); },
      [](int, std::int64_t, std::int64_t, std::int64_t) { return 0.25; });
  std::vector<double> x(3 * 9 * 17, 0.0);
  x[poisson::flat({3, 9, 17}, 2, 8, 7)] = 0.5;
  x[poisson::flat({3, 9, 17}, 2, 8, 8)] = -0.5;
  poisson::set_right_hand_side(p, x);
  return p;
}

Problem odd_sizes() {
  const Extents n{33, 17, 5};
  const std::vector<char> active = poisson::largest_component(n, poisson::random_cells(n, 15, 0.65));
  return with_rough_solution(n, 15, poisson::cells_in(n, active),
                             [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                               return 0.1 + 0.9 * poisson::inner_face_uniform01(n, 15, axis, i, j, k);
                             });
}

Problem maze() {
  const std::vector<char> active = poisson::maze_cells({16, 16, 4}, 16);
  const Extents n{31, 31, 7};
  return with_rough_solution(n, 16, poisson::cells_in(n, active), poisson::unit_conductance);
}

// Relative size of the incompatible part of the right-hand side.
constexpr double kOffset = 1e-5;

Problem incompatible() {
  Problem p = cylinder(26, 26, 20, 0.2 * 26, 17);
  const Inputs in = bind_inputs<Inputs>(p);
  double square = 0, n = 0;
  for (std::int64_t c = 0; c < in.b.size(); ++c) {
    if (!in.is_dof.data[c]) continue;
    square += static_cast<double>(in.b.data[c]) * static_cast<double>(in.b.data[c]);
    ++n;
  }
  const double offset = kOffset * std::sqrt(square / n);
  for (HostArray& a : p.inputs) {
    if (a.name() != "b") continue;
    for (std::int64_t c = 0; c < in.b.size(); ++c) {
      if (in.is_dof.data[c]) a.as<float>()[static_cast<std::size_t>(c)] += static_cast<float>(offset);
    }
  }
  return p;
}

// Size of the part of b that no x can produce (the row sums of A are zero), over ||b||.
double incompatible_level(const Problem& p) {
  const Inputs in = bind_inputs<Inputs>(p);
  double sum = 0, square = 0, n = 0;
  for (std::int64_t c = 0; c < in.b.size(); ++c) {
    if (!in.is_dof.data[c]) continue;
    const double b = static_cast<double>(in.b.data[c]);
    sum += b;
    square += b * b;
    ++n;
  }
  return std::abs(sum) / std::sqrt(n * square);
}

// A hard case on which 1e-6 is not a fair demand: the residual is held against a bound evaluated from its
// data instead.
InputSet with_residual_bound(InputSet s, Check residual) {
  s.use_task_checks = false;
  s.invariants.push_back(std::move(residual));
  s.invariants.push_back(
      poisson::mean_check(1e-4, "the paper's tolerance: the shift to zero mean is not affected"));
  s.invariants.push_back(poisson::zero_outside_check());
  return s;
}

// One inner face in ten is closed, between active cells too.
Problem closed_faces() {
  const Extents n{13, 10, 17};
  return with_rough_solution(n, 51, poisson::everywhere,
                             [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                               const double u = poisson::inner_face_uniform01(n, 51, axis, i, j, k);
                               return u < 0.1 ? 0.0 : u;
                             });
}

Problem with_tolerance(Problem p, double tol) {
  p.set_scalar("tol", tol);
  return p;
}

Problem no_active_cell() {
  return poisson::system_without_source(
      {6, 5, 7}, Boundary::neumann, [](auto...) { return false; }, poisson::unit_conductance);
}

// A solver that takes another tolerance than the problem's: tighter ones are held to, a looser one allows
// more.
std::vector<InputSet> other_tolerances() {
  std::vector<InputSet> sets;
  const Extents n{13, 17, 11};
  const auto system = [n] {
    return with_rough_solution(n, 52, poisson::everywhere,
                               [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                                 return 0.25 + 0.75 * poisson::inner_face_uniform01(n, 52, axis, i, j, k);
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
  using poisson::finite_hard_case, poisson::zero_hard_case;
  std::vector<InputSet> sets;
  sets.push_back(finite_hard_case(
      "contrast_1e6", "every face has its own conductance between 1e-6 and 1 (log-uniform)", contrast));
  sets.push_back(
      finite_hard_case("layers_1e6", "layers three cells thick of conductance 1 and 2^-20 (9.5e-7)", layers));
  sets.push_back(finite_hard_case(
      "slivers_1e6", "one cell in ten of a cut-cell cylinder is open by a further factor of 1e-6 only",
      slivers));
  sets.push_back(
      finite_hard_case("channel_512x4x4", "a long thin channel: the smallest eigenvalue is 4e-5", channel));
  sets.push_back(with_residual_bound(
      finite_hard_case(
          "channel_source_sink",
          "flux through a 512 x 4 x 4 channel from end to end: a smooth solution far larger than b",
          channel_source_sink),
      poisson::residual_over_bound_check(
          "residual_attainable", "4 eps || |A| |x*| || / ||b||",
          [](const Problem& p) {
            constexpr double eps = 0x1p-24;
            return std::max(kTolerance, 4 * eps * poisson::rounding_amplification(p, source_sink_solution()));
          },
          "FP32 cannot resolve A x below the rounding of its terms: storing x costs eps |A||x|, evaluating "
          "the "
          "seven-term row up to 7 eps |A||x|; half of that worst case must be enough")));
  sets.push_back(zero_hard_case(
      "zero_rhs", "b = 0 on a cut-cell cylinder", [] { return cylinder_matrix(21, 19, 14, 4); },
      "the task defines the solution for b = 0 as x = 0"));
  sets.push_back(zero_hard_case("one_cell",
                                "a single active cell: the matrix is 1 x 1 and the null space is everything",
                                one_cell, "the only zero-mean field on one cell is 0"));
  sets.push_back(finite_hard_case(
      "two_cells", "two active cells on either side of a block boundary (k = 7 and 8)", two_cells));
  sets.push_back(finite_hard_case(
      "odd_33x17x5", "odd sizes, random active cells (the largest component), random conductances",
      odd_sizes));
  sets.push_back(
      finite_hard_case("maze", "a maze of one-cell-wide tunnels without loops (a spanning tree)", maze));
  sets.push_back(with_residual_bound(
      finite_hard_case("incompatible_rhs",
                       "b carries a constant offset of 1e-5 of its rms that no x can produce", incompatible),
      poisson::residual_over_bound_check(
          "residual_incompatible", "twice the incompatible part of b",
          [](const Problem& p) { return 2 * incompatible_level(p); },
          "the incompatible part |sum b| / (sqrt(n) ||b||) stays in the residual whatever x is; the factor 2 "
          "lets a "
          "solver stop when its own part is as large")));
  sets.push_back(finite_hard_case("tiny_rhs", "b of size 1e-20: its squares are below the range of FP32",
                                  [] { return cylinder(22, 22, 20, 0.18 * 22, 18, 1e-20); }));
  sets.push_back(finite_hard_case("huge_rhs", "b of size 1e20: its squares are above the range of FP32",
                                  [] { return cylinder(22, 22, 20, 0.18 * 22, 19, 1e20); }));
  sets.push_back(poisson::finite_hard_case("closed_faces", "one inner face in ten is closed", closed_faces));
  sets.push_back(poisson::zero_hard_case("no_active_cell", "no cell is active: nothing to solve",
                                         no_active_cell, "inactive cells are 0"));
  for (InputSet& s : other_tolerances()) sets.push_back(std::move(s));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Poisson solve with Neumann boundaries on cut cells";
  t.paper_number = 2;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      paper_set("public", SetKind::open, Size::paper, 0.18, 1),
      paper_set("hidden", SetKind::hidden, Size::paper, 0.21, 2),
      paper_set("public_smoke", SetKind::open, Size::smoke, 0.18, 1),
      paper_set("hidden_smoke", SetKind::hidden, Size::smoke, 0.21, 2),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      poisson::paper_residual_check(),
      poisson::mean_check(1e-4, "the paper's tolerance"),
      poisson::zero_outside_check(),
      poisson::single_equation_check(),
  };
  t.knob = poisson::tolerance_knob();
  t.target_floor_multiple = 51;
  return t;
}

}  // namespace gpuphys::poisson_neumann
