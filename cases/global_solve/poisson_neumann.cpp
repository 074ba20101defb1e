// Input sets and checks of poisson_neumann (specification: cases/global_solve/poisson_neumann.md).
#include "cases/global_solve/poisson_neumann.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <vector>

#include "cases/global_solve/poisson_system.hpp"
#include "core/generators/cut_cell_cylinder.hpp"
#include "core/random.hpp"
#include "core/task.hpp"

namespace gpuphys::poisson_neumann {
namespace {

using poisson::assemble;
using poisson::Boundary;
using poisson::make_system;

constexpr double kTolerance = 1e-6;
constexpr double kLocalTolerance = 1e-4;

// Random streams: 0 is the noise of the manufactured solution.
constexpr std::uint64_t kFaceStream = 1;  // 1, 2, 3 for faces normal to x, y, z
constexpr std::uint64_t kCellStream = 4;

std::uint64_t flat(const std::array<std::int64_t, 3>& n, std::int64_t i, std::int64_t j, std::int64_t k) {
  return static_cast<std::uint64_t>((i * n[1] + j) * n[2] + k);
}

/// Where x* = ramp + 0.5 U. The noise share keeps || |A| |x*| || / ||b|| near 3, so that FP32 can reach 1e-6.
std::vector<double> manufactured(const Problem& p, std::uint64_t seed) {
  return poisson::ramp_and_noise(p, seed, 1, 0.5);
}

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
  poisson::set_right_hand_side(p, manufactured(p, seed), scale);
  return p;
}

// The paper's sets: radius as a fraction of the width in x.
InputSet paper_set(const std::string& name, SetKind kind, Size size, double fraction, std::uint64_t seed) {
  // The smoke grid leaves partial blocks of 8 on every axis and a cell count that is no multiple of 32.
  const std::array<std::int64_t, 3> n = size == Size::paper ? std::array<std::int64_t, 3>{256, 256, 256}
                                                            : std::array<std::int64_t, 3>{36, 36, 33};
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("cut-cell cylinder of radius {:.2f} of the width in {} x {} x {} cells, seed {}",
                        fraction, n[0], n[1], n[2], seed);
  s.make = [=] { return cylinder(n[0], n[1], n[2], fraction * static_cast<double>(n[0]), seed); };
  if (size == Size::paper) {
    s.known_solution = [=](const Problem& p) {
      return poisson::as_solution(describe<Inputs, Outputs<float>>(), p, manufactured(p, seed));
    };
    s.truth_source = "manufactured solution";
  }
  return s;
}

// Random conductances for hard cases, one per face, in the order of the cell on the face's low side.
double face_uniform01(const std::array<std::int64_t, 3>& n, std::uint64_t seed, int axis, std::int64_t i,
                      std::int64_t j, std::int64_t k) {
  return uniform01(seed, kFaceStream + static_cast<std::uint64_t>(axis), flat(n, i, j, k));
}

bool everywhere(std::int64_t, std::int64_t, std::int64_t) {
  return true;
}

Problem box_with_rough_solution(const std::array<std::int64_t, 3>& n, std::uint64_t seed,
                                const poisson::ActiveCell& active,
                                const poisson::FaceConductance& conductance) {
  Problem p = make_system(n[0], n[1], n[2], kTolerance);
  assemble(p, Boundary::neumann, active, conductance);
  poisson::set_right_hand_side(p, manufactured(p, seed));
  return p;
}

Problem contrast() {
  const std::array<std::int64_t, 3> n{24, 20, 18};
  return box_with_rough_solution(n, 11, everywhere,
                                 [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
                                   return std::pow(10.0, -6 * face_uniform01(n, 11, axis, i, j, k));
                                 });
}

// Powers of two make every diagonal exact in float32. With 1e-6 its rounding would rival the weak couplings,
// and the matrix would no longer be that of the layers.
Problem layers() {
  const std::array<std::int64_t, 3> n{20, 24, 18};
  return box_with_rough_solution(n, 12, everywhere, [](int axis, std::int64_t, std::int64_t j, std::int64_t) {
    const auto strong = [](std::int64_t layer) { return (layer / 3) % 2 == 0; };
    return strong(j) && (axis != 1 || strong(j + 1)) ? 1.0 : 0x1p-20;
  });
}

Problem slivers() {
  const std::array<std::int64_t, 3> n{28, 28, 20};
  const CutCellCylinder c(n[0], n[1], n[2], 0.2 * 28);
  return box_with_rough_solution(
      n, 13, [&](std::int64_t i, std::int64_t j, std::int64_t) { return c.active(i, j); },
      [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        const auto sliver = [&](std::int64_t a, std::int64_t b, std::int64_t d) {
          return a < n[0] && b < n[1] && d < n[2] && uniform01(13, kCellStream, flat(n, a, b, d)) < 0.1;
        };
        const double open = axis == 0   ? c.face_x(i + 1, j)
                            : axis == 1 ? c.face_y(i, j + 1)
                                        : c.face_z(i, j, k + 1);
        const bool thin = sliver(i, j, k) || sliver(i + (axis == 0), j + (axis == 1), k + (axis == 2));
        return thin ? 1e-6 * open : open;
      });
}

constexpr std::array<std::int64_t, 3> kChannel{512, 4, 4};

double unit_conductance(int, std::int64_t, std::int64_t, std::int64_t) {
  return 1;
}

Problem channel() {
  return box_with_rough_solution(kChannel, 14, everywhere, unit_conductance);
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
  assemble(p, Boundary::neumann, everywhere, unit_conductance);
  poisson::set_right_hand_side(p, source_sink_solution());
  return p;
}

Problem one_cell() {
  Problem p = make_system(5, 4, 3, kTolerance);
  assemble(
      p, Boundary::neumann,
      [](std::int64_t i, std::int64_t j, std::int64_t k) { return i == 2 && j == 3 && k == 1; },
      unit_conductance);
  // A cell without neighbours has no couplings to sum up, but valid input has a positive diagonal.
  for (HostArray& a : p.inputs) {
    if (a.name() == "a_diag") a.as<float>()[flat({5, 4, 3}, 2, 3, 1)] = 1e-6f;
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
  x[flat({3, 9, 17}, 2, 8, 7)] = 0.5;
  x[flat({3, 9, 17}, 2, 8, 8)] = -0.5;
  poisson::set_right_hand_side(p, x);
  return p;
}

// The cells of the largest face-connected component of `active` (first found wins a tie).
std::vector<char> largest_component(const std::array<std::int64_t, 3>& n, const std::vector<char>& active) {
  std::vector<int> label(active.size(), -1);
  std::vector<std::size_t> size;
  for (std::size_t seed = 0; seed < active.size(); ++seed) {
    if (!active[seed] || label[seed] >= 0) continue;
    const int mine = static_cast<int>(size.size());
    std::vector<std::size_t> stack{seed};
    label[seed] = mine;
    size.push_back(0);
    while (!stack.empty()) {
      const std::int64_t c = static_cast<std::int64_t>(stack.back());
      stack.pop_back();
      ++size.back();
      const std::int64_t at[3] = {c / (n[1] * n[2]), c / n[2] % n[1], c % n[2]};
      const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
      for (int d = 0; d < 3; ++d) {
        for (const std::int64_t side : {-1, 1}) {
          if (at[d] + side < 0 || at[d] + side >= n[static_cast<std::size_t>(d)]) continue;
          const std::size_t other = static_cast<std::size_t>(c + side * step[d]);
          if (!active[other] || label[other] >= 0) continue;
          label[other] = mine;
          stack.push_back(other);
        }
      }
    }
  }
  const int largest = static_cast<int>(std::max_element(size.begin(), size.end()) - size.begin());
  std::vector<char> kept(active.size());
  for (std::size_t c = 0; c < kept.size(); ++c) kept[c] = label[c] == largest;
  return kept;
}

Problem odd_sizes() {
  const std::array<std::int64_t, 3> n{33, 17, 5};
  std::vector<char> active(33 * 17 * 5);
  for (std::size_t c = 0; c < active.size(); ++c) active[c] = uniform01(15, kCellStream, c) < 0.65;
  active = largest_component(n, active);
  return box_with_rough_solution(
      n, 15,
      [&](std::int64_t i, std::int64_t j, std::int64_t k) {
        return active[static_cast<std::size_t>(flat(n, i, j, k))] != 0;
      },
      [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        return 0.1 + 0.9 * face_uniform01(n, 15, axis, i, j, k);
      });
}

// A random spanning tree of a coarse lattice, carved one cell wide: rooms at even indices, passages between
// them.
Problem maze() {
  const std::array<std::int64_t, 3> n{31, 31, 7}, rooms{16, 16, 4};
  struct Passage {
    std::uint64_t order;
    std::uint64_t from, to;  // rooms
    std::uint64_t cell;
  };
  std::vector<Passage> passages;
  std::vector<char> active(static_cast<std::size_t>(n[0] * n[1] * n[2]), 0);
  for (std::int64_t i = 0; i < rooms[0]; ++i) {
    for (std::int64_t j = 0; j < rooms[1]; ++j) {
      for (std::int64_t k = 0; k < rooms[2]; ++k) {
        active[flat(n, 2 * i, 2 * j, 2 * k)] = 1;
        for (int d = 0; d < 3; ++d) {
          const std::int64_t a = i + (d == 0), b = j + (d == 1), c = k + (d == 2);
          if (a == rooms[0] || b == rooms[1] || c == rooms[2]) continue;
          const std::uint64_t from = flat(rooms, i, j, k);
          passages.push_back({random_bits(16, kFaceStream + static_cast<std::uint64_t>(d), from), from,
                              flat(rooms, a, b, c), flat(n, i + a, j + b, k + c)});
        }
      }
    }
  }
  std::sort(passages.begin(), passages.end(), [](const Passage& a, const Passage& b) {
    return std::pair(a.order, a.cell) < std::pair(b.order, b.cell);
  });
  // Kruskal: a passage is opened when it joins two rooms that are not connected yet.
  std::vector<std::uint64_t> parent(static_cast<std::size_t>(rooms[0] * rooms[1] * rooms[2]));
  std::iota(parent.begin(), parent.end(), std::uint64_t{0});
  const auto root = [&](std::uint64_t r) {
    while (parent[r] != r) r = parent[r] = parent[parent[r]];
    return r;
  };
  for (const Passage& p : passages) {
    const std::uint64_t a = root(p.from), b = root(p.to);
    if (a == b) continue;
    parent[a] = b;
    active[p.cell] = 1;
  }
  return box_with_rough_solution(
      n, 16, [&](std::int64_t i, std::int64_t j, std::int64_t k) { return active[flat(n, i, j, k)] != 0; },
      unit_conductance);
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

const char* const kFiniteWhy = "no value of a well-posed system's solution is NaN or infinite";

InputSet hard(const std::string& stress, const std::string& about, std::function<Problem()> make) {
  return hard_case(stress, about, std::move(make), {poisson::finite_check(kFiniteWhy)});
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

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  sets.push_back(
      hard("contrast_1e6", "every face has its own conductance between 1e-6 and 1 (log-uniform)", contrast));
  sets.push_back(hard("layers_1e6", "layers three cells thick of conductance 1 and 2^-20 (9.5e-7)", layers));
  sets.push_back(hard("slivers_1e6",
                      "one cell in ten of a cut-cell cylinder is open by a further factor of 1e-6 only",
                      slivers));
  sets.push_back(hard("channel_512x4x4", "a long thin channel: the smallest eigenvalue is 4e-5", channel));
  sets.push_back(with_residual_bound(
      hard("channel_source_sink",
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
  sets.push_back([] {
    InputSet s =
        hard("zero_rhs", "b = 0 on a cut-cell cylinder", [] { return cylinder_matrix(21, 19, 14, 4); });
    s.invariants.push_back(poisson::zero_solution_check("the task defines the solution for b = 0 as x = 0"));
    return s;
  }());
  sets.push_back([] {
    InputSet s = hard("one_cell",
                      "a single active cell: the matrix is 1 x 1 and the null space is everything", one_cell);
    s.invariants.push_back(poisson::zero_solution_check("the only zero-mean field on one cell is 0"));
    return s;
  }());
  sets.push_back(
      hard("two_cells", "two active cells on either side of a block boundary (k = 7 and 8)", two_cells));
  sets.push_back(hard("odd_33x17x5",
                      "odd sizes, random active cells (the largest component), random conductances",
                      odd_sizes));
  sets.push_back(hard("maze", "a maze of one-cell-wide tunnels without loops (a spanning tree)", maze));
  sets.push_back(with_residual_bound(
      hard("incompatible_rhs", "b carries a constant offset of 1e-5 of its rms that no x can produce",
           incompatible),
      poisson::residual_over_bound_check(
          "residual_incompatible", "twice the incompatible part of b",
          [](const Problem& p) { return 2 * incompatible_level(p); },
          "the incompatible part |sum b| / (sqrt(n) ||b||) stays in the residual whatever x is; the factor 2 "
          "lets a "
          "solver stop when its own part is as large")));
  sets.push_back(hard("tiny_rhs", "b of size 1e-20: its squares are below the range of FP32",
                      [] { return cylinder(22, 22, 20, 0.18 * 22, 18, 1e-20); }));
  sets.push_back(hard("huge_rhs", "b of size 1e20: its squares are above the range of FP32",
                      [] { return cylinder(22, 22, 20, 0.18 * 22, 19, 1e20); }));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.name = "poisson_neumann";
  t.family = "global_solve";
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
      poisson::residual_check(kTolerance, "the paper's tolerance"),
      poisson::mean_check(1e-4, "the paper's tolerance"),
      poisson::zero_outside_check(),
      poisson::local_residual_check(
          kLocalTolerance,
          "a residual that just passes has rms 1e-6 of b's; spread like noise its largest entry is below 6 "
          "times that, and "
          "a factor of nearly 20 more is left for residuals that gather at cut cells and walls"),
  };
  t.knob = AccuracyKnob{"tol", {1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 3e-6, 1e-6}};
  t.target_floor_multiple = 51;
  return t;
}

}  // namespace gpuphys::poisson_neumann
