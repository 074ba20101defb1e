#include "cases/global_solve/newton_checks.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace gpuphys::newton {
namespace {

std::vector<double> values_of(const HostArray& a) {
  std::vector<double> v(static_cast<std::size_t>(a.size()));
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = a.value(static_cast<std::int64_t>(i));
  return v;
}

// y = x + dt v.
std::vector<double> inertial(const Problem& p) {
  std::vector<double> y = values_of(find(p.inputs, "x", "inputs"));
  const HostArray& v = find(p.inputs, "v", "inputs");
  for (std::size_t c = 0; c < y.size(); ++c) y[c] += p.scalar("dt") * v.value(static_cast<std::int64_t>(c));
  return y;
}

// M (z - y) + dt^2 grad E(z).
std::vector<double> gradient(const Elastic& elastic, const Problem& p, const std::vector<double>& z) {
  std::vector<double> g(z.size(), 0.0);
  elastic.add_gradient(p, z, g);
  const std::vector<double> y = inertial(p);
  const HostArray& mass = find(p.inputs, "mass", "inputs");
  const double dt = p.scalar("dt");
  for (std::size_t c = 0; c < z.size(); ++c)
    g[c] = mass.value(static_cast<std::int64_t>(c / 3)) * (z[c] - y[c]) + dt * dt * g[c];
  return g;
}

double norm(const std::vector<double>& a) {
  double sum = 0;
  for (const double v : a) sum += v * v;
  return std::sqrt(sum);
}

double energy(const Elastic& elastic, const Problem& p, const std::vector<double>& z) {
  const std::vector<double> y = inertial(p);
  const HostArray& mass = find(p.inputs, "mass", "inputs");
  const double dt = p.scalar("dt");
  double sum = dt * dt * elastic.energy(p, z);
  for (std::size_t c = 0; c < z.size(); ++c)
    sum += 0.5 * mass.value(static_cast<std::int64_t>(c / 3)) * (z[c] - y[c]) * (z[c] - y[c]);
  return sum;
}

double unit(double value) {
  return std::ldexp(1.0, std::ilogb(std::max(std::abs(value), 0x1p-120)) - 23);
}

Items one(double value) {
  return {1, [value](std::int64_t) { return value; }};
}

}  // namespace

Check residual_check(const Elastic& elastic, double slack) {
  return worst_over(
      {.name = "residual",
       .kind = CheckKind::paper,
       .array = "x_new",
       .quantity = fmt::format("|g(x_new)| / |g(y)| in FP64, times (1e-3 + {0:g}) / (tol + {0:g})", slack),
       .tolerance = 1e-3 + slack,
       .why = "the paper's table of inputs and checks, where tol = 1e-3: what is above it is for the "
              "rounding of x_new",
       .needs_truth = false},
      [elastic, slack](const Judged& j) {
        const double before = norm(gradient(elastic, j.problem, inertial(j.problem)));
        const double after = norm(gradient(elastic, j.problem, values_of(output(j, "x_new"))));
        return one(before > 0 ? after / before * (1e-3 + slack) / (j.problem.scalar("tol") + slack) : after);
      });
}

Check local_residual_check(const Elastic& elastic, double tolerance, const std::string& why) {
  return worst_over({.name = "residual_local",
                     .array = "x_new",
                     .quantity = "entries of g(x_new) over the rms of g(y), times 1e-3 / tol",
                     .tolerance = tolerance,
                     .why = why,
                     .needs_truth = false},
                    [elastic](const Judged& j) {
                      const double before = norm(gradient(elastic, j.problem, inertial(j.problem)));
                      std::vector<double> g = gradient(elastic, j.problem, values_of(output(j, "x_new")));
                      const double rms = before > 0 ? before / std::sqrt(static_cast<double>(g.size())) *
                                                          (j.problem.scalar("tol") / 1e-3)
                                                    : 1;
                      const auto count = static_cast<std::int64_t>(g.size());
                      return Items{count, [g = std::move(g), rms](std::int64_t c) {
                                     return g[static_cast<std::size_t>(c)] / rms;
                                   }};
                    });
}

Check energy_check(const Elastic& elastic) {
  return worst_over(
      {.name = "energy_falls",
       .array = "x_new",
       .quantity = "how far |z - y|^2_M / 2 + dt^2 E(z) is higher at x_new than at y, over that",
       .tolerance = 1e-6,
       .why = "Newton's method with a line search lowers it; rounding of x_new is worth 1e-7",
       .needs_truth = false},
      [elastic](const Judged& j) {
        const double before = energy(elastic, j.problem, inertial(j.problem));
        const double after = energy(elastic, j.problem, values_of(output(j, "x_new")));
        if (!std::isfinite(after)) return one(after);
        return one(before > 0 ? std::max(0.0, after / before - 1) : after);
      });
}

Check velocity_check(double tolerance) {
  return worst_over({.name = "v_new_rel_l2",
                     .kind = CheckKind::paper,
                     .array = "v_new",
                     .quantity = "relative L2 error of v_new against (x_new - x) / dt",
                     .tolerance = tolerance,
                     .why = "the paper's table of inputs and checks",
                     .needs_truth = false},
                    [](const Judged& j) {
                      const HostArray &v = output(j, "v_new"), &x_new = output(j, "x_new"),
                                      &x = input(j, "x");
                      double error = 0, size = 0;
                      for (std::int64_t c = 0; c < v.size(); ++c) {
                        const double expected = (x_new.value(c) - x.value(c)) / j.problem.scalar("dt");
                        error += (v.value(c) - expected) * (v.value(c) - expected);
                        size += expected * expected;
                      }
                      return one(size > 0 ? std::sqrt(error / size) : std::sqrt(error));
                    });
}

Check velocity_units_check() {
  return worst_over({.name = "v_new_units",
                     .array = "v_new",
                     .quantity = "v_new - (x_new - x) / dt, in units in the last place",
                     .tolerance = 2,
                     .why = "a difference and a quotient, or a product with 1/dt, each rounded once",
                     .needs_truth = false},
                    [](const Judged& j) {
                      const HostArray &v = output(j, "v_new"), &x_new = output(j, "x_new"),
                                      &x = input(j, "x");
                      return Items{v.size(), [&v, &x_new, &x, dt = j.problem.scalar("dt")](std::int64_t c) {
                                     const double expected = (x_new.value(c) - x.value(c)) / dt;
                                     return (v.value(c) - expected) / unit(expected);
                                   }};
                    });
}

Check free_particles_check(const std::string& elements) {
  return worst_over(
      {.name = "free_units",
       .array = "x_new",
       .quantity =
           "x_new - (x + dt v) of what no element holds, in units in the last place of x_new or of dt v",
       .tolerance = 1.01,
       .why = "their step has a closed form: one rounding of dt v, one of the sum",
       .needs_truth = false},
      [elements](const Judged& j) {
        const HostArray &x = input(j, "x"), &v = input(j, "v"), &got = output(j, "x_new");
        std::vector<char> held(static_cast<std::size_t>(x.shape()[0]), 0);
        for (const std::int32_t i : input(j, elements).as<std::int32_t>())
          held[static_cast<std::size_t>(i)] = 1;
        return Items{x.size(),
                     [&x, &v, &got, held = std::move(held), dt = j.problem.scalar("dt")](std::int64_t c) {
                       if (held[static_cast<std::size_t>(c / 3)]) return 0.0;
                       const double moved = dt * v.value(c), expected = x.value(c) + moved;
                       return (got.value(c) - expected) / unit(std::max(std::abs(expected), std::abs(moved)));
                     }};
      });
}

}  // namespace gpuphys::newton
