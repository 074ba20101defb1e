// Input sets and checks of cahn_hilliard (specification: cases/grid_lattice/cahn_hilliard.md).
#include "cases/grid_lattice/cahn_hilliard.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>

#include "cases/grid_lattice/drops.hpp"
#include "core/base/parallel.hpp"
#include "core/contract/task.hpp"
#include "core/generators/abc_flow.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::cahn_hilliard {
namespace {

using drops::Drop;
using drops::Grid;
using drops::Layout;
using lattice::VelocitySet;

constexpr std::int64_t kQ = 19;

struct Law {
  double tau, beta, kappa, eta;
};
/// Surface tension 0.02, interfaces 4 cells wide: 12 sigma / W and 3/2 sigma W.
constexpr Law kLaw{0.8, 0.06, 0.12, 1};
constexpr double kWidth = 4;

struct Flow {
  int periods;
  double mach;
};
constexpr Flow kAtRest{0, 0};

/// Populations: the equilibrium of phi and u without the chemical potential, plus amplitude w_q (R_q - mean
/// R) phi, which leaves phi as it is. R is uniform in [-1,1): random stream q, item = flat cell index.
Problem problem_of(Grid g, Law law, const std::vector<float>& phi, Flow flow, double amplitude,
                   std::uint64_t seed) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  p.set_scalar("tau", law.tau);
  p.set_scalar("beta", law.beta);
  p.set_scalar("kappa", law.kappa);
  p.set_scalar("eta", law.eta);
  const VelocitySet& s = lattice::velocity_set(kQ);
  const AbcFlow abc =
      AbcFlow::periodic(flow.mach / 3, flow.periods,
                        {static_cast<double>(g.nx), static_cast<double>(g.ny), static_cast<double>(g.nz)});
  const auto h = p.inputs[0].as<float>();
  const std::array u{p.inputs[1].as<float>(), p.inputs[2].as<float>(), p.inputs[3].as<float>()};
  const std::int64_t cells = g.nx * g.ny * g.nz;
  parallel_for(g.nx * g.ny, [&](std::int64_t row) {
    for (std::int64_t k = 0; k < g.nz; ++k) {
      const auto cell = static_cast<std::size_t>(row * g.nz + k);
      const std::array<double, 3> v = flow.mach == 0
                                          ? std::array<double, 3>{}
                                          : abc.at(static_cast<double>(row / g.ny),
                                                   static_cast<double>(row % g.ny), static_cast<double>(k));
      for (std::size_t d = 0; d < 3; ++d) u[d][cell] = static_cast<float>(v[d]);
      std::array<double, kQ> noise{};
      double mean = 0;
      if (amplitude != 0) {
        for (std::size_t q = 0; q < noise.size(); ++q) {
          noise[q] = uniform11(seed, q, cell);
          mean += s.w[q] * noise[q];
        }
      }
      const double value = static_cast<double>(phi[cell]);
      for (std::size_t q = 0; q < noise.size(); ++q) {
        const double cu = s.c[q][0] * v[0] + s.c[q][1] * v[1] + s.c[q][2] * v[2];
        const double equilibrium = q == 0 ? 1 : 3 * s.w[q] * cu;
        h[q * static_cast<std::size_t>(cells) + cell] =
            static_cast<float>(value * (equilibrium + amplitude * s.w[q] * (noise[q] - mean)));
      }
    }
  });
  return p;
}

InputSet drop_set(std::string name, SetKind kind, Size size, Grid g, const Layout& layout, Flow flow,
                  double amplitude) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "{}x{}x{} cells, {} drops with radii of {} to {}, interfaces {} wide, ABC flow of {} periods at "
      "Mach {}, non-equilibrium part {}, seed {}",
      g.nx, g.ny, g.nz, layout.count, layout.smallest, layout.largest, kWidth, flow.periods, flow.mach,
      amplitude, layout.seed);
  s.make = [=] {
    return problem_of(g, kLaw, drops::field(g, drops::random_drops(layout, g), kWidth), flow, amplitude,
                      layout.seed);
  };
  return s;
}

// ---- checks ----

std::int64_t cells_of(const HostArray& h) {
  return h.size() / kQ;
}

// Sum of a cell's populations.
double phase(const HostArray& h, std::int64_t cell) {
  double sum = 0;
  for (std::int64_t q = 0; q < kQ; ++q) sum += h.value(q * cells_of(h) + cell);
  return sum;
}

// The rest population carries nearly all of the norm; the eighteen that move are held to their own.
Check moving_local(const std::string& name, CheckKind kind, double tolerance, const std::string& why) {
  return worst_over({.name = name,
                     .kind = kind,
                     .array = "h",
                     .quantity = "error of a population that moves over the rms of those",
                     .tolerance = tolerance,
                     .why = why},
                    [](const Judged& j) {
                      const HostArray &got = output(j, "h"), &expected = truth(j, "h");
                      const std::int64_t first = cells_of(got), count = got.size() - first;
                      std::vector<double> sums(static_cast<std::size_t>(pieces_of(count)), 0.0);
                      parallel_pieces(count, [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
                        for (std::int64_t i = begin; i < end; ++i) {
                          const double v = expected.value(first + i);
                          sums[static_cast<std::size_t>(piece)] += v * v;
                        }
                      });
                      double square = 0;
                      for (const double sum : sums) square += sum;
                      const double rms = square > 0 ? std::sqrt(square / static_cast<double>(count)) : 1;
                      return Items{
                          count,
                          [&got, &expected, first, rms](std::int64_t i) {
                            const auto e = static_cast<double>(static_cast<float>(expected.value(first + i)));
                            return (got.value(first + i) - e) / rms;
                          },
                          [&got, &expected, first](std::int64_t i) {
                            return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, first + i),
                                               got.value(first + i), expected.value(first + i));
                          }};
                    });
}

Check phase_conserved() {
  return conserved_sum(
      {.name = "phase_conserved",
       .kind = CheckKind::invariant,
       .array = "h",
       .quantity = "sum of all populations before and after",
       .tolerance = 1e-6,
       .why = "a step only moves phi about; float32 weights sum to 1 within 3e-8 of eta mu + phi",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &before = input(j, "h"), &after = output(j, "h");
        double expected = 0, scale = 0;
        for (std::int64_t i = 0; i < before.size(); ++i) {
          expected += before.value(i);
          scale += std::abs(before.value(i));
        }
        return Terms{after.size(),
                     [&after](std::int64_t i) {
                       return std::array<double, 3>{after.value(i), 0, 0};
                     },
                     {expected, 0, 0},
                     scale};
      });
}

Check output_is_input(const std::string& why) {
  return count_where({.name = "unchanged",
                      .kind = CheckKind::invariant,
                      .array = "h",
                      .quantity = "populations that are not what they were",
                      .tolerance = 0,
                      .why = why,
                      .needs_truth = false},
                     [](const Judged& j) {
                       const HostArray &before = input(j, "h"), &after = output(j, "h");
                       return Items{
                           after.size(),
                           [&](std::int64_t i) { return after.value(i) == before.value(i) ? 0.0 : 1.0; },
                           [&](std::int64_t i) { return index_text(after, i); }};
                     });
}

Check profile_kept(double tolerance, const std::string& why) {
  return worst_over({.name = "profile_kept",
                     .kind = CheckKind::invariant,
                     .array = "h",
                     .quantity = "largest change of phi",
                     .tolerance = tolerance,
                     .why = why,
                     .needs_truth = false},
                    [](const Judged& j) {
                      const HostArray &before = input(j, "h"), &after = output(j, "h");
                      return Items{
                          cells_of(after),
                          [&](std::int64_t cell) { return phase(after, cell) - phase(before, cell); },
                          [&](std::int64_t cell) { return index_text(after, cell); }};
                    });
}

// Small sets are held to what FP32 shows, not to what the paper's size needs.
std::vector<Check> tight() {
  return {as_invariant(relative_l2_check("h", 0, ""), "h_rel_l2_tight", 1.5e-6, "FP32 shows 1.5e-7"),
          moving_local("moving_local_tight", CheckKind::invariant, 1e-5, "FP32 shows 1.5e-6")};
}

// ---- hard cases ----

// All 19 populations independent: no value can pass for another. phi is about size (0.5 +- 0.5).
Problem rough(Grid g, Law law, std::uint64_t seed, double size = 1) {
  Problem p =
      problem_of(g, law, std::vector<float>(static_cast<std::size_t>(g.nx * g.ny * g.nz)), kAtRest, 0, seed);
  const auto h = p.inputs[0].as<float>();
  const std::size_t cells = h.size() / kQ;
  for (std::size_t i = 0; i < h.size(); ++i)
    h[i] = static_cast<float>(size * ((i < cells ? 0.5 : 0) + 0.08 * uniform11(seed, 70, i)));
  for (const std::size_t u : {1u, 2u, 3u}) {
    std::uint64_t item = 0;
    for (float& v : p.inputs[u].as<float>()) v = static_cast<float>(0.3 * uniform11(seed, 70 + u, item++));
  }
  return p;
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, std::function<Problem()> make,
                       std::vector<Check> also = {phase_conserved()}) {
    for (Check& c : tight()) also.push_back(std::move(c));
    sets.push_back(hard_case(stress, about, std::move(make), std::move(also)));
  };
  const auto add_drops = [&](const std::string& stress, const std::string& about, Grid g, Law law,
                             std::vector<Drop> all, double width, Flow flow = {2, 0.08},
                             double amplitude = 0.3) {
    add(stress, about, [=] { return problem_of(g, law, drops::field(g, all, width), flow, amplitude, 9); });
  };

  for (const float value : {0.0f, 0.5f, 1.0f}) {
    add(fmt::format("uniform_{}", value == 0.5f ? "half"
                                  : value == 0  ? "zero"
                                                : "one"),
        "phi the same everywhere, at rest, all of it in the rest population: no potential",
        [=] {
          Problem p =
              problem_of({6, 5, 20}, {0.7, 0.06, 0.12, 1}, std::vector<float>(600, value), kAtRest, 0, 1);
          // Zeros of both signs.
          const auto h = p.inputs[0].as<float>();
          for (std::size_t i = 0; i < h.size(); i += 3) h[i] = h[i] == 0 ? -0.0f : h[i];
          return p;
        },
        {output_is_input("mu is exactly zero at 0, 1/2 and 1, and so is every difference")});
  }
  // Truth is next to nothing where nothing moves: no comparison.
  sets.push_back(hard_case(
      "plane_at_rest", "plane interfaces 6 cells wide at rest",
      [] {
        const Grid g{3, 2, 96};
        std::vector<float> phi;
        for (std::int64_t cell = 0; cell < 6 * 96; ++cell) {
          phi.push_back(
              static_cast<float>(drops::profile(24 - std::abs(static_cast<double>(cell % 96) - 47.5), 6)));
        }
        return problem_of(g, {0.8, 0.04, 0.18, 1}, phi, kAtRest, 0, 1);
      },
      {profile_kept(
           2e-4,
           "the profile is stationary but for the h^2 error of the Laplacian, mu = 7e-4, of which a sixth of "
           "the second difference moves; without kappa it is 8e-4"),
       phase_conserved()},
      false));
  add_drops("tau_near_half", "tau = 0.51: hardly any mobility", {22, 19, 26}, {0.51, 0.06, 0.12, 1},
            {{{8, 9, 10}, 6}, {{16, 8, 20}, 4}}, 4);
  add_drops("tau_large", "tau = 1.7", {21, 23, 20}, {1.7, 0.06, 0.12, 1},
            {{{8, 9, 10}, 6}, {{16, 16, 15}, 4}}, 4);
  add_drops("corner_drop", "a drop about the corner of the box: it crosses all six faces", {24, 21, 27}, kLaw,
            {{{0.3, 20.7, 0.1}, 7}}, 4);
  add_drops("sharp_drops", "interfaces 2 cells wide", {20, 22, 26}, {0.8, 0.12, 0.06, 1},
            {{{8, 7, 9}, 5}, {{14, 15, 18}, 4.5}}, 2);
  add_drops("low_mobility", "eta = 0.25; beta and kappa not tied by a width", {19, 18, 24},
            {0.8, 0.013, 0.2, 0.25}, {{{8, 7, 9}, 5}, {{14, 13, 18}, 4.5}}, 4);
  add_drops("negative_mobility", "eta = -2", {17, 18, 22}, {0.9, 0.3, 0.01, -2}, {{{8, 7, 9}, 5}}, 4);
  add_drops("no_potential", "beta = kappa = 0: advection alone", {18, 17, 22}, {0.75, 0, 0, 1},
            {{{8, 7, 9}, 5}}, 4, {1, 0.3});
  add("spike", "phi = 1 in a single cell", [] {
    std::vector<float> phi(3 * 4 * 5);
    phi[33] = 1;
    return problem_of({3, 4, 5}, kLaw, phi, {1, 0.1}, 0, 1);
  });
  add("huge", "phi of 1e6: its cube reaches 1e18", [] { return rough({9, 10, 12}, kLaw, 21, 1e6); }, {});
  add("faint", "populations of 1e-18", [] { return rough({9, 10, 13}, kLaw, 22, 1e-17); });
  // Rough populations show every wrong index; extents at and below the reach of a velocity, rows of every
  // remainder, rows longer than a block of threads, more than 65,535 cells along each axis.
  for (const Grid g : {Grid{1, 1, 1}, Grid{2, 2, 2}, Grid{1, 5, 33}, Grid{7, 1, 9}, Grid{2, 3, 1201},
                       Grid{3, 5, 16}, Grid{5, 3, 20}, Grid{4, 3, 48}, Grid{3, 4, 45}, Grid{3, 2, 1202},
                       Grid{5, 13, 62}, Grid{70000, 1, 2}, Grid{1, 70000, 2}, Grid{2, 1, 70000}}) {
    add(fmt::format("grid_{}x{}x{}", g.nx, g.ny, g.nz), "rough populations and velocities", [g] {
      return rough(g, {0.6, 0.7, 0.3, 0.5}, 7);
    });
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Lattice Boltzmann step of a Cahn-Hilliard phase field";
  t.paper_number = 26;
  t.contract = describe<Inputs, Outputs<float>>();
  const Flow open{4, 0.05}, hidden{3, 0.042};
  t.sets = {
      drop_set("public", SetKind::open, Size::paper, {272, 256, 240}, {1, 40, 14, 36}, open, 0.3),
      drop_set("hidden", SetKind::hidden, Size::paper, {272, 256, 240}, {2, 40, 12, 32}, hidden, 0.26),
      drop_set("public_smoke", SetKind::open, Size::smoke, {54, 46, 62}, {1, 9, 7, 12}, open, 0.3),
      drop_set("hidden_smoke", SetKind::hidden, Size::smoke, {46, 62, 50}, {2, 9, 6, 11}, hidden, 0.26),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      relative_l2_check("h", 3e-5, "the paper's table of inputs and checks"),
      local_error_check(
          "h", 3e-5,
          "one float32 unit of the rest population is 6e-8, against an rms above 0.05; a population from "
          "a wrong cell is off by 1e-2"),
      moving_local(
          "moving_local", CheckKind::local, 5e-5,
          "the rest population carries 99.99 % of the norm; of the others FP32 shows 5e-6 of their rms, from "
          "the Laplacian's rounding, and a potential that is off by 1 % shows 3e-4"),
  };
  t.target_floor_multiple = 1.6;
  return t;
}

}  // namespace gpuphys::cahn_hilliard
