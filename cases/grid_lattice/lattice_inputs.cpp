#include "cases/grid_lattice/lattice_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/base/error.hpp"
#include "core/base/parallel.hpp"
#include "core/generators/abc_flow.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"
#include "core/judge/comparators.hpp"

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

// Extents at and below the reach of a velocity, odd ones, rows longer than a block of threads, rows of 16 mod
// 32 and of other multiples of four, and more cells along an axis than 16 bits count.
constexpr Grid kOddGrids[] = {{1, 1, 1},    {2, 2, 2},     {1, 5, 33},    {7, 1, 9},
                              {2, 3, 1201}, {3, 2, 16},    {2, 5, 20},    {5, 3, 48},
                              {3, 4, 80},   {70000, 1, 2}, {1, 70001, 1}, {1, 2, 65540}};

std::int64_t wrapped(std::int64_t index, std::int64_t n) {
  return ((index % n) + n) % n;
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

std::string compared(const HostArray& out, std::int64_t at, double expected) {
  return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(out, at), out.value(at), expected);
}

// Keeps the largest error seen; the first that is not finite stays.
template <class Text>
void raise(Measured& worst, double error, const Text& text) {
  if (std::isfinite(worst.error) && !(error <= worst.error)) worst = {error, text()};
}

// The worst of all cells. visit(cell, to, worst) sees the flat index of a cell and where each of its
// populations ends up, and raises `worst`.
template <class Visit>
Measured worst_cell(const Step& step, const HostArray& in, const Visit& visit) {
  const VelocitySet& s = velocity_set(step.q);
  const Grid g{in.shape()[1], in.shape()[2], in.shape()[3]};
  std::vector<std::int64_t> to(s.c.size());
  Measured worst;
  for (std::int64_t cell = 0; cell < g.nx * g.ny * g.nz && std::isfinite(worst.error); ++cell) {
    for (std::size_t q = 0; q < to.size(); ++q)
      to[q] = destination(step, s, g, q, cell / (g.ny * g.nz), cell / g.nz % g.ny, cell % g.nz);
    visit(cell, to, worst);
  }
  return worst;
}

// Largest change of a moment of single cells; factors(q) are those of the populations in it, at most three
// moments.
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
            const std::int64_t cells = in.size() / step.q;
            return worst_cell(step, in, [&](std::int64_t cell, const auto& to, Measured& worst) {
              std::array<double, 3> change{};
              double scale = 0;
              for (std::size_t q = 0; q < to.size(); ++q) {
                const double before = in.value(static_cast<std::int64_t>(q) * cells + cell);
                const std::array<double, 3> factor = factors(q);
                for (std::size_t d = 0; d < 3; ++d) change[d] += factor[d] * (out.value(to[q]) - before);
                scale += std::abs(before);
              }
              for (const double d : change) {
                raise(worst, std::abs(d) / scale, [&] {
                  return fmt::format("the cell of {}: changed by {:.3g} of {:.6g}", index_text(in, cell), d,
                                     scale);
                });
              }
            });
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

Task step_task(const Step& step, std::string name, int paper_number, std::string title, Grid paper,
               double public_non_equilibrium, double hidden_non_equilibrium) {
  Task task;
  task.name = std::move(name);
  task.title = std::move(title);
  task.paper_number = paper_number;
  task.contract = step.contract;
  task.sets = flow_sets(step, paper, public_non_equilibrium, hidden_non_equilibrium);
  for (InputSet& set : step.collides ? collision_hard_cases(step) : streaming_hard_cases(step))
    task.sets.push_back(std::move(set));
  const std::string paper_table = "the paper's table of inputs and checks";
  if (step.collides) {
    task.checks = {
        relative_l2_check("f", 5e-6, paper_table),
        local_error_check(
            "f", 1e-5,
            "the rest population is four times the rms, so one float32 unit of it is 3.5e-7 of the rms, and "
            "the density enters it with the rounding of a sum of all populations: room for thirty units, and "
            "a thousand times below a population from a wrong cell")};
  } else {
    task.checks = {relative_l2_check("f", 1e-9, paper_table + "; a copy has no error at all"),
                   local_error_check("f", 1e-9,
                                     "a copy has no error, and two float32 numbers that differ do so by more "
                                     "than this unless both are below a hundredth of the rms")};
  }
  return task;
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
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, std::function<Problem()> make,
                       std::vector<Check> also = {}) {
    const std::vector<Check> conserve = conservation(step);
    also.insert(also.begin(), conserve.begin(), conserve.end());
    also.push_back(
        as_invariant(relative_l2_check("f", 0, ""), "f_rel_l2_tight", 6e-7,
                     "no cell loses more than its own rounding: the FP32 baseline stays below 1.8e-7"));
    sets.push_back(hard_case(stress, about, std::move(make), std::move(also)));
  };
  const auto add_flow = [&](const std::string& stress, const std::string& about, FlowState state,
                            double tau_plus = kTauPlus, double magic = kMagic) {
    add(stress, about, [=] {
      Problem p = flow_problem(step, {18, 22, 26}, state);
      p.set_scalar("tau_plus", tau_plus);
      p.set_scalar("magic", magic);
      return p;
    });
  };
  const FlowState flow{5, 2, 0.05, 0.05, 0.25};
  add_flow("tau_near_half", "tau_plus = 1/2 + 1e-4: nearly no viscosity, tau_minus of 1875", flow, 0.5001);
  add_flow("magic_quarter", "magic = 1/4, the choice for stability, at tau_plus = 0.8",
           {12, 2, 0.05, 0.05, 0.3}, 0.8, 0.25);
  add_flow("magic_twelfth", "magic = 1/12 at tau_plus = 1.7", {13, 3, 0.06, 0.04, 0.3}, 1.7, 1.0 / 12);
  add_flow("tau_one", "tau_plus = 1: the even part falls to its equilibrium at once",
           {14, 2, 0.05, 0.05, 0.3}, 1.0, 0.1);
  add("exact_zeros", "populations of exactly zero, of either sign, in most cells", [=] {
    Problem p = flow_problem(step, {9, 10, 22}, {15, 2, 0.05, 0.05, 0.2});
    std::uint64_t item = 0;
    for (float& f : p.inputs[0].as<float>()) {
      const std::uint64_t which = random_bits(15, 60, item++) % 16;
      if (which < 2) f = which == 0 ? 0.0f : -0.0f;
    }
    return p;
  });
  add("uniform_equilibrium", "density 1.3 and u = (0.08, -0.05, 0.03) everywhere: a steady state",
      [=] {
        return problem_from(step, {12, 15, 17}, [](auto, auto, auto) {
          return Macroscopic{1.3, {0.08, -0.05, 0.03}};
        });
      },
      {unchanged()});
  add_flow("mach_03", "Mach 0.3: terms of second order in u are a tenth of the equilibrium",
           {6, 2, 0.3, 0.05, 0.1});
  add("density_contrast", "densities of 1 and 1e-3 in random cells side by side",
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
      {error_over_density(step)});
  add_flow("far_from_equilibrium", "populations of 0.05 to 1.95 times their equilibrium: some turn negative",
           {9, 2, 0.05, 0.05, 0.95});
  add("faint", "densities of 1e-30: the step is of first degree in f, nothing may be flushed or overflow",
      [=] {
        return problem_from(
            step, {10, 13, 19},
            [](auto, auto, auto) {
              return Macroscopic{1e-30, {0.04, 0.03, -0.05}};
            },
            0.25, 10);
      },
      {error_over_density(step)});
  // No extent need exceed the reach of a velocity; rows longer than a block of threads must work as well.
  for (const Grid g : kOddGrids) {
    add(fmt::format("grid_{}x{}x{}", g.nx, g.ny, g.nz),
        "extents at and below the reach of a velocity, odd, or longer than a block of threads",
        [=] { return flow_problem(step, g, flow); });
  }
  return sets;
}

std::vector<InputSet> streaming_hard_cases(const Step& step) {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, std::function<Problem()> make) {
    sets.push_back(hard_case(stress, about, std::move(make), {moved_bitwise(step)}));
  };
  // Populations that value(item) gives for their flat index.
  const auto add_values = [&](const std::string& stress, const std::string& about, Grid g,
                              std::function<float(std::uint64_t)> value) {
    add(stress, about, [=] {
      Problem p = make_problem(step.contract, {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
      std::uint64_t item = 0;
      for (float& f : p.inputs[0].as<float>()) f = value(item++);
      return p;
    });
  };
  add_values("own_number", "every population is its own flat index: none can pass for another", {5, 6, 64},
             [](std::uint64_t item) { return static_cast<float>(item); });
  add_values("any_value", "zeros of both signs, denormals, 1e38 and random values, which are only copied",
             {6, 7, 36}, [](std::uint64_t item) {
               constexpr float kValues[] = {0.0f, -0.0f, 1e-45f, -1e-40f, 1e38f, -3e38f, 1.17549435e-38f};
               const std::uint64_t which = random_bits(11, 50, item) % 10;
               return which < std::size(kValues) ? kValues[which]
                                                 : static_cast<float>(uniform11(11, 51, item));
             });
  std::vector<Grid> grids(std::begin(kOddGrids), std::end(kOddGrids));
  // Rows of whole 16-byte pieces as well, of one piece and of more than a block of threads reads at once.
  for (const Grid g : {Grid{3, 7, 44}, Grid{5, 3, 4}, Grid{1, 2, 4804}}) grids.push_back(g);
  for (const Grid g : grids) {
    add(fmt::format("grid_{}x{}x{}", g.nx, g.ny, g.nz),
        "extents at and below the reach of a velocity, odd, of a few 16-byte pieces, or longer than a block "
        "of threads",
        [=] {
          return flow_problem(step, g, {5, 2, 0.05, 0.05, 0.25});
        });
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
              raise(worst, std::abs(out.value(i) - in.value(i)) / std::abs(in.value(i)),
                    [&] { return compared(out, i, in.value(i)); });
            }
            return worst;
          }};
}

Check moved_bitwise(const Step& step) {
  return {"moved_bitwise",
          CheckKind::invariant,
          "f",
          "number of populations that are not bitwise where their velocity leads",
          0,
          "streaming copies: nothing is rounded, flushed or lost",
          false,
          [=](const Judged& j) {
            const HostArray& in = find(j.problem.inputs, "f", "inputs");
            const HostArray& out = find(j.outputs, "f", "outputs");
            const std::int64_t cells = in.size() / step.q;
            double count = 0;
            return worst_cell(step, in, [&](std::int64_t cell, const auto& to, Measured& worst) {
              for (std::size_t q = 0; q < to.size(); ++q) {
                const double before = in.value(static_cast<std::int64_t>(q) * cells + cell);
                const double after = out.value(to[q]);
                if (after == before && std::signbit(after) == std::signbit(before)) continue;
                raise(worst, ++count, [&] { return compared(out, to[q], before); });
              }
            });
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
        const std::int64_t cells = in.size() / step.q;
        return worst_cell(step, in, [&](std::int64_t cell, const auto& to, Measured& worst) {
          double density = 0;
          for (std::int64_t q = 0; q < step.q; ++q) density += in.value(q * cells + cell);
          for (const std::int64_t at : to) {
            raise(worst, std::abs(out.value(at) - truth.value(at)) / density,
                  [&] { return compared(out, at, truth.value(at)); });
          }
        });
      }};
}

}  // namespace gpuphys::lattice
