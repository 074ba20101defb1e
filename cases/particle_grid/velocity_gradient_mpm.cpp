// Input sets and checks of velocity_gradient_mpm (specification:
// cases/particle_grid/velocity_gradient_mpm.md).
#include "cases/particle_grid/velocity_gradient_mpm.hpp"

#include <fmt/format.h>

#include "cases/particle_grid/entry_checks.hpp"
#include "cases/particle_grid/node_velocity.hpp"
#include "cases/particle_grid/particle_blocks.hpp"
#include "core/base/parallel.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::velocity_gradient_mpm {
namespace {

using node_velocity::kDx;
using node_velocity::Nodes;
using node_velocity::Stress;

constexpr int kMaxWaveNumber = 8;

Problem empty_problem(const Nodes& nodes, std::int64_t n, double dx) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(),
                           {{"n", n}, {"nx", nodes[0]}, {"ny", nodes[1]}, {"nz", nodes[2]}});
  p.set_scalar("dx", dx);
  return p;
}

/// Eight particles in each of the cells [low, low + size), in random order.
Problem block_problem(const Nodes& nodes, const Nodes& low, const Nodes& size, std::uint64_t seed,
                      double period) {
  const std::int64_t n = 8 * size[0] * size[1] * size[2];
  Problem p = empty_problem(nodes, n, kDx);
  const auto order = particle_blocks::random_order(n, seed);
  const auto x = p.inputs[0].as<float>();
  parallel_pieces(n, [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t q = begin; q < end; ++q) {
      const std::int64_t particle = order[static_cast<std::size_t>(q)], cell = particle / 8,
                         half = particle % 8;
      const Nodes at{low[0] + cell / size[2] / size[1], low[1] + cell / size[2] % size[1],
                     low[2] + cell % size[2]};
      const Nodes upper{half / 4, half / 2 % 2, half % 2};
      for (std::size_t d = 0; d < 3; ++d) {
        const double g = static_cast<double>(at[d]) + 0.25 + 0.5 * static_cast<double>(upper[d]);
        x[static_cast<std::size_t>(3 * q) + d] = static_cast<float>(g * kDx);
      }
    }
  });
  for (std::size_t c = 0; c < 3; ++c) {
    node_velocity::fill_nodes(seed + 1000, kMaxWaveNumber, period, static_cast<int>(c), p.inputs[1 + c]);
  }
  return p;
}

std::string entry_name(std::int64_t e) {
  return fmt::format("G{}{}", "xyz"[e / 3], "xyz"[e % 3]);
}

/// A hundred times tighter than the paper where there are few particles.
std::vector<Check> tight() {
  return {as_invariant(
      relative_l2_check("G", 0, ""), "G_tight", 1e-6,
      "the FP32 baseline stays below 2e-7 on all small sets; the paper's tolerance of 1e-4 leaves "
      "room for gradients of absolute velocities")};
}

std::vector<Check> invariants_of(const std::string& stress) {
  std::vector<Check> checks = tight();
  if (stress == "thin") {  // one node along x: the gradient along it is 0, or rounding of that
    checks.push_back(as_invariant(local_error_check("G", 0, ""), "G_local", 1e-5,
                                  "as the task's local checks, over the rms of all entries together"));
  }
  if (stress == "constant") {
    checks.push_back(equals_known(
        {.name = "no_gradient",
         .kind = CheckKind::invariant,
         .array = "G",
         .quantity = "gradient of a constant field over 1000 m/s / dx",
         .tolerance = 0x1p-20,
         .why = "27 equal values; what is left is the rounding of the absolute velocity, for codes that keep "
                "it"},
        [](const Judged& j) {
          return std::vector<double>(static_cast<std::size_t>(output(j, "G").size()), 0.0);
        },
        node_velocity::kConstant[0] / kDx));
  }
  if (stress == "linear") {
    checks.push_back(equals_known(
        {.name = "G_linear",
         .kind = CheckKind::invariant,
         .array = "G",
         .quantity = "G[a][b] = dv_a/dx_b of the linear field",
         .tolerance = 0x1p-22,
         .why = "dyadic numbers: every product and sum is exact in float32"},
        [](const Judged& j) {
          std::vector<double> known;
          for (std::int64_t e = 0; e < output(j, "G").size(); ++e)
            known.push_back(
                node_velocity::kRate[static_cast<std::size_t>(e % 9 / 3)][static_cast<std::size_t>(e % 3)]);
          return known;
        }));
  }
  return checks;
}

InputSet block_set(const std::string& name, SetKind kind, Size size, const Nodes& nodes, const Nodes& low,
                   const Nodes& cells, std::uint64_t seed, double period) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about =
      fmt::format("{} x {} x {} cells of {} x {} x {} nodes, 8 particles per cell in random order, seed {}",
                  cells[0], cells[1], cells[2], nodes[0], nodes[1], nodes[2], seed);
  s.make = [=] { return block_problem(nodes, low, cells, seed, period); };
  if (size == Size::smoke) s.invariants = tight();
  return s;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Velocity gradient at MPM particles from grid velocities (quadratic B-splines)";
  t.paper_number = 35;
  t.contract = describe<Inputs, Outputs<float>>();
  t.unordered = {{"n", {}}};
  t.sets = {
      block_set("public", SetKind::open, Size::paper, {256, 256, 256}, {64, 64, 64}, {128, 128, 128}, 1, 1.0),
      block_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, {64, 64, 64}, {128, 128, 128}, 2,
                1.0),
      // The second fills its grid from wall to wall.
      block_set("public_smoke", SetKind::open, Size::smoke, {37, 34, 45}, {5, 3, 7}, {23, 25, 21}, 1,
                64 * kDx),
      block_set("hidden_smoke", SetKind::hidden, Size::smoke, {22, 27, 25}, {0, 0, 0}, {21, 26, 24}, 2,
                64 * kDx),
  };
  for (const Stress& s : node_velocity::stresses()) {
    t.sets.push_back(hard_case(
        s.name, s.about,
        [=] {
          Problem p = empty_problem(s.nodes, s.n, s.dx);
          node_velocity::fill(s, p.inputs[0], p.inputs[1], p.inputs[2], p.inputs[3]);
          return p;
        },
        invariants_of(s.name), s.name != "thin"));
  }
  for (std::int64_t e = 0; e < 9; ++e) {
    t.checks.push_back(entry_checks::relative_l2_of_entry("G", e, entry_name(e), 1e-4,
                                                          "the paper's table of inputs and checks"));
    t.checks.push_back(entry_checks::local_error_of_entry(
        "G", e, entry_name(e), 1e-5,
        "ten times the largest error of the FP32 baseline, below 1e-6 of the rms"));
  }
  t.target_floor_multiple = 2.6;
  return t;
}

}  // namespace gpuphys::velocity_gradient_mpm
