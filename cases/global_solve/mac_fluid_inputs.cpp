#include "cases/global_solve/mac_fluid_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>

#include "core/base/parallel.hpp"
#include "core/generators/cut_cell_cylinder.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::mac_fluid {
namespace {

Inputs bound(const Problem& p) {
  // The shared arrays come first in every contract of the family.
  Inputs in;
  const std::array views{&in.ux, &in.uy, &in.uz, &in.wx, &in.wy, &in.wz};
  for (std::size_t a = 0; a < views.size(); ++a) {
    views[a]->data = p.inputs[a].as<float>().data();
    for (std::size_t d = 0; d < 3; ++d) views[a]->shape[d] = p.inputs[a].shape()[d];
  }
  in.dx = static_cast<float>(p.scalar("dx"));
  in.dt = static_cast<float>(p.scalar("dt"));
  in.tol = static_cast<float>(p.scalar("tol"));
  return in;
}

const View<const float, 3>& velocity_of(const Inputs& in, int axis) {
  return axis == 0 ? in.ux : axis == 1 ? in.uy : in.uz;
}
const View<const float, 3>& open_of(const Inputs& in, int axis) {
  return axis == 0 ? in.wx : axis == 1 ? in.wy : in.wz;
}

// visit(i, j, k, flat index) for every entry, planes in parallel.
template <class Visit>
void each_face(const Shape& shape, const Visit& visit) {
  parallel_for(shape[0], [&](std::int64_t i) {
    for (std::int64_t j = 0; j < shape[1]; ++j) {
      for (std::int64_t k = 0; k < shape[2]; ++k)
        visit(i, j, k, static_cast<std::size_t>((i * shape[1] + j) * shape[2] + k));
    }
  });
}

// Sum over planes in their order, of what sum_of(i) gives.
template <class SumOf>
double sum_planes(std::int64_t planes, const SumOf& sum_of) {
  std::vector<double> sums(static_cast<std::size_t>(planes), 0.0);
  parallel_for(planes, [&](std::int64_t i) { sums[static_cast<std::size_t>(i)] = sum_of(i); });
  double total = 0;
  for (const double s : sums) total += s;
  return total;
}

}  // namespace

Open all_open() {
  return [](int, std::int64_t, std::int64_t, std::int64_t) { return 1.0; };
}

Open cylinder(Extents n, double radius) {
  const auto solid = std::make_shared<CutCellCylinder>(n[0], n[1], n[2], radius * static_cast<double>(n[0]));
  return [solid](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    return axis == 0 ? solid->face_x(i, j) : axis == 1 ? solid->face_y(i, j) : solid->face_z(i, j, k);
  };
}

Open ball(std::array<double, 3> centre, double radius) {
  return [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    const auto phi = [&](int a, int b) {
      std::array<double, 3> at{static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)};
      at[static_cast<std::size_t>((axis + 1) % 3)] += a;
      at[static_cast<std::size_t>((axis + 2) % 3)] += b;
      double square = 0;
      for (std::size_t d = 0; d < 3; ++d) square += (at[d] - centre[d]) * (at[d] - centre[d]);
      return std::sqrt(square) - radius;
    };
    return open_square_area(phi(0, 0), phi(1, 0), phi(1, 1), phi(0, 1));
  };
}

Open random_faces(Extents n, std::uint64_t seed, double closed) {
  return [=](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    Extents shape = n;
    ++shape[static_cast<std::size_t>(axis)];
    const auto item = static_cast<std::uint64_t>((i * shape[1] + j) * shape[2] + k);
    const double value = uniform01(seed, 30 + static_cast<std::uint64_t>(axis), item);
    return value < closed ? 0.0 : value;
  };
}

Problem make_fluid(const Contract& contract, Extents n, const Open& open) {
  Problem p = make_problem(contract, {{"nx", n[0]}, {"ny", n[1]}, {"nz", n[2]}});
  for (int axis = 0; axis < 3; ++axis) {
    HostArray& w = p.inputs[static_cast<std::size_t>(3 + axis)];
    const Shape shape = w.shape();
    const auto out = w.as<float>();
    each_face(shape, [&](std::int64_t i, std::int64_t j, std::int64_t k, std::size_t flat) {
      const std::int64_t at[3] = {i, j, k};
      const auto d = static_cast<std::size_t>(axis);
      if (at[d] == 0 || at[d] == n[d]) return;
      const double fraction = open(axis, i, j, k);
      out[flat] = fraction < kLeastOpen ? 0.0f : static_cast<float>(fraction);
    });
  }
  return p;
}

void set_velocity(Problem& p, const Velocity& velocity) {
  const Inputs in = bound(p);
  for (int axis = 0; axis < 3; ++axis) {
    HostArray& u = p.inputs[static_cast<std::size_t>(axis)];
    const auto out = u.as<float>();
    each_face(u.shape(), [&](std::int64_t i, std::int64_t j, std::int64_t k, std::size_t flat) {
      out[flat] = is_open(in, axis, i, j, k) ? static_cast<float>(velocity(axis, i, j, k)) : 0.0f;
    });
  }
}

void set_noise(Problem& p, std::uint64_t seed, double size) {
  std::array<Shape, 3> shape;
  for (std::size_t c = 0; c < 3; ++c) shape[c] = p.inputs[c].shape();
  set_velocity(p, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    const Shape& s = shape[static_cast<std::size_t>(axis)];
    return size * uniform11(seed, 40 + static_cast<std::uint64_t>(axis),
                            static_cast<std::uint64_t>((i * s[1] + j) * s[2] + k));
  });
}

void set_taylor_green(Problem& p, const Modes& modes) {
  struct Mode {
    std::array<int, 3> k;
    std::array<double, 3> a;
  };
  const Inputs in = bound(p);
  const std::array<double, 3> cells{static_cast<double>(in.uy.shape[0]), static_cast<double>(in.ux.shape[1]),
                                    static_cast<double>(in.ux.shape[2])};
  std::vector<Mode> all;
  for (std::uint64_t item = 0; static_cast<int>(all.size()) < modes.count; ++item) {
    Mode m;
    double along = 0, square = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      m.k[d] = 1 + static_cast<int>(modes.most * uniform01(modes.seed, 50 + d, item));
      m.a[d] = uniform11(modes.seed, 53 + d, item);
      along += m.a[d] * m.k[d] / cells[d];
      square += m.k[d] / cells[d] * (m.k[d] / cells[d]);
    }
    double size = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      m.a[d] -= along / square * m.k[d] / cells[d];
      size += m.a[d] * m.a[d];
    }
    const bool seen = std::any_of(all.begin(), all.end(), [&](const Mode& o) { return o.k == m.k; });
    if (seen || size < 0.01) continue;
    for (double& a : m.a) a /= std::sqrt(size);
    all.push_back(m);
  }
  // Tables of sine at the samples of a component along its own axis, cosine along the others.
  std::array<std::vector<double>, 3> field;
  double square = 0, open = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const Shape& shape = p.inputs[static_cast<std::size_t>(axis)].shape();
    std::array<std::vector<double>, 3> table;
    for (std::size_t d = 0; d < 3; ++d) {
      for (const Mode& m : all) {
        for (std::int64_t i = 0; i < shape[d]; ++i) {
          const bool own = static_cast<int>(d) == axis;
          const double x =
              std::numbers::pi * m.k[d] * (static_cast<double>(i) + (own ? 0.0 : 0.5)) / cells[d];
          table[d].push_back(own ? std::sin(x) : std::cos(x));
        }
      }
    }
    std::vector<double>& u = field[static_cast<std::size_t>(axis)];
    u.assign(static_cast<std::size_t>(shape[0] * shape[1] * shape[2]), 0.0);
    const auto entry = [&](std::size_t d, std::size_t m, std::int64_t i) {
      return table[d][m * static_cast<std::size_t>(shape[d]) + static_cast<std::size_t>(i)];
    };
    parallel_for(shape[0], [&](std::int64_t i) {
      for (std::int64_t j = 0; j < shape[1]; ++j) {
        double* row = &u[static_cast<std::size_t>((i * shape[1] + j) * shape[2])];
        for (std::size_t m = 0; m < all.size(); ++m) {
          const double factor = all[m].a[static_cast<std::size_t>(axis)] * entry(0, m, i) * entry(1, m, j);
          const double* along = &table[2][m * static_cast<std::size_t>(shape[2])];
          for (std::int64_t k = 0; k < shape[2]; ++k) row[k] += factor * along[k];
        }
      }
    });
    const auto sum = [&](bool squares) {
      return sum_planes(shape[0], [&](std::int64_t i) {
        double s = 0;
        for (std::int64_t j = 0; j < shape[1]; ++j) {
          for (std::int64_t k = 0; k < shape[2]; ++k) {
            if (!is_open(in, axis, i, j, k)) continue;
            const double v = u[static_cast<std::size_t>((i * shape[1] + j) * shape[2] + k)];
            s += squares ? v * v : 1;
          }
        }
        return s;
      });
    };
    square += sum(true);
    open += sum(false);
  }
  const double factor = square > 0 ? std::sqrt(open / square) : 0;
  set_velocity(p, [&](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
    const Shape& shape = p.inputs[static_cast<std::size_t>(axis)].shape();
    return factor *
           field[static_cast<std::size_t>(axis)][static_cast<std::size_t>((i * shape[1] + j) * shape[2] + k)];
  });
}

void scale_velocity(Problem& p, double factor) {
  for (std::size_t c = 0; c < 3; ++c) {
    for (float& v : p.inputs[c].as<float>()) v = static_cast<float>(factor * static_cast<double>(v));
  }
}

InputSet cylinder_set(const std::string& name, SetKind kind, Size size, const Contract& contract, Extents n,
                      double radius, const Modes& modes,
                      std::vector<std::pair<std::string, double>> scalars) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{}x{}x{} cells, cylinder of radius {} nx, {} Taylor-Green modes up to {}, seed {}",
                        n[0], n[1], n[2], radius, modes.count, modes.most, modes.seed);
  s.make = [=] {
    Problem p = make_fluid(contract, n, cylinder(n, radius));
    for (const auto& [scalar, value] : scalars) p.set_scalar(scalar, value);
    set_taylor_green(p, modes);
    return p;
  };
  return s;
}

bool is_open(const Inputs& in, int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
  const View<const float, 3>& w = open_of(in, axis);
  const std::int64_t at[3] = {i, j, k};
  return at[axis] > 0 && at[axis] + 1 < w.shape[axis] && w(i, j, k) > 0;
}

Check viscous_residual_check() {
  return worst_over(
      {.name = "viscous_residual",
       .kind = CheckKind::local,
       .array = "ux, uy, uz",
       .quantity =
           "||b - A u|| / ||b|| of a component over the larger of tol + 1e-5 and 2^-22 || |A| |u| || / ||b||",
       .tolerance = 1,
       .why = "what the task asks of a solver; storing u in float32 alone costs 2^-24 |A| |u|",
       .needs_truth = false},
      [](const Judged& j) {
        const Inputs in = bound(j.problem);
        const double dx = j.problem.scalar("dx");
        const double alpha = j.problem.scalar("nu") * j.problem.scalar("dt") / (dx * dx);
        std::array<double, 3> ratio{};
        std::array<std::string, 3> text;
        for (int axis = 0; axis < 3; ++axis) {
          const auto c = static_cast<std::size_t>(axis);
          const HostArray& u = output(j, j.outputs[c].name());
          const Shape shape = u.shape();
          const auto at = [&](std::int64_t a, std::int64_t b, std::int64_t e) {
            return (a * shape[1] + b) * shape[2] + e;
          };
          // Sums of squares: residual, b, |A| |u|.
          const auto square = [&](int which) {
            return sum_planes(shape[0], [&](std::int64_t i) {
              double sum = 0;
              for (std::int64_t jj = 0; jj < shape[1]; ++jj) {
                for (std::int64_t k = 0; k < shape[2]; ++k) {
                  if (!is_open(in, axis, i, jj, k)) continue;
                  const double w = open_of(in, axis)(i, jj, k), own = u.value(at(i, jj, k));
                  const double b = w * static_cast<double>(velocity_of(in, axis)(i, jj, k));
                  double product = w * own, size = std::abs(product);
                  for (std::size_t d = 0; d < 3; ++d) {
                    for (const std::int64_t side : {-1, 1}) {
                      std::int64_t n[3] = {i, jj, k};
                      n[d] += side;
                      if (n[d] < 0 || n[d] >= shape[d]) continue;
                      const double other =
                          is_open(in, axis, n[0], n[1], n[2]) ? u.value(at(n[0], n[1], n[2])) : 0.0;
                      product += alpha * (own - other);
                      size += alpha * (std::abs(own) + std::abs(other));
                    }
                  }
                  const double v = which == 0 ? b - product : which == 1 ? b : size;
                  sum += v * v;
                }
              }
              return sum;
            });
          };
          const double r = std::sqrt(square(0)), b = std::sqrt(square(1)), size = std::sqrt(square(2));
          const double bound_on = std::max((j.problem.scalar("tol") + 1e-5) * b, 0x1p-22 * size);
          ratio[c] = bound_on > 0 ? r / bound_on : r;
          text[c] = fmt::format("{}: residual {:.3g}, bound {:.3g}", u.name(), b > 0 ? r / b : r,
                                b > 0 ? bound_on / b : 0);
        }
        return Items{3, [ratio](std::int64_t c) { return ratio[static_cast<std::size_t>(c)]; },
                     [text](std::int64_t c) { return text[static_cast<std::size_t>(c)]; }};
      });
}

Check divergence_check(const std::string& name, CheckKind kind, double tolerance, const std::string& why) {
  return worst_over(
      {.name = name,
       .kind = kind,
       .array = "ux, uy, uz",
       .quantity = "||sum of +-w u over the faces of a cell|| / ||u||",
       .tolerance = tolerance,
       .why = why,
       .needs_truth = false},
      [](const Judged& j) {
        const Inputs in = bound(j.problem);
        const std::int64_t nx = in.uy.shape[0], ny = in.ux.shape[1], nz = in.ux.shape[2];
        const HostArray &ux = output(j, "ux"), &uy = output(j, "uy"), &uz = output(j, "uz");
        const auto flux = [&](int axis, const HostArray& u, std::int64_t a, std::int64_t b, std::int64_t e) {
          return is_open(in, axis, a, b, e) ? static_cast<double>(open_of(in, axis)(a, b, e)) *
                                                  u.value((a * u.shape()[1] + b) * u.shape()[2] + e)
                                            : 0.0;
        };
        const double divergence = sum_planes(nx, [&](std::int64_t i) {
          double sum = 0;
          for (std::int64_t b = 0; b < ny; ++b) {
            for (std::int64_t k = 0; k < nz; ++k) {
              const double d = flux(0, ux, i + 1, b, k) - flux(0, ux, i, b, k) + flux(1, uy, i, b + 1, k) -
                               flux(1, uy, i, b, k) + flux(2, uz, i, b, k + 1) - flux(2, uz, i, b, k);
              sum += d * d;
            }
          }
          return sum;
        });
        double size = 0;
        for (const HostArray* u : {&ux, &uy, &uz}) {
          for (std::int64_t f = 0; f < u->size(); ++f) size += u->value(f) * u->value(f);
        }
        const double ratio = size > 0 ? std::sqrt(divergence / size) : std::sqrt(divergence + size);
        return Items{1, [ratio](std::int64_t) { return ratio; },
                     [divergence, size](std::int64_t) {
                       return fmt::format("divergence {:.4g} of {:.4g}", std::sqrt(divergence),
                                          std::sqrt(size));
                     }};
      });
}

Check closed_faces_check() {
  return count_where(
      {.name = "closed_faces",
       .kind = CheckKind::local,
       .array = "ux, uy, uz",
       .quantity = "closed faces that are not at rest",
       .tolerance = 0,
       .why = "exactly zero there",
       .needs_truth = false},
      [](const Judged& j) {
        const Inputs in = bound(j.problem);
        const std::array<const HostArray*, 3> u{&output(j, "ux"), &output(j, "uy"), &output(j, "uz")};
        const std::int64_t first = u[0]->size(), second = first + u[1]->size();
        const auto place = [=](std::int64_t item) {
          const int axis = item < first ? 0 : item < second ? 1 : 2;
          return std::pair(axis, axis == 0 ? item : axis == 1 ? item - first : item - second);
        };
        return Items{second + u[2]->size(),
                     [=](std::int64_t item) {
                       const auto [axis, flat] = place(item);
                       const HostArray& a = *u[static_cast<std::size_t>(axis)];
                       const std::int64_t ny = a.shape()[1], nz = a.shape()[2];
                       return !is_open(in, axis, flat / (ny * nz), flat / nz % ny, flat % nz) &&
                                      a.value(flat) != 0
                                  ? 1.0
                                  : 0.0;
                     },
                     [=](std::int64_t item) {
                       const auto [axis, flat] = place(item);
                       return index_text(*u[static_cast<std::size_t>(axis)], flat);
                     }};
      });
}

}  // namespace gpuphys::mac_fluid
