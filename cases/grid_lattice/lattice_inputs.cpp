#include "cases/grid_lattice/lattice_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/comparators.hpp"
#include "core/error.hpp"
#include "core/generators/abc_flow.hpp"
#include "core/parallel.hpp"
#include "core/random.hpp"

namespace gpuphys::lattice {
namespace {

VelocitySet make_set(int q, double rest, double axis, double edge, double corner) {
  VelocitySet s;
  const auto add = [&](double w, std::initializer_list<std::array<int, 3>> velocities) {
    for (const auto& c : velocities) {
      if (static_cast<int>(s.c.size()) == q) return;
      s.c.push_back(c);
      s.w.push_back(w);
    }
  };
  add(rest, {{0, 0, 0}});
  add(axis, {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}});
  add(edge, {{1, 1, 0}, {-1, -1, 0}, {1, -1, 0}, {-1, 1, 0}});
  add(edge, {{1, 0, 1}, {-1, 0, -1}, {1, 0, -1}, {-1, 0, 1}});
  add(edge, {{0, 1, 1}, {0, -1, -1}, {0, 1, -1}, {0, -1, 1}});
  add(corner,
      {{1, 1, 1}, {-1, -1, -1}, {1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {-1, 1, -1}, {-1, 1, 1}, {1, -1, -1}});
  return s;
}

std::int64_t wrapped(std::int64_t index, std::int64_t n) {
  return ((index % n) + n) % n;
}

Grid grid_of(const HostArray& f) {
  return {f.shape()[1], f.shape()[2], f.shape()[3]};
}

// Flat index in f of where the population of velocity q of cell (i,j,k) ends up.
std::int64_t destination(const Step& step, const VelocitySet& s, const Grid& g, std::size_t q, std::int64_t i,
                         std::int64_t j, std::int64_t k) {
  if (step.streams) {
    i = wrapped(i + s.c[q][0], g.nx);
    j = wrapped(j + s.c[q][1], g.ny);
    k = wrapped(k + s.c[q][2], g.nz);
  }
  return ((static_cast<std::int64_t>(q) * g.nx + i) * g.ny + j) * g.nz + k;
}

std::string cell_text(std::int64_t i, std::int64_t j, std::int64_t k) {
  return fmt::format("cell ({},{},{})", i, j, k);
}

// Largest change of a moment of single cells; moment(q) gives its factors, at most three of them.
Check conserved(const Step& step, std::string name, std::string quantity,
                const std::function<std::array<double, 3>(std::size_t)>& factors) {
  return {std::move(name),
          CheckKind::invariant,
          std::move(quantity),
          "largest change over a cell / sum of its |populations|",
          2e-6,
          "collision conserves it; in float32 the sum of a cell's populations is good to some ten units of "
          "2^-24 and enters with the relaxation factor, below two",
          false,
          [=](const Judged& j) {
            const HostArray& in = find(j.problem.inputs, "f", "inputs");
            const HostArray& out = find(j.outputs, "f", "outputs");
            const VelocitySet& s = velocity_set(step.q);
            const Grid g = grid_of(in);
            const std::int64_t cells = g.nx * g.ny * g.nz;
            Measured worst;
            for (std::int64_t cell = 0; cell < cells; ++cell) {
              const std::int64_t a = cell / (g.ny * g.nz), b = cell / g.nz % g.ny, c = cell % g.nz;
              std::array<double, 3> change{};
              double scale = 0;
              for (std::size_t q = 0; q < s.c.size(); ++q) {
                const double before = in.value(static_cast<std::int64_t>(q) * cells + cell);
                const double after = out.value(destination(step, s, g, q, a, b, c));
                const std::array<double, 3> factor = factors(q);
                for (std::size_t d = 0; d < 3; ++d) change[d] += factor[d] * (after - before);
                scale += std::abs(before);
              }
              for (const double d : change) {
                const double e = std::abs(d) / scale;
                if (!(e <= worst.error)) {
                  worst = {e, fmt::format("{}: changed by {:.3g} of {:.6g}", cell_text(a, b, c), d, scale)};
                  if (!std::isfinite(e)) return worst;
                }
              }
            }
            return worst;
          }};
}

InputSet flow_set(const Step& step, std::string name, SetKind kind, Size size, Grid grid, FlowState state) {
  InputSet set;
  set.name = std::move(name);
  set.kind = kind;
  set.size = size;
  set.about =
      fmt::format("ABC flow, {} periods, Mach {}, density amplitude {}, non-equilibrium part {}, seed {}",
                  state.periods, state.mach, state.density_amplitude, state.non_equilibrium, state.seed);
  set.make = [=] { return flow_problem(step, grid, state); };
  return set;
}

}  // namespace

const VelocitySet& velocity_set(int q) {
  static const VelocitySet d3q19 = make_set(19, 1.0 / 3, 1.0 / 18, 1.0 / 36, 0);
  static const VelocitySet d3q27 = make_set(27, 8.0 / 27, 2.0 / 27, 1.0 / 54, 1.0 / 216);
  if (q != 19 && q != 27) throw Error(ExitCode::internal, fmt::format("no D3Q{} lattice", q));
  return q == 19 ? d3q19 : d3q27;
}

double equilibrium(const VelocitySet& s, std::size_t q, const Macroscopic& m) {
  const double cu = s.c[q][0] * m.u[0] + s.c[q][1] * m.u[1] + s.c[q][2] * m.u[2];
  const double uu = m.u[0] * m.u[0] + m.u[1] * m.u[1] + m.u[2] * m.u[2];
  return s.w[q] * m.density * (1 + 3 * cu + 4.5 * cu * cu - 1.5 * uu);
}

Problem problem_from(const Step& step, Grid g,
                     const std::function<Macroscopic(std::int64_t, std::int64_t, std::int64_t)>& state,
                     double non_equilibrium, std::uint64_t seed) {
  Problem p = make_problem(step.contract, {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  if (step.collides) {
    p.set_scalar("tau_plus", kTauPlus);
    p.set_scalar("magic", kMagic);
  }
  const VelocitySet& s = velocity_set(step.q);
  const auto f = p.inputs[0].as<float>();
  const std::int64_t cells = g.nx * g.ny * g.nz;
  parallel_for(g.nx * g.ny, [&](std::int64_t row) {
    std::vector<Macroscopic> line;
    for (std::int64_t k = 0; k < g.nz; ++k) line.push_back(state(row / g.ny, row % g.ny, k));
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      for (std::int64_t k = 0; k < g.nz; ++k) {
        const std::int64_t cell = row * g.nz + k;
        const double noise = non_equilibrium == 0
                                 ? 0.0
                                 : non_equilibrium * uniform11(seed, q, static_cast<std::uint64_t>(cell));
        f[static_cast<std::size_t>(static_cast<std::int64_t>(q) * cells + cell)] =
            static_cast<float>(equilibrium(s, q, line[static_cast<std::size_t>(k)]) * (1 + noise));
      }
    }
  });
  return p;
}

Problem flow_problem(const Step& step, Grid g, const FlowState& state) {
  // |u|_rms = sqrt(3) U and the speed of sound is 1/sqrt(3): U = Ma / 3.
  const AbcFlow flow =
      AbcFlow::periodic(state.mach / 3, state.periods,
                        {static_cast<double>(g.nx), static_cast<double>(g.ny), static_cast<double>(g.nz)});
  return problem_from(
      step, g,
      [&](std::int64_t i, std::int64_t j, std::int64_t k) {
        const auto x = static_cast<double>(i), y = static_cast<double>(j), z = static_cast<double>(k);
        const double wave = std::sin(flow.k[0] * x) * std::sin(flow.k[1] * y) * std::sin(flow.k[2] * z);
        return Macroscopic{1 + state.density_amplitude * wave, flow.at(x, y, z)};
      },
      state.non_equilibrium, state.seed);
}

std::vector<InputSet> flow_sets(const Step& step, Grid paper, double public_non_equilibrium,
                                double hidden_non_equilibrium) {
  const FlowState open{1, 4, 0.05, 0.05, public_non_equilibrium};
  const FlowState hidden{2, 3, 0.043, 0.06, hidden_non_equilibrium};
  // Smoke grids have three different extents, none a multiple of a block, so that swapped axes and last
  // partial blocks show.
  return {flow_set(step, "public", SetKind::open, Size::paper, paper, open),
          flow_set(step, "hidden", SetKind::hidden, Size::paper, paper, hidden),
          flow_set(step, "public_smoke", SetKind::open, Size::smoke, {30, 38, 46}, open),
          flow_set(step, "hidden_smoke", SetKind::hidden, Size::smoke, {38, 46, 30}, hidden)};
}

std::vector<InputSet> collision_hard_cases(const Step& step) {
  const std::vector<Check> conserve = conservation(step);
  const auto with = [](std::vector<Check> checks, Check one) {
    checks.push_back(std::move(one));
    return checks;
  };
  const FlowState flow{5, 2, 0.05, 0.05, 0.25};
  std::vector<InputSet> sets;
  sets.push_back(hard_case(
      "tau_near_half", "tau_plus = 1/2 + 1e-4: nearly no viscosity, tau_minus of 1875",
      [=] {
        Problem p = flow_problem(step, {18, 22, 26}, flow);
        p.set_scalar("tau_plus", 0.5001);
        return p;
      },
      conserve));
  sets.push_back(hard_case(
      "uniform_equilibrium", "density 1.3 and u = (0.08, -0.05, 0.03) everywhere: a steady state",
      [=] {
        return problem_from(step, {12, 15, 17}, [](auto, auto, auto) {
          return Macroscopic{1.3, {0.08, -0.05, 0.03}};
        });
      },
      with(conserve, unchanged())));
  sets.push_back(hard_case(
      "mach_03", "Mach 0.3: terms of second order in u are a tenth of the equilibrium",
      [=] {
        return flow_problem(step, {18, 22, 26}, {6, 2, 0.3, 0.05, 0.1});
      },
      conserve));
  sets.push_back(hard_case(
      "density_contrast", "densities of 1 and 1e-3 in random cells side by side",
      [=] {
        const Grid g{14, 17, 21};
        return problem_from(
            step, g,
            [=](std::int64_t i, std::int64_t j, std::int64_t k) {
              const auto item = static_cast<std::uint64_t>((i * g.ny + j) * g.nz + k);
              const double rho = random_bits(8, 50, item) & 1 ? 1.0 : 1e-3;
              return Macroscopic{rho,
                                 {0.05 * uniform11(8, 51, item), 0.05 * uniform11(8, 52, item),
                                  0.05 * uniform11(8, 53, item)}};
            },
            0.2, 8);
      },
      with(conserve, error_over_density(step))));
  sets.push_back(hard_case(
      "far_from_equilibrium", "populations of 0.05 to 1.95 times their equilibrium: some turn negative",
      [=] {
        return flow_problem(step, {18, 22, 26}, {9, 2, 0.05, 0.05, 0.95});
      },
      conserve));
  sets.push_back(hard_case(
      "faint", "densities of 1e-30: the step is of first degree in f, nothing may be flushed or overflow",
      [=] {
        return problem_from(
            step, {10, 13, 19},
            [](auto, auto, auto) {
              return Macroscopic{1e-30, {0.04, 0.03, -0.05}};
            },
            0.25, 10);
      },
      with(conserve, error_over_density(step))));
  // No extent need exceed the reach of a velocity; rows longer than a block of threads must work as well.
  for (const Grid grid : {Grid{1, 1, 1}, Grid{2, 2, 2}, Grid{1, 5, 33}, Grid{7, 1, 9}, Grid{2, 3, 1201}}) {
    sets.push_back(hard_case(
        fmt::format("grid_{}x{}x{}", grid.nx, grid.ny, grid.nz),
        "extents at and below the reach of a velocity, odd, or longer than a block of threads",
        [=] { return flow_problem(step, grid, flow); }, conserve));
  }
  return sets;
}

std::vector<Check> conservation(const Step& step) {
  const VelocitySet& s = velocity_set(step.q);
  return {conserved(step, "cell_mass", "sum of f over the populations of a cell",
                    [](std::size_t) {
                      return std::array<double, 3>{1, 0, 0};
                    }),
          conserved(step, "cell_momentum", "sum of c f over the populations of a cell", [&s](std::size_t q) {
            return std::array<double, 3>{static_cast<double>(s.c[q][0]), static_cast<double>(s.c[q][1]),
                                         static_cast<double>(s.c[q][2])};
          })};
}

Check unchanged() {
  return {"unchanged",
          CheckKind::invariant,
          "f",
          "largest change / population",
          2e-6,
          "a uniform equilibrium is a fixed point; its float32 moments are good to some ten units of 2^-24 "
          "and enter with relaxation factors below two",
          false,
          [](const Judged& j) {
            const HostArray& in = find(j.problem.inputs, "f", "inputs");
            const HostArray& out = find(j.outputs, "f", "outputs");
            Measured worst;
            for (std::int64_t i = 0; i < in.size(); ++i) {
              const double e = std::abs(out.value(i) - in.value(i)) / std::abs(in.value(i));
              if (!(e <= worst.error)) {
                worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(out, i), out.value(i),
                                        in.value(i))};
                if (!std::isfinite(e)) return worst;
              }
            }
            return worst;
          }};
}

Check error_over_density(const Step& step) {
  return {
      "error_over_density",
      CheckKind::invariant,
      "f",
      "largest error / density of the cell that the population comes from",
      1e-6,
      "collision is local and of first degree in f: rounding scales with the cell's own density, about 1e-7",
      true,
      [=](const Judged& j) {
        const HostArray& in = find(j.problem.inputs, "f", "inputs");
        const HostArray& out = find(j.outputs, "f", "outputs");
        const HostArray& truth = find(*j.truth, "f", "truth");
        const VelocitySet& s = velocity_set(step.q);
        const Grid g = grid_of(in);
        const std::int64_t cells = g.nx * g.ny * g.nz;
        Measured worst;
        for (std::int64_t cell = 0; cell < cells; ++cell) {
          const std::int64_t a = cell / (g.ny * g.nz), b = cell / g.nz % g.ny, c = cell % g.nz;
          double density = 0;
          for (std::size_t q = 0; q < s.c.size(); ++q)
            density += in.value(static_cast<std::int64_t>(q) * cells + cell);
          for (std::size_t q = 0; q < s.c.size(); ++q) {
            const std::int64_t at = destination(step, s, g, q, a, b, c);
            const double e = std::abs(out.value(at) - truth.value(at)) / density;
            if (!(e <= worst.error)) {
              worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(out, at), out.value(at),
                                      truth.value(at))};
              if (!std::isfinite(e)) return worst;
            }
          }
        }
        return worst;
      }};
}

}  // namespace gpuphys::lattice
