#include "cases/global_solve/poisson_system.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::poisson {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

template <class T>
View<T, 3> writable(Problem& p, const std::string& name) {
  for (HostArray& a : p.inputs) {
    if (a.name() != name) continue;
    View<T, 3> v;
    v.data = a.as<T>().data();
    for (int d = 0; d < 3; ++d) v.shape[d] = a.shape()[static_cast<std::size_t>(d)];
    return v;
  }
  throw Error(ExitCode::internal, fmt::format("Poisson system: no input array '{}'", name));
}

// Sum of slab(i) over the planes i of the box. Each plane is summed on its own and the planes are added in
// order, so the result does not depend on the number of threads.
template <class Slab>
double sum_over_planes(std::int64_t nx, Slab&& slab) {
  std::vector<double> partial(static_cast<std::size_t>(nx));
  parallel_for(nx, [&](std::int64_t i) { partial[static_cast<std::size_t>(i)] = slab(i); });
  return std::accumulate(partial.begin(), partial.end(), 0.0);
}

// Calls f(flat, j, k) for the active cells of plane i.
template <class F>
void for_active_in_plane(const View<const bool, 3>& is_dof, std::int64_t i, F&& f) {
  for (std::int64_t j = 0; j < is_dof.shape[1]; ++j) {
    std::int64_t c = is_dof.offset(i, j, 0);
    for (std::int64_t k = 0; k < is_dof.shape[2]; ++k, ++c) {
      if (is_dof.data[c]) f(c, j, k);
    }
  }
}

// One row of A applied to value(cell). Couplings are zero towards cells that hold no unknown, but their
// stored value may be anything in an invalid answer (NaN included), so zero couplings are skipped rather than
// multiplied.
template <class Value>
double row(const Inputs& a, std::int64_t i, std::int64_t j, std::int64_t k, Value&& value) {
  const std::int64_t c = a.b.offset(i, j, k);
  const std::int64_t step[3] = {a.b.shape[1] * a.b.shape[2], a.b.shape[2], 1};
  const std::int64_t at[3] = {i, j, k};
  const View<const float, 3>* couplings[3] = {&a.a_x, &a.a_y, &a.a_z};
  double sum = value(static_cast<double>(a.a_diag.data[c]), c);
  for (int d = 0; d < 3; ++d) {
    const float* w = couplings[d]->data;
    if (at[d] > 0 && w[c - step[d]] != 0) sum += value(static_cast<double>(w[c - step[d]]), c - step[d]);
    if (at[d] + 1 < a.b.shape[d] && w[c] != 0) sum += value(static_cast<double>(w[c]), c + step[d]);
  }
  return sum;
}

double norm_of_b(const Inputs& in) {
  return std::sqrt(sum_over_planes(in.b.shape[0], [&](std::int64_t i) {
    double s = 0;
    for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t, std::int64_t) {
      s += static_cast<double>(in.b.data[c]) * static_cast<double>(in.b.data[c]);
    });
    return s;
  }));
}

std::int64_t active_cells(const Inputs& in) {
  std::int64_t n = 0;
  for (std::int64_t c = 0; c < in.is_dof.size(); ++c) n += in.is_dof.data[c] ? 1 : 0;
  return n;
}

// x of the judged outputs in FP64, shape checked.
std::vector<double> values_of(const Inputs& in, const HostArray& x) {
  const Shape expected(in.b.shape, in.b.shape + 3);
  if (x.shape() != expected) {
    throw Error(ExitCode::internal, fmt::format("judging x of shape {} for a system of shape {}",
                                                to_string(x.shape()), to_string(expected)));
  }
  std::vector<double> v(static_cast<std::size_t>(x.size()));
  const auto copy = [&](auto from) {
    parallel_for(in.b.shape[0], [&](std::int64_t i) {
      const std::int64_t plane = in.b.shape[1] * in.b.shape[2];
      for (std::int64_t c = i * plane; c < (i + 1) * plane; ++c) {
        v[static_cast<std::size_t>(c)] = static_cast<double>(from[static_cast<std::size_t>(c)]);
      }
    });
  };
  if (x.dtype() == DType::f64) {
    copy(x.as<double>());
  } else {
    copy(x.as<float>());
  }
  return v;
}

struct Count {
  std::int64_t number = 0, first = -1;
};

template <class Predicate>
Count count_cells(std::int64_t n, Predicate&& p) {
  Count count;
  for (std::int64_t c = 0; c < n; ++c) {
    if (!p(c)) continue;
    if (count.first < 0) count.first = c;
    ++count.number;
  }
  return count;
}

Count count_non_finite(const std::vector<double>& x) {
  return count_cells(static_cast<std::int64_t>(x.size()),
                     [&](std::int64_t c) { return !std::isfinite(x[static_cast<std::size_t>(c)]); });
}

std::string first_text(const Count& count, const HostArray& x) {
  if (count.number == 0) return "";
  return fmt::format("{} of {} values, first {} = {:.9g}", count.number, x.size(), index_text(x, count.first),
                     x.value(count.first));
}

// A measurement of x that is NaN as soon as any value of x is not finite.
template <class Measure>
std::function<Measured(const Judged&)> for_finite_x(Measure measure) {
  return [measure](const Judged& judged) -> Measured {
    const HostArray& x = find(judged.outputs, "x", "outputs");
    const Inputs in = bind_inputs<Inputs>(judged.problem);
    const std::vector<double> v = values_of(in, x);
    const Count bad = count_non_finite(v);
    if (bad.number > 0) return {kNaN, "not finite: " + first_text(bad, x)};
    return measure(in, v, x);
  };
}

Residual residual_of_values(const Inputs& in, const std::vector<double>& x, const HostArray& array) {
  const std::int64_t nx = in.b.shape[0];
  struct Worst {
    double value = -1;
    std::int64_t cell = 0;
  };
  std::vector<Worst> worst(static_cast<std::size_t>(nx));
  const double norm = std::sqrt(sum_over_planes(nx, [&](std::int64_t i) {
    double s = 0;
    Worst& w = worst[static_cast<std::size_t>(i)];
    for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t j, std::int64_t k) {
      const double ax =
          row(in, i, j, k, [&](double a, std::int64_t n) { return a * x[static_cast<std::size_t>(n)]; });
      const double r = static_cast<double>(in.b.data[c]) - ax;
      s += r * r;
      if (std::abs(r) > w.value) w = {std::abs(r), c};
    });
    return s;
  }));
  Worst all;
  for (const Worst& w : worst) {
    if (w.value > all.value) all = w;
  }
  const double b = norm_of_b(in);
  const double rms = b / std::sqrt(static_cast<double>(active_cells(in)));
  Residual r;
  r.relative_l2 = b == 0 ? norm : norm / b;
  all.value = std::max(all.value, 0.0);  // of no active cell
  r.worst_over_rms = b == 0 ? all.value : all.value / rms;
  r.worst_cell = all.cell;
  r.worst_place = index_text(array, all.cell);
  return r;
}

}  // namespace

Problem make_system(std::int64_t nx, std::int64_t ny, std::int64_t nz, double tol) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"nx", nx}, {"ny", ny}, {"nz", nz}});
  p.set_scalar("tol", tol);
  return p;
}

void assemble(Problem& system, Boundary boundary, const ActiveCell& active,
              const FaceConductance& conductance) {
  const View<bool, 3> is_dof = writable<bool>(system, "is_dof");
  const View<float, 3> diagonal = writable<float>(system, "a_diag");
  const View<float, 3> coupling[3] = {writable<float>(system, "a_x"), writable<float>(system, "a_y"),
                                      writable<float>(system, "a_z")};
  const std::int64_t n[3] = {is_dof.shape[0], is_dof.shape[1], is_dof.shape[2]};
  const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
  parallel_for(n[0], [&](std::int64_t i) {
    for (std::int64_t j = 0; j < n[1]; ++j) {
      for (std::int64_t k = 0; k < n[2]; ++k) is_dof(i, j, k) = active(i, j, k);
    }
  });
  parallel_for(n[0], [&](std::int64_t i) {
    for_active_in_plane({is_dof.data, {n[0], n[1], n[2]}}, i,
                        [&](std::int64_t c, std::int64_t j, std::int64_t k) {
                          const std::int64_t at[3] = {i, j, k};
                          double sum = 0;
                          for (int d = 0; d < 3; ++d) {
                            for (const int side : {0, 1}) {
                              const std::int64_t neighbour = side == 0 ? c - step[d] : c + step[d];
                              const bool inside = side == 0 ? at[d] > 0 : at[d] + 1 < n[d];
                              const bool coupled = inside && is_dof.data[neighbour];
                              if (!coupled && boundary == Boundary::neumann) continue;
                              std::int64_t face[3] = {i, j, k};
                              if (side == 0) --face[d];
                              const float g = static_cast<float>(conductance(d, face[0], face[1], face[2]));
                              sum += static_cast<double>(g);
                              if (coupled && side == 1 && g != 0) coupling[d].data[c] = -g;  // never -0
                            }
                          }
                          diagonal.data[c] = static_cast<float>(sum);
                        });
  });
}

std::vector<double> ramp_and_noise(const Problem& system, std::uint64_t seed, double ramp, double noise) {
  const Inputs in = bind_inputs<Inputs>(system);
  const std::int64_t nx = in.b.shape[0], ny = in.b.shape[1], nz = in.b.shape[2];
  std::vector<double> x(static_cast<std::size_t>(in.b.size()), 0.0);
  const double sum = sum_over_planes(nx, [&](std::int64_t i) {
    double s = 0;
    for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t j, std::int64_t k) {
      const double across = (static_cast<double>(i) + 0.5) / static_cast<double>(nx) +
                            (static_cast<double>(j) + 0.5) / static_cast<double>(ny) +
                            (static_cast<double>(k) + 0.5) / static_cast<double>(nz);
      const double v =
          ramp * (2.0 / 3.0 * across - 1.0) + noise * uniform11(seed, 0, static_cast<std::uint64_t>(c));
      x[static_cast<std::size_t>(c)] = v;
      s += v;
    });
    return s;
  });
  const std::int64_t n = active_cells(in);
  const double mean = n == 0 ? 0 : sum / static_cast<double>(n);
  parallel_for(nx, [&](std::int64_t i) {
    for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t, std::int64_t) {
      x[static_cast<std::size_t>(c)] -= mean;
    });
  });
  return x;
}

std::vector<double> multiply(const Inputs& in, const std::vector<double>& x) {
  std::vector<double> y(x.size(), 0.0);
  parallel_for(in.b.shape[0], [&](std::int64_t i) {
    for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t j, std::int64_t k) {
      y[static_cast<std::size_t>(c)] =
          row(in, i, j, k, [&](double a, std::int64_t n) { return a * x[static_cast<std::size_t>(n)]; });
    });
  });
  return y;
}

void set_right_hand_side(Problem& system, const std::vector<double>& x, double scale) {
  const std::vector<double> ax = multiply(bind_inputs<Inputs>(system), x);
  const View<float, 3> b = writable<float>(system, "b");
  for (std::int64_t c = 0; c < b.size(); ++c)
    b.data[c] = static_cast<float>(scale * ax[static_cast<std::size_t>(c)]);
}

double rounding_amplification(const Problem& system, const std::vector<double>& x) {
  const Inputs in = bind_inputs<Inputs>(system);
  const double norm = std::sqrt(sum_over_planes(in.b.shape[0], [&](std::int64_t i) {
    double s = 0;
    for_active_in_plane(in.is_dof, i, [&](std::int64_t, std::int64_t j, std::int64_t k) {
      const double r = row(in, i, j, k, [&](double a, std::int64_t n) {
        return std::abs(a * x[static_cast<std::size_t>(n)]);
      });
      s += r * r;
    });
    return s;
  }));
  return norm / norm_of_b(in);
}

Arrays as_solution(const Contract& contract, const Problem& problem, const std::vector<double>& x) {
  Arrays outputs = make_outputs(contract, problem, DType::f64);
  std::copy(x.begin(), x.end(), outputs.at(0).as<double>().begin());
  return outputs;
}

Residual residual_of(const Problem& system, const HostArray& x) {
  const Inputs in = bind_inputs<Inputs>(system);
  const std::vector<double> v = values_of(in, x);
  const Count bad = count_non_finite(v);
  if (bad.number > 0) return {kNaN, kNaN, index_text(x, bad.first), bad.first};
  return residual_of_values(in, v, x);
}

Check residual_check(double tolerance, const std::string& why) {
  return {"residual",
          CheckKind::paper,
          "b - A x of the returned x",
          "relative L2, ||b - A x|| / ||b||",
          tolerance,
          why,
          false,
          for_finite_x([](const Inputs& in, const std::vector<double>& v, const HostArray& x) -> Measured {
            const Residual r = residual_of_values(in, v, x);
            return {r.relative_l2, fmt::format("worst equation at {}", r.worst_place)};
          })};
}

Check residual_over_bound_check(const std::string& name, const std::string& bound_text,
                                std::function<double(const Problem&)> bound, const std::string& why) {
  return {name,
          CheckKind::invariant,
          "b - A x of the returned x",
          "||b - A x|| / ||b|| over " + bound_text,
          1,
          why,
          false,
          [bound](const Judged& judged) -> Measured {
            const Residual r = residual_of(judged.problem, find(judged.outputs, "x", "outputs"));
            const double limit = bound(judged.problem);
            return {r.relative_l2 / limit, fmt::format("residual {:.3g}, bound {:.3g}, worst equation at {}",
                                                       r.relative_l2, limit, r.worst_place)};
          }};
}

Check local_residual_check(double tolerance, const std::string& why) {
  return {"residual_local",
          CheckKind::local,
          "b - A x of the returned x",
          "largest entry / rms of b",
          tolerance,
          why,
          false,
          for_finite_x([](const Inputs& in, const std::vector<double>& v, const HostArray& x) -> Measured {
            const Residual r = residual_of_values(in, v, x);
            return {r.worst_over_rms, fmt::format("worst equation at {}", r.worst_place)};
          })};
}

Check mean_check(double tolerance, const std::string& why) {
  return {"mean_over_rms",
          CheckKind::paper,
          "mean of x over the active cells",
          "|mean| / rms",
          tolerance,
          why,
          false,
          for_finite_x([](const Inputs& in, const std::vector<double>& v, const HostArray&) -> Measured {
            const auto moment = [&](int power) {
              return sum_over_planes(in.b.shape[0], [&](std::int64_t i) {
                double s = 0;
                for_active_in_plane(in.is_dof, i, [&](std::int64_t c, std::int64_t, std::int64_t) {
                  s += power == 1 ? v[static_cast<std::size_t>(c)]
                                  : v[static_cast<std::size_t>(c)] * v[static_cast<std::size_t>(c)];
                });
                return s;
              });
            };
            const double n = static_cast<double>(std::max<std::int64_t>(active_cells(in), 1));
            const double mean = moment(1) / n;
            const double rms = std::sqrt(moment(2) / n);
            return {rms == 0 ? std::abs(mean) : std::abs(mean) / rms,
                    fmt::format("mean {:.3g}, rms {:.3g}", mean, rms)};
          })};
}

Check zero_outside_check() {
  return {"zero_outside",
          CheckKind::paper,
          "x on the inactive cells",
          "number of values that are not 0",
          0,
          "the task asks for exact zeros; -0 compares equal to 0 and counts as zero",
          false,
          for_finite_x([](const Inputs& in, const std::vector<double>& v, const HostArray& x) -> Measured {
            const Count bad = count_cells(x.size(), [&](std::int64_t c) {
              return !in.is_dof.data[c] && v[static_cast<std::size_t>(c)] != 0;
            });
            return {static_cast<double>(bad.number), first_text(bad, x)};
          })};
}

Check finite_check(const std::string& why) {
  return {"finite",
          CheckKind::invariant,
          "x",
          "number of values that are NaN or infinite",
          0,
          why,
          false,
          [](const Judged& judged) -> Measured {
            const HostArray& x = find(judged.outputs, "x", "outputs");
            const Count bad = count_non_finite(values_of(bind_inputs<Inputs>(judged.problem), x));
            return {static_cast<double>(bad.number), first_text(bad, x)};
          }};
}

Check zero_solution_check(const std::string& why) {
  return {"zero_solution",
          CheckKind::invariant,
          "x",
          "number of values that are not 0",
          0,
          why,
          false,
          for_finite_x([](const Inputs&, const std::vector<double>& v, const HostArray& x) -> Measured {
            const Count bad =
                count_cells(x.size(), [&](std::int64_t c) { return v[static_cast<std::size_t>(c)] != 0; });
            return {static_cast<double>(bad.number), first_text(bad, x)};
          })};
}

}  // namespace gpuphys::poisson
