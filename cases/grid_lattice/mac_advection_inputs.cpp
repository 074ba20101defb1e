#include "cases/grid_lattice/mac_advection_inputs.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "cases/grid_lattice/mac_advection.hpp"
#include "core/generators/fourier_velocity.hpp"
#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::mac_advection {
namespace {

constexpr double kDx = 0x1p-8, kDt = 0x1p-7;
constexpr int kMaxWaveNumber = 3;
const std::array<std::string, 3> kNames{"ux", "uy", "uz"};

Problem empty_problem(Grid grid) {
  Problem p = make_problem(contract(), {{"nx", grid.nx}, {"ny", grid.ny}, {"nz", grid.nz}});
  p.set_scalar("dx", kDx);
  p.set_scalar("dt", kDt);
  return p;
}

// `rms` in cells per step is rms * dt / dx.
Problem fourier_problem(Grid grid, std::uint64_t seed, int modes, double rms, double period) {
  Problem p = empty_problem(grid);
  const FourierVelocity field = FourierVelocity::random(seed, modes, kMaxWaveNumber, rms, period);
  for (int c = 0; c < 3; ++c) field.fill(c, kDx, p.inputs[static_cast<std::size_t>(c)]);
  return p;
}

InputSet fourier_set(std::string name, SetKind kind, Size size, Grid grid, std::uint64_t seed, int modes,
                     double period) {
  InputSet set;
  set.name = std::move(name);
  set.kind = kind;
  set.size = size;
  set.about = fmt::format("{} random Fourier modes up to wave number {}, rms 1 m/s (2 cells a step), seed {}",
                          modes, kMaxWaveNumber, seed);
  set.make = [=] { return fourier_problem(grid, seed, modes, 1.0, period); };
  return set;
}

// The largest error of all outputs, `error` giving that of element i of `out` against element i of its
// counterpart in `expected`.
template <class Error>
Measured worst_of(const Judged& j, const Arrays& expected, Error&& error) {
  Measured worst;
  for (const std::string& name : kNames) {
    const HostArray& out = find(j.outputs, name, "outputs");
    const HostArray& other = find(expected, name, "expected values");
    for (std::int64_t i = 0; i < out.size(); ++i) {
      const double e = error(out.value(i), other.value(i));
      if (!(e <= worst.error)) {  // true for NaN as well
        worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(out, i), out.value(i),
                                other.value(i))};
        if (!std::isfinite(e)) return worst;
      }
    }
  }
  return worst;
}

double largest_speed(const Problem& p) {
  double largest = 0;
  for (const HostArray& u : p.inputs) {
    for (std::int64_t i = 0; i < u.size(); ++i) largest = std::max(largest, std::abs(u.value(i)));
  }
  return largest;
}

// Largest violation of min(u_c) <= u'_c <= max(u_c), relative to max |u_c|: an interpolated value is a convex
// combination.
Check maximum_principle() {
  const std::string why =
      "every output is a convex combination of inputs; rounding of the three nested interpolations may "
      "exceed the hull by a "
      "few units in the last place (2^-24 each)";
  return {
      "maximum_principle",
      CheckKind::invariant,
      "ux, uy, uz",
      "largest excursion beyond the input's range / max |u|",
      8 * 0x1p-24,
      why,
      false,
      [](const Judged& j) {
        Measured worst;
        for (const std::string& name : kNames) {
          const HostArray& in = find(j.problem.inputs, name, "inputs");
          const HostArray& out = find(j.outputs, name, "outputs");
          double low = in.value(0), high = low;
          for (std::int64_t i = 0; i < in.size(); ++i) {
            low = std::min(low, in.value(i));
            high = std::max(high, in.value(i));
          }
          const double scale = std::max({std::abs(low), std::abs(high), std::numeric_limits<double>::min()});
          for (std::int64_t i = 0; i < out.size(); ++i) {
            const double e = std::max(low - out.value(i), out.value(i) - high) / scale;
            if (!(e <= worst.error)) {
              worst = {e, fmt::format("{} = {:.9g}, input range [{:.9g}, {:.9g}]", index_text(out, i),
                                      out.value(i), low, high)};
              if (!std::isfinite(e)) return worst;
            }
          }
        }
        return worst;
      }};
}

// For fields that advection must leave alone.
Check unchanged() {
  return {"unchanged",
          CheckKind::invariant,
          "ux, uy, uz",
          "largest change / max |u|",
          8 * 0x1p-24,
          "a parallel shear flow is carried along itself: all eight samples around a point hold the same "
          "number, and "
          "weights that sum to 1 within the rounding of three nested interpolations give it back",
          false,
          [](const Judged& j) {
            const double largest = largest_speed(j.problem), scale = largest == 0 ? 1 : largest;
            return worst_of(j, j.problem.inputs,
                            [=](double got, double expected) { return std::abs(got - expected) / scale; });
          }};
}

// Largest difference of neighbouring samples of any component: how much a point misplaced by one cell can
// change a value.
double largest_step(const Problem& p) {
  double largest = 0;
  for (const HostArray& u : p.inputs) {
    const Shape& n = u.shape();
    const std::array<std::int64_t, 3> stride{n[1] * n[2], n[2], 1};
    for (std::int64_t i = 0; i < u.size(); ++i) {
      const std::array<std::int64_t, 3> at{i / stride[0], i / stride[1] % n[1], i % n[2]};
      for (std::size_t d = 0; d < 3; ++d) {
        if (at[d] + 1 < n[d]) largest = std::max(largest, std::abs(u.value(i + stride[d]) - u.value(i)));
      }
    }
  }
  return largest;
}

// At high CFL numbers a float32 displacement itself is coarse; the bound follows from the data instead of
// from the paper: unit roundoff x largest displacement in cells x largest step between neighbouring samples.
double displacement_unit(const Problem& p) {
  return 0x1p-24 * largest_speed(p) * p.scalar("dt") / p.scalar("dx") * largest_step(p);
}

// Per evaluation and axis: rounding of the velocity's displacement, of the position in the cell and of the
// interpolation, half a unit each; three axes make 4.5. Doubled, because the error of an early stage moves
// the later ones.
double displacement_units(const Scheme& scheme) {
  return 8.0 * scheme.velocity_evaluations;
}

Check displacement_limited(const Scheme& scheme) {
  if (!scheme.limited) {
    return {"displacement_limited",
            CheckKind::invariant,
            "ux, uy, uz",
            "largest error / (unit roundoff x largest displacement in cells x largest step between "
            "neighbouring samples)",
            displacement_units(scheme),
            "first-order propagation of the rounding of each displacement through a field this steep",
            true,
            [](const Judged& j) {
              const double unit = displacement_unit(j.problem);
              return worst_of(j, *j.truth,
                              [=](double got, double truth) { return std::abs(got - truth) / unit; });
            }};
  }
  return {
      "displacement_limited",
      CheckKind::invariant,
      "ux, uy, uz",
      "share of faces whose error exceeds what rounding the displacements explains",
      1e-3,
      "a departure point within 2e-6 of a cell of a plane of samples may be limited by the samples on the "
      "other side of it: six planes a cell, and room for the displacements' own propagation",
      true,
      [scheme](const Judged& j) {
        const double bound = displacement_units(scheme) * displacement_unit(j.problem);
        double off = 0, all = 0;
        Measured worst = worst_of(j, *j.truth, [&](double got, double truth) {
          const double e = std::abs(got - truth);
          off += !(e <= bound);
          ++all;
          return e;
        });
        if (std::isfinite(worst.error)) worst.error = off / all;
        return worst;
      }};
}

Problem with_step(Problem p, double dt, double dx) {
  p.set_scalar("dt", dt);
  p.set_scalar("dx", dx);
  return p;
}

struct Steps {
  const char* name;
  Grid grid;
  double dt, dx;
};

std::vector<InputSet> hard_cases(const Scheme& scheme) {
  std::vector<InputSet> sets;
  sets.push_back(hard_case(
      "zero_velocity", "a fluid at rest stays at rest",
      [] {
        return empty_problem({16, 12, 20});
      },
      {unchanged()}, true));
  sets.push_back(hard_case(
      "parallel_shear_cfl60", "u = (0, 0, w(x, y)) with random w up to 60 cells a step: a steady solution",
      [] {
        return problem_from({12, 16, 20}, [](int c, std::int64_t i, std::int64_t j, std::int64_t) {
          return c == 2 ? 30.0 * uniform11(11, 0, static_cast<std::uint64_t>(i * 16 + j)) : 0.0;
        });
      },
      {unchanged()}, true));
  sets.push_back(hard_case(
      "cfl60",
      "the Fourier field at 60 cells rms a step: most points leave the box; bounded by the input's range",
      [] {
        return fourier_problem({40, 48, 32}, 7, 16, 30.0, 128 * kDx);
      },
      {maximum_principle(), displacement_limited(scheme)}, false));
  sets.push_back(hard_case(
      "outflow_walls",
      "a flow leaving through all six walls at up to 12 cells a step: the clamp at every face and corner",
      [] {
        return problem_from({24, 20, 28}, [](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
          const std::array<double, 3> half{12, 10, 14};
          const std::array<double, 3> at{static_cast<double>(i), static_cast<double>(j),
                                         static_cast<double>(k)};
          const auto d = static_cast<std::size_t>(c);
          const auto e = (d + 1) % 3;
          const double along = at[d] / half[d] - 1, across = at[e] / half[e] - 1;
          return -6.0 * along * (1 - 0.25 * across * across);  // back-traced points leave the box
        });
      },
      {maximum_principle()}, true));
  sets.push_back(hard_case(
      "huge_velocity", "random velocities of 1e10 m/s: back-traced points far beyond any integer cell index",
      [] {
        return problem_from({9, 8, 10}, [](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
          return 1e10 * uniform11(13, static_cast<std::uint64_t>(c),
                                  static_cast<std::uint64_t>((i * 64 + j) * 64 + k));
        });
      },
      {maximum_principle()}, true));
  sets.push_back(hard_case(
      "denormal", "velocities of 1e-40 m/s: below the normal range, must not be flushed to zero",
      [] {
        return problem_from({8, 10, 9}, [](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
          return 1e-40 * uniform11(17, static_cast<std::uint64_t>(c),
                                   static_cast<std::uint64_t>((i * 64 + j) * 64 + k));
        });
      },
      {{"denormal_units", CheckKind::invariant, "ux, uy, uz",
        "largest error in units of the smallest denormal", 8,
        "no displacement to speak of: only the rounding of three nested interpolations, one unit each, "
        "remains",
        true,
        [](const Judged& j) {
          return worst_of(j, *j.truth,
                          [](double got, double truth) { return std::abs(got - truth) / 0x1p-149; });
        }}},
      false));
  // Other steps and cells: nothing may rely on dt / dx = 2.
  for (const Steps& s :
       {Steps{"other_step_a", {13, 18, 11}, 0.013, 0.0371}, Steps{"other_step_b", {17, 9, 21}, 0.75, 0.31},
        Steps{"no_step", {6, 9, 7}, 0.0, 0.5}}) {
    sets.push_back(hard_case(
        s.name, fmt::format("the Fourier field with dt = {}, dx = {}", s.dt, s.dx),
        [s] { return with_step(fourier_problem(s.grid, 23, 16, 1.0, 64 * kDx), s.dt, s.dx); },
        {maximum_principle()}, true));
  }
  // Points exactly on planes of samples along one axis, of both signs of zero, while the others are rough.
  for (const int still : {0, 2}) {
    sets.push_back(hard_case(
        still == 0 ? "no_x_velocity" : "no_z_velocity",
        "one component is zero, of either sign: points lie exactly on planes of samples along its axis",
        [still] {
          return problem_from({11, 14, 13}, [still](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
            const auto item = static_cast<std::uint64_t>((i * 64 + j) * 64 + k);
            if (c == still) return item % 3 == 0 ? -0.0 : 0.0;
            return 0.3 * uniform11(29, static_cast<std::uint64_t>(c), item);
          });
        },
        {maximum_principle()}, true));
  }
  sets.push_back(hard_case(
      "end_of_range",
      "random velocities up to 5e37 m/s: differences and sums of a few are float32 numbers just so",
      [] {
        return with_step(problem_from({9, 7, 10},
                                      [](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
                                        const auto item = static_cast<std::uint64_t>((i * 64 + j) * 64 + k);
                                        const double u = uniform11(31, static_cast<std::uint64_t>(c), item);
                                        return item % 5 == 0 ? std::copysign(5e37, u) : 5e37 * u;
                                      }),
                         2.5e-38, 1.0);
      },
      {maximum_principle()}, !scheme.limited));
  for (const Grid grid : {Grid{65537, 1, 2}, Grid{1, 65538, 1}, Grid{2, 1, 65539}}) {
    sets.push_back(hard_case(
        fmt::format("grid_{}x{}x{}", grid.nx, grid.ny, grid.nz),
        "more cells along an axis than 16 bits count",
        [grid] { return fourier_problem(grid, 37, 16, 1.0, 128 * kDx); }, {maximum_principle()}, true));
  }
  for (const Grid grid : {Grid{1, 1, 1}, Grid{2, 2, 2}, Grid{3, 5, 7}, Grid{65, 1, 33}}) {
    sets.push_back(hard_case(
        fmt::format("grid_{}x{}x{}", grid.nx, grid.ny, grid.nz),
        "a grid smaller than any tile, with as few as one sample an axis",
        [grid] { return fourier_problem(grid, 19, 16, 1.0, 128 * kDx); }, {maximum_principle()}, true));
  }
  return sets;
}

// A linear velocity field u = A (x - centre) on a cube of `n` cells with |dt A| small enough that interior
// points stay inside, and the check that interior faces equal A P(-dt A)(x - centre), where P(z) = sum_s
// coefficients[s] z^s.
InputSet linear_field_set(std::int64_t n, std::vector<double> coefficients) {
  using Matrix = std::array<std::array<double, 3>, 3>;
  // Per second; dt A has norm of about 0.15, so that points well inside stay inside. Multiples of 2^-4: exact
  // in float32.
  static constexpr Matrix a{{{4.0, -9.5, 3.0}, {8.0, -6.0, 5.5}, {-2.5, 7.0, 2.0}}};
  const auto position = [n](int c, std::array<std::int64_t, 3> at) {
    std::array<double, 3> x;
    for (std::size_t d = 0; d < 3; ++d) {
      x[d] = (static_cast<double>(at[d]) + (static_cast<int>(d) == c ? 0.0 : 0.5) -
              0.5 * static_cast<double>(n)) *
             kDx;
    }
    return x;
  };
  const auto times = [](const std::array<double, 3>& x) {
    std::array<double, 3> y{};
    for (std::size_t r = 0; r < 3; ++r) {
      for (std::size_t s = 0; s < 3; ++s) y[r] += a[r][s] * x[s];
    }
    return y;
  };
  InputSet set = hard_case(
      "linear_field", "u = A x: trilinear interpolation is exact, so the interior must equal A P(-dt A) x",
      [=] {
        return problem_from({n, n, n}, [=](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
          return times(position(c, {i, j, k}))[static_cast<std::size_t>(c)];
        });
      },
      {}, true);
  set.invariants.push_back(
      {"linear_identity", CheckKind::invariant, "ux, uy, uz (interior half of the box)",
       "largest error / largest |u|", 5e-7,
       "rounding of the input field to float32 (2^-24 relative) and of the trace, with the margin of a few "
       "operations",
       false, [=](const Judged& j) {
         Measured worst;
         const double scale = largest_speed(j.problem);
         for (int c = 0; c < 3; ++c) {
           const HostArray& out = j.outputs[static_cast<std::size_t>(c)];
           const Shape& s = out.shape();
           for (std::int64_t i = 0; i < out.size(); ++i) {
             const std::array<std::int64_t, 3> at{i / (s[1] * s[2]), i / s[2] % s[1], i % s[2]};
             bool inside = true;
             for (const std::int64_t index : at) inside = inside && index >= n / 4 && index < n - n / 4;
             if (!inside) continue;
             // A P(-dt A) x by Horner's rule.
             std::array<double, 3> p{};
             const std::array<double, 3> x = position(c, at);
             for (std::size_t k = coefficients.size(); k-- > 0;) {
               const std::array<double, 3> ap = times(p);
               for (std::size_t d = 0; d < 3; ++d) p[d] = coefficients[k] * x[d] - kDt * ap[d];
             }
             const double expected = times(p)[static_cast<std::size_t>(c)];
             const double e = std::abs(out.value(i) - expected) / scale;
             if (!(e <= worst.error)) {
               worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(out, i), out.value(i),
                                       expected)};
               if (!std::isfinite(e)) return worst;
             }
           }
         }
         return worst;
       }});
  return set;
}

}  // namespace

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

Problem problem_from(Grid grid,
                     const std::function<double(int, std::int64_t, std::int64_t, std::int64_t)>& value) {
  Problem p = empty_problem(grid);
  for (int c = 0; c < 3; ++c) {
    HostArray& u = p.inputs[static_cast<std::size_t>(c)];
    const Shape n = u.shape();
    const auto out = u.as<float>();
    for (std::int64_t i = 0; i < u.size(); ++i) {
      out[static_cast<std::size_t>(i)] =
          static_cast<float>(value(c, i / (n[1] * n[2]), i / n[2] % n[1], i % n[2]));
    }
  }
  return p;
}

std::vector<InputSet> input_sets(const Scheme& scheme) {
  // Smoke grids have three different extents, none a multiple of a tile, so that swapped axes and last
  // partial blocks show. Their field is a part of a period of 128 cells: twice as rough per cell as the
  // paper's.
  std::vector<InputSet> sets;
  sets.push_back(fourier_set("public", SetKind::open, Size::paper, {256, 256, 256}, 1, 16, 256 * kDx));
  sets.push_back(fourier_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, 2, 20, 256 * kDx));
  sets.push_back(fourier_set("public_smoke", SetKind::open, Size::smoke, {44, 37, 50}, 1, 16, 128 * kDx));
  sets.push_back(fourier_set("hidden_smoke", SetKind::hidden, Size::smoke, {37, 50, 44}, 2, 20, 128 * kDx));
  for (InputSet& set : hard_cases(scheme)) sets.push_back(std::move(set));
  sets.push_back(linear_field_set(32, scheme.polynomial));
  return sets;
}

Task family_task(const std::string& name, int paper_number, const Scheme& scheme) {
  Task task;
  task.name = name;
  task.paper_number = paper_number;
  task.contract = contract();
  task.sets = input_sets(scheme);
  return task;
}

Task semi_lagrangian_task(const std::string& name, int paper_number, const Scheme& scheme) {
  Task task = family_task(name, paper_number, scheme);
  for (const std::string& u : kNames) {
    task.checks.push_back(relative_l2_check(u, 1e-6, "the paper's table of inputs and checks"));
    task.checks.push_back(
        local_error_check(u, 5e-6,
                          "float32 displacements of up to 10 cells are good to 1e-6 cells and neighbouring "
                          "samples differ by up "
                          "to half an rms "
                          "velocity: ten times that, and below any face that uses another scheme or sample"));
  }
  return task;
}

}  // namespace gpuphys::mac_advection
