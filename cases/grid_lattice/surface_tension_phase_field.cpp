// Input sets and checks of surface_tension_phase_field (specification:
// cases/grid_lattice/surface_tension_phase_field.md).
#include "cases/grid_lattice/surface_tension_phase_field.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "cases/grid_lattice/drops.hpp"
#include "cases/grid_lattice/force_checks.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::surface_tension_phase_field {
namespace {

using drops::Drop;
using drops::Grid;
using drops::Layout;

struct Law {
  double beta, kappa;
};
/// Surface tension 0.01, interfaces 4 cells wide: 12 sigma / W and 3/2 sigma W.
constexpr Law kLaw{0.03, 0.06};
constexpr double kWidth = 4;

Problem problem_of(Grid g, Law law, const std::vector<float>& phi) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  p.set_scalar("beta", law.beta);
  p.set_scalar("kappa", law.kappa);
  std::copy(phi.begin(), phi.end(), p.inputs[0].as<float>().begin());
  return p;
}

InputSet drop_set(std::string name, SetKind kind, Size size, Grid g, const Layout& layout) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{}x{}x{} cells, {} drops with radii of {} to {}, interfaces {} wide, seed {}", g.nx,
                        g.ny, g.nz, layout.count, layout.smallest, layout.largest, kWidth, layout.seed);
  s.make = [=] { return problem_of(g, kLaw, drops::field(g, drops::random_drops(layout, g), kWidth)); };
  return s;
}

// ---- checks ----

std::vector<Check> tight() {
  return {as_invariant(force::relative_l2(0, ""), "force_rel_l2_tight", 1.5e-6,
                       "FP32 shows 2e-7: the two parts of the potential cancel to a tenth of their size"),
          as_invariant(force::local(0, ""), "force_local_tight", 2e-5, "FP32 shows 3e-6 of the rms")};
}

// Slabs of 0, 1/2 and 1 across one axis, eight cells in all.
constexpr std::array<double, 8> kSlabs{0, 0, 0.5, 1, 1, 0.5, 0.5, 1};

Check slabs_by_hand(int axis) {
  return worst_over(
      {.name = "by_hand",
       .kind = CheckKind::invariant,
       .array = "fx, fy, fz",
       .quantity = "largest error of a component",
       .tolerance = 1e-7,
       .why = "in slabs the derivatives are those of three cells in a row and the force is 0, 1/64, 1/32 "
              "...: the "
              "weights 1/6 and 1/12 cost a few units of 2^-24 of that",
       .needs_truth = false},
      [axis](const Judged& j) {
        const double kappa = j.problem.scalar("kappa");
        const std::array<const HostArray*, 3> f{&output(j, "fx"), &output(j, "fy"), &output(j, "fz")};
        const Shape shape = f[0]->shape();
        return Items{
            3 * f[0]->size(),
            [=](std::int64_t item) {
              const std::int64_t cell = item / 3;
              const std::array<std::int64_t, 3> at{cell / (shape[1] * shape[2]), cell / shape[2] % shape[1],
                                                   cell % shape[2]};
              const auto n = static_cast<std::size_t>(at[static_cast<std::size_t>(axis)]);
              const double up = kSlabs[(n + 1) % 8], down = kSlabs[(n + 7) % 8];
              // The double well has no slope at 0, 1/2 and 1.
              const double mu = -kappa * (up + down - 2 * kSlabs[n]);
              return f[static_cast<std::size_t>(item % 3)]->value(cell) -
                     (item % 3 == axis ? mu * (up - down) / 2 : 0);
            },
            [=](std::int64_t item) { return index_text(*f[static_cast<std::size_t>(item % 3)], item / 3); }};
      });
}

// ---- hard cases ----

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, Grid g, Law law,
                       std::function<std::vector<float>()> phi, std::vector<Check> also = {}) {
    for (Check& c : tight()) also.push_back(std::move(c));
    sets.push_back(hard_case(
        stress, about, [=] { return problem_of(g, law, phi()); }, std::move(also)));
  };
  const auto uniform = [&](const std::string& stress, const std::string& about, float even, float odd) {
    const std::string why = "no gradient: differences of equal numbers are exactly zero";
    add(stress, about, {5, 6, 20}, kLaw,
        [=] {
          std::vector<float> phi(600);
          for (std::size_t c = 0; c < phi.size(); ++c) phi[c] = c % 3 == 0 ? odd : even;
          return phi;
        },
        {exactly_zero("fx", why), exactly_zero("fy", why), exactly_zero("fz", why)});
  };
  uniform("uniform_1e6", "phi = 1e6 everywhere", 1e6f, 1e6f);
  uniform("uniform_zero", "zeros of both signs", 0.0f, -0.0f);
  for (const int axis : {0, 1, 2}) {
    const Grid g = axis == 0 ? Grid{8, 3, 5} : axis == 1 ? Grid{5, 8, 16} : Grid{3, 5, 8};
    add(fmt::format("slabs_{}", "xyz"[axis]), "slabs of 0, 1/2 and 1: forces by hand", g, {0.25, 0.125},
        [=] {
          std::vector<float> phi;
          for (std::int64_t cell = 0; cell < g.nx * g.ny * g.nz; ++cell) {
            const std::array<std::int64_t, 3> at{cell / (g.ny * g.nz), cell / g.nz % g.ny, cell % g.nz};
            phi.push_back(
                static_cast<float>(kSlabs[static_cast<std::size_t>(at[static_cast<std::size_t>(axis)])]));
          }
          return phi;
        },
        {slabs_by_hand(axis)});
  }
  const auto drop_field = [](Grid g, std::vector<Drop> all, double width) {
    return [=] { return drops::field(g, all, width); };
  };
  add("corner_drop", "a drop about the corner of the box: it crosses all six faces", {26, 23, 28}, kLaw,
      drop_field({26, 23, 28}, {{{0.3, 22.6, 0.1}, 7}}, 4));
  add("sharp_drops", "interfaces of one cell, with the law of four", {22, 19, 25}, kLaw,
      drop_field({22, 19, 25}, {{{6, 7, 8}, 4.5}, {{15, 12, 17}, 5}}, 1));
  add("merging_drops", "overlapping drops: a kink where the deeper one changes", {24, 21, 30}, {1, 0.02},
      drop_field({24, 21, 30}, {{{9, 10, 11}, 6}, {{15.5, 11, 14}, 6.5}, {{12, 10, 22}, 5}}, 4));
  add("no_well", "beta = 0: the gradient energy alone", {17, 18, 19}, {0, 1}, [] {
    return drops::noise({17, 18, 19}, 11, 0, 1);
  });
  add("no_gradient_energy", "kappa = 0: the double well alone", {18, 19, 17}, {1, 0}, [] {
    return drops::noise({18, 19, 17}, 12, -0.2, 1.2);
  });
  add("negative", "beta and kappa negative", {13, 11, 36}, {-0.5, -2}, [] {
    return drops::noise({13, 11, 36}, 13, -0.2, 1.2);
  });
  add("near_one", "1 + 1e-6 noise: phi - 1 must be formed before the product", {11, 13, 20}, {0.03, 1e-9},
      [] {
        return drops::noise({11, 13, 20}, 14, 1 - 1e-6, 1 + 1e-6);
      });
  add("near_half", "1/2 + 1e-6 noise", {11, 13, 21}, {0.03, 1e-9}, [] {
    return drops::noise({11, 13, 21}, 15, 0.5 - 1e-6, 0.5 + 1e-6);
  });
  add("huge", "phi of 1e6 and both signs: its cube reaches 1e18", {9, 14, 16}, kLaw, [] {
    return drops::noise({9, 14, 16}, 16, -1e6, 1e6);
  });
  add("faint", "phi of 1e-12", {9, 14, 17}, kLaw, [] {
    return drops::noise({9, 14, 17}, 17, -1e-12, 1e-12);
  });
  add("offset", "noise of 1 on 1000", {10, 12, 14}, {1e-6, 100}, [] {
    return drops::noise({10, 12, 14}, 18, 1000, 1001);
  });
  // A rough field shows every wrong index; extents at and below the reach of a difference, rows of every
  // remainder, more than 65,535 cells along each axis.
  for (const Grid g : {Grid{1, 1, 1}, Grid{2, 2, 2}, Grid{1, 5, 33}, Grid{7, 1, 9}, Grid{2, 3, 1201},
                       Grid{3, 5, 16}, Grid{5, 3, 20}, Grid{4, 3, 48}, Grid{3, 4, 45}, Grid{130, 9, 132},
                       Grid{70000, 1, 2}, Grid{1, 70000, 2}, Grid{2, 1, 70000}}) {
    add(fmt::format("grid_{}x{}x{}", g.nx, g.ny, g.nz), "rough noise", g, {0.7, 0.3},
        [g] { return drops::noise(g, 7, -0.2, 1.2); });
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Surface-tension force of a phase field";
  t.paper_number = 28;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      drop_set("public", SetKind::open, Size::paper, {544, 512, 480}, {1, 60, 16, 44}),
      drop_set("hidden", SetKind::hidden, Size::paper, {544, 512, 480}, {2, 60, 14, 38}),
      drop_set("public_smoke", SetKind::open, Size::smoke, {94, 86, 76}, {1, 12, 8, 16}),
      drop_set("hidden_smoke", SetKind::hidden, Size::smoke, {82, 90, 71}, {2, 12, 7, 14}),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      force::relative_l2(5e-4, "the paper's table of inputs and checks"),
      force::local(6e-4, "FP32 shows 6e-5 of the rms at paper size"),
  };
  t.target_floor_multiple = 1.08;
  return t;
}

}  // namespace gpuphys::surface_tension_phase_field
