// Input sets and checks of particle_sdf (specification: cases/collision_query/particle_sdf.md).
#include "cases/collision_query/particle_sdf.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "cases/particle_grid/particle_blocks.hpp"
#include "core/base/parallel.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::particle_sdf {
namespace {

using Extents = std::array<std::int64_t, 3>;
using Vec3 = std::array<double, 3>;
using Particles = std::vector<Vec3>;  // positions in cells

constexpr std::uint64_t kJitter = 0;

/// Lengths other than dx are in cells.
struct Scalars {
  double dx = 0x1p-8, r = 0.5 * 1.7320508075688772, clamp = 1;
};

Problem problem_of(const Particles& particles, const Extents& cells, const Scalars& s) {
  Problem p =
      make_problem(describe<Inputs, Outputs<float>>(), {{"n", static_cast<std::int64_t>(particles.size())},
                                                        {"nx", cells[0]},
                                                        {"ny", cells[1]},
                                                        {"nz", cells[2]}});
  p.set_scalar("nx", static_cast<double>(cells[0]));
  p.set_scalar("ny", static_cast<double>(cells[1]));
  p.set_scalar("nz", static_cast<double>(cells[2]));
  const double dx = static_cast<double>(static_cast<float>(s.dx));
  p.set_scalar("dx", dx);
  p.set_scalar("r", s.r * dx);
  p.set_scalar("clamp", s.clamp * dx);
  const auto x = p.inputs[0].as<float>();
  parallel_for(static_cast<std::int64_t>(particles.size()), [&](std::int64_t i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const auto item = static_cast<std::size_t>(i);
      x[3 * item + c] = static_cast<float>(particles[item][c] * dx);
    }
  });
  return p;
}

/// The paper's data: eight particles in every cell whose centre lies within `radius` cells of the centre of
/// the box, one in each eighth, `margin` away from its walls. In random order.
Particles ball(const Extents& cells, double radius, double margin, std::uint64_t seed) {
  std::vector<std::array<std::int64_t, 3>> filled;
  for (std::int64_t i = 0; i < cells[0]; ++i) {
    for (std::int64_t j = 0; j < cells[1]; ++j) {
      for (std::int64_t k = 0; k < cells[2]; ++k) {
        const Extents cell{i, j, k};
        double square = 0;
        for (std::size_t d = 0; d < 3; ++d) {
          const double a = static_cast<double>(cell[d]) + 0.5 - 0.5 * static_cast<double>(cells[d]);
          square += a * a;
        }
        if (square <= radius * radius) filled.push_back(cell);
      }
    }
  }
  const auto order = particle_blocks::random_order(8 * static_cast<std::int64_t>(filled.size()), seed);
  Particles all(order.size());
  parallel_for(static_cast<std::int64_t>(all.size()), [&](std::int64_t i) {
    const std::uint64_t q = order[static_cast<std::size_t>(i)];
    const Extents& cell = filled[static_cast<std::size_t>(q / 8)];
    const std::array<std::uint64_t, 3> half{q / 4 % 2, q / 2 % 2, q % 2};
    for (std::size_t d = 0; d < 3; ++d) {
      all[static_cast<std::size_t>(i)][d] = static_cast<double>(cell[d]) +
                                            0.5 * static_cast<double>(half[d]) + margin +
                                            (0.5 - 2 * margin) * uniform01(seed, kJitter, 3 * q + d);
    }
  });
  return all;
}

InputSet ball_set(std::string name, SetKind kind, Size size, const Extents& cells, double radius,
                  double length, std::uint64_t seed) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{}x{}x{} cells of 1/{}, eight particles in each cell of a ball of {} cells, seed {}",
                        cells[0], cells[1], cells[2], std::lround(256 / length), radius, seed);
  s.make = [=] { return problem_of(ball(cells, radius, 0.01, seed), cells, {.dx = length / 256}); };
  return s;
}

// ---- checks ----

Check largest_error() {
  return worst_over({.name = "phi_max_error",
                     .kind = CheckKind::paper,
                     .array = "phi",
                     .quantity = "error of phi in cells",
                     .tolerance = 1e-4,
                     .why = "the paper's table of inputs and checks"},
                    [](const Judged& j) {
                      const HostArray &got = output(j, "phi"), &expected = truth(j, "phi");
                      const double dx = j.problem.scalar("dx");
                      const auto error = [=, &got, &expected](std::int64_t i) {
                        return (got.value(i) - static_cast<double>(static_cast<float>(expected.value(i)))) /
                               dx;
                      };
                      return Items{got.size(), error, [=, &got, &expected](std::int64_t i) {
                                     return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, i),
                                                        got.value(i), expected.value(i));
                                   }};
                    });
}

Check not_above_clamp() {
  return count_where(
      {.name = "above_clamp",
       .array = "phi",
       .quantity = "cells above clamp",
       .tolerance = 0,
       .why = "clamp is the largest value",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray& phi = output(j, "phi");
        const double clamp = j.problem.scalar("clamp");
        return Items{phi.size(), [=, &phi](std::int64_t i) { return phi.value(i) <= clamp ? 0.0 : 1.0; }};
      });
}

// A distance cannot change faster than the way that one goes.
Check slope() {
  return count_where(
      {.name = "slope",
       .array = "phi",
       .quantity = "neighbouring cells that differ by more than dx",
       .tolerance = 0,
       .why = "a distance changes by no more than the way between two points; 2^-17 dx for rounding",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray& phi = output(j, "phi");
        const auto shape = phi.shape();
        const double most = j.problem.scalar("dx") * (1 + 0x1p-17);
        const std::array<std::int64_t, 3> step{shape[1] * shape[2], shape[2], 1};
        return Items{phi.size(), [=, &phi](std::int64_t i) {
                       for (std::size_t d = 0; d < 3; ++d) {
                         if (i / step[d] % shape[d] + 1 == shape[d]) continue;
                         if (!(std::abs(phi.value(i) - phi.value(i + step[d])) <= most)) return 1.0;
                       }
                       return 0.0;
                     }};
      });
}

Check tight(double tolerance = 2e-6) {
  return as_invariant(
      largest_error(), "phi_tight", tolerance,
      "the FP32 baseline stays below a quarter of this; rounding grows with the reach in cells");
}

// ---- hard cases ----

InputSet hard(const std::string& stress, const std::string& about, const Extents& cells, const Scalars& s,
              std::function<Particles()> make, std::vector<Check> invariants = {tight()}) {
  return hard_case(
      stress, about, [=, make = std::move(make)] { return problem_of(make(), cells, s); },
      std::move(invariants));
}

// Uniform in a box, in cells.
std::function<Particles()> cloud(std::uint64_t seed, std::size_t n, Vec3 low, Vec3 size) {
  return [=] {
    Particles all(n);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) all[i][d] = low[d] + size[d] * uniform01(seed, d, i);
    }
    return all;
  };
}

// In random order: at multiples of 1/2 cell, `parity` saying which ones along each axis.
std::function<Particles()> half_lattice(const Extents& cells, std::array<int, 3> parity, std::int64_t every) {
  return [=] {
    Particles all;
    for (std::int64_t i = 0; i < cells[0]; ++i) {
      for (std::int64_t j = 0; j < cells[1]; ++j) {
        for (std::int64_t k = 0; k < cells[2]; ++k) {
          if ((i + 2 * j + 3 * k) % every != 0) continue;
          const Extents at{i, j, k};
          Vec3 x;
          for (std::size_t d = 0; d < 3; ++d) {
            x[d] = static_cast<double>(at[d]) + 0.5 * parity[d];
            if (x[d] == 0) x[d] = -0.0;
          }
          all.push_back(x);
        }
      }
    }
    return all;
  };
}

// Beyond every wall, edge and corner of 9x7x5 cells, within reach of the outermost centres, and far away.
Particles outside() {
  Particles all;
  const Vec3 size{9, 7, 5};
  for (int side = 0; side < 27; ++side) {
    const std::array<int, 3> at{side / 9 - 1, side / 3 % 3 - 1, side % 3 - 1};
    if (at == std::array{0, 0, 0}) continue;
    Vec3 x;
    for (std::size_t d = 0; d < 3; ++d) {
      const double beyond = 0.02 + 0.3 * uniform01(41, d, static_cast<std::uint64_t>(side));
      x[d] = at[d] < 0 ? -beyond : at[d] > 0 ? size[d] + beyond : 0.5 + 0.5 * static_cast<double>(side % 5);
    }
    all.push_back(x);
  }
  for (std::size_t d = 0; d < 3; ++d) {
    Vec3 x{4.5, 3.5, 2.5};
    x[d] = 1e20;
    all.push_back(x);
    x[d] = -1e30;
    all.push_back(x);
    x[d] = 3e9;  // more than an integer of 32 bits holds
    all.push_back(x);
  }
  return all;
}

// Distances of 5/4, 5/8 and 13/16 cells from a centre by 3-4-5 and 5-12-13 triangles, several times over.
const std::array<std::pair<Vec3, double>, 4> kTriangles{
    {{{0.75, 1, 0}, 1.25}, {{0, -0.375, 0.5}, 0.625}, {{-0.3125, 0, 0.75}, 0.8125}, {{0.75, 0, -1}, 1.25}}};

Particles triangles() {
  Particles all;
  for (std::size_t t = 0; t < kTriangles.size(); ++t) {
    const double at = 4.5 + 8 * static_cast<double>(t);
    const Vec3& o = kTriangles[t].first;
    for (int again = 0; again < 3; ++again) all.push_back({at + o[0], 4.5 + o[1], 5.5 + o[2]});
  }
  return all;
}

Check triangles_by_hand(const Extents& cells, const Scalars& s) {
  return worst_over({.name = "phi_by_hand",
                     .kind = CheckKind::invariant,
                     .array = "phi",
                     .quantity = "error at four centres, in cells",
                     .tolerance = 2e-7,
                     .why = "distances of 5/4, 5/8, 13/16 and 5/4 cells: float32 holds them",
                     .needs_truth = false},
                    [=](const Judged& j) {
                      const HostArray& phi = output(j, "phi");
                      return Items{static_cast<std::int64_t>(kTriangles.size()), [=, &phi](std::int64_t t) {
                                     const std::int64_t cell = ((4 + 8 * t) * cells[1] + 4) * cells[2] + 5;
                                     const double d = kTriangles[static_cast<std::size_t>(t)].second;
                                     return phi.value(cell) / s.dx - std::min(s.clamp, d - s.r);
                                   }};
                    });
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](InputSet s) { sets.push_back(std::move(s)); };
  add(hard("wide_reach", "60 particles that reach 6.5 cells far, a third of them outside", {37, 34, 45},
           {.dx = 1.0 / 320, .r = 2.5, .clamp = 4}, cloud(31, 60, {-6, -6, -6}, {49, 46, 57}),
           {tight(1e-5)}));
  add(hard("very_wide_reach", "20 particles that reach 20 cells far", {41, 29, 33},
           {.dx = 0.1, .r = 6, .clamp = 14}, cloud(32, 20, {-9, -9, -9}, {59, 47, 51}), {tight(1e-5)}));
  add(hard("short_reach", "a reach of 0.7 cells, less than the half diagonal of a cell", {20, 16, 48},
           {.dx = 0.3, .r = 0.5, .clamp = 0.2}, cloud(33, 15000, {0, 0, 0}, {20, 16, 48})));
  add(hard("points", "r = 0: the distance itself, and no negative value", {21, 17, 19}, {.dx = 1e3, .r = 0},
           cloud(34, 900, {-1, -1, -1}, {23, 19, 21})));
  add(hard("clamp_0", "clamp = 0: the inside only", {18, 23, 20}, {.dx = 1e-6, .r = 1.2, .clamp = 0},
           cloud(35, 500, {0, 0, 0}, {18, 23, 20})));
  add(hard("clamp_negative", "clamp = -0.5 cells", {18, 16, 21}, {.dx = 0.01, .r = 1.75, .clamp = -0.5},
           cloud(36, 400, {0, 0, 0}, {18, 16, 21})));
  add(hard("nothing_within", "clamp = -r: nothing is nearer than that", {5, 6, 7},
           {.dx = 0.5, .r = 1, .clamp = -1}, cloud(37, 100, {0, 0, 0}, {5, 6, 7}),
           {tight(), within("phi", -0.5, -0.5, "min(clamp, d - r) is clamp for any d")}));
  add(hard("one_per_cell", "24x40x33 cells with one particle on average: many are empty, some hold six",
           {24, 40, 33}, {.dx = 1.0 / 320}, cloud(38, 24 * 40 * 33, {0, 0, 0}, {24, 40, 33})));
  add(hard("thirty_per_cell", "a slab with 30 particles per cell on average", {33, 20, 16}, {},
           cloud(39, 30 * 33 * 7 * 16, {0, 6, 0}, {33, 7, 16})));
  add(hard("crowded_cell", "100000 particles in one cell", {9, 11, 10}, {.dx = 0.07},
           cloud(40, 100000, {4.01, 5.01, 6.01}, {0.98, 0.98, 0.98})));
  add(hard("outside", "particles beyond every wall, edge and corner, and at 3e9, 1e20 and -1e30 cells",
           {9, 7, 5}, {.dx = 1.0 / 320}, outside));
  add(hard("nothing_near", "the only particle is out of reach", {7, 5, 9}, {.dx = 0.25},
           [] {
             return Particles{{100, 2, 3}};
           },
           {within("phi", 0.25, 0.25, "clamp everywhere")}));
  add(hard("one_cell", "a grid of one cell, and one particle in it", {1, 1, 1}, {}, [] {
    return Particles{{0.25, 0.5, 0.875}};
  }));
  add(hard("line_x", "70000x1x2 cells", {70000, 1, 2}, {.dx = 0x1p-6},
           cloud(42, 9000, {0, -1, 0}, {70000, 2, 2})));
  add(hard("line_y", "2x70000x1 cells", {2, 70000, 1}, {.dx = 0x1p-6},
           cloud(43, 9000, {0, 0, -1}, {2, 70000, 2})));
  add(hard("line_z", "1x3x70000 cells", {1, 3, 70000}, {.dx = 0x1p-6},
           cloud(44, 9000, {-1, 0, 0}, {2, 3, 70000})));
  add(hard("offset_4000", "cells 4000 from the origin, of an edge that is no power of two", {4096, 3, 5},
           {.dx = 0.1}, cloud(45, 8000, {0, 0, 0}, {4096, 3, 5})));
  add(hard("on_centres", "particles on centres and on -0: phi is exactly -r there", {12, 14, 17},
           {.dx = 0.5, .r = 0.75}, half_lattice({12, 14, 17}, {1, 1, 1}, 5),
           {tight(), within("phi", -0.375, 0.5, "no distance is negative")}));
  add(hard("on_corners", "particles on corners of cells, as far from eight centres", {12, 14, 17},
           {.dx = 0.25}, half_lattice({12, 14, 17}, {0, 0, 0}, 4)));
  add(hard("on_faces", "particles on faces and edges of cells", {13, 12, 11}, {.dx = 2},
           half_lattice({13, 12, 11}, {1, 0, 0}, 7)));
  const Scalars triangle_scalars{.dx = 0x1p-4, .r = 0.75, .clamp = 1};
  const Extents triangle_cells{36, 9, 10};
  add(hard("triangles", "3-4-5 and 5-12-13 triangles, three particles in each place", triangle_cells,
           triangle_scalars, triangles, {tight(), triangles_by_hand(triangle_cells, triangle_scalars)}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Clamped signed distance to a union of particle spheres, on a grid";
  t.paper_number = 44;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      ball_set("public", SetKind::open, Size::paper, {256, 256, 256}, 64, 1.0, 1),
      ball_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, 64, 0.8, 2),
      ball_set("public_smoke", SetKind::open, Size::smoke, {37, 34, 45}, 12, 1.0, 1),
      ball_set("hidden_smoke", SetKind::hidden, Size::smoke, {33, 42, 36}, 12, 0.8, 2),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {largest_error(), not_above_clamp(), slope()};
  t.unordered = {{"n", {}}};
  t.target_floor_multiple = 7;
  return t;
}

}  // namespace gpuphys::particle_sdf
