#include "cases/local_interaction/elastic_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::elastic {
namespace {

// Random streams; vector component d of particle q (numbered before shuffling) is item 3 q + d.
constexpr std::uint64_t kJitter = 0, kNoise = 1, kMass = 2, kRestJitter = 3, kEnds = 97, kElementOrder = 98,
                        kParticleOrder = 99;

std::size_t at(std::int64_t i) {
  return static_cast<std::size_t>(i);
}

// Calls body(i) for i in [0, n), in parallel.
template <class Body>
void for_each_item(std::int64_t n, Body&& body) {
  parallel_pieces(n, [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) body(i);
  });
}

Vec3 random_vector(std::uint64_t seed, std::uint64_t stream, std::int64_t q) {
  const std::uint64_t item = 3 * static_cast<std::uint64_t>(q);
  return {uniform11(seed, stream, item), uniform11(seed, stream, item + 1),
          uniform11(seed, stream, item + 2)};
}

double mass_factor(std::uint64_t seed, std::int64_t q) {
  return 0.8 + 0.4 * uniform01(seed, kMass, static_cast<std::uint64_t>(q));
}

Vec3 smooth_field(const Deformation& f, const std::array<std::int64_t, 3>& extent, const Vec3& p) {
  Vec3 field;
  for (std::size_t d = 0; d < 3; ++d) {
    const std::size_t e = (d + 1) % 3, g = (d + 2) % 3;
    const double we = 2 * std::numbers::pi * f.periods / static_cast<double>(extent[e]);
    const double wg = 2 * std::numbers::pi * f.periods / static_cast<double>(extent[g]);
    field[d] = std::sin(we * p[e] + static_cast<double>(d)) * std::cos(wg * p[g]);
  }
  return field;
}

// Displacement and velocity of lattice point q at p.
void deform(const Deformation& f, const std::array<std::int64_t, 3>& extent, const Vec3& p, std::int64_t q,
            Vec3& x, Vec3& v) {
  const double longest = static_cast<double>(std::max({extent[0], extent[1], extent[2]}));
  const double amplitude = f.strain / (2 * std::numbers::pi * f.periods / longest);
  const Vec3 displacement = smooth_field(f, extent, p),
             wave = smooth_field(f, extent, {p[0] + 7, p[1] + 7, p[2] + 7});
  const Vec3 jitter = random_vector(f.seed, kJitter, q), noise = random_vector(f.seed, kNoise, q);
  for (std::size_t d = 0; d < 3; ++d) {
    x[d] += amplitude * displacement[d] + f.jitter * jitter[d];
    v[d] = f.speed * (wave[d] + f.noise * noise[d]);
  }
}

// Number q counted along the last axis first.
std::array<std::int64_t, 3> lattice_point(const std::array<std::int64_t, 3>& points, std::int64_t q) {
  return {q / points[2] / points[1], q / points[2] % points[1], q % points[2]};
}

void resize(Particles& p, std::int64_t n) {
  p.x.resize(at(n));
  p.v.resize(at(n));
  p.mass.resize(at(n));
}

// Where each item of a random order comes to lie.
std::vector<std::int32_t> inverse(const std::vector<std::int32_t>& order) {
  std::vector<std::int32_t> place(order.size());
  for (std::size_t i = 0; i < order.size(); ++i) place[at(order[i])] = static_cast<std::int32_t>(i);
  return place;
}

double determinant(const Vec3& a, const Vec3& b, const Vec3& c) {
  return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
         a[2] * (b[0] * c[1] - b[1] * c[0]);
}

template <class T>
std::span<T> array_of(Problem& p, const std::string& name) {
  for (HostArray& a : p.inputs) {
    if (a.name() == name) return a.as<T>();
  }
  throw Error(ExitCode::internal, fmt::format("the problem has no array '{}'", name));
}

void store_particles(const Particles& body, Problem& p) {
  const auto x = array_of<float>(p, "x"), v = array_of<float>(p, "v"), mass = array_of<float>(p, "mass");
  for (std::size_t i = 0; i < body.x.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) {
      x[3 * i + d] = static_cast<float>(body.x[i][d]);
      v[3 * i + d] = static_cast<float>(body.v[i][d]);
    }
    mass[i] = static_cast<float>(body.mass[i]);
  }
}

double length(const HostArray& a, std::int64_t i) {
  return std::hypot(a.value(3 * i), a.value(3 * i + 1), a.value(3 * i + 2));
}

}  // namespace

std::vector<std::int32_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t n) {
  std::vector<std::pair<std::uint64_t, std::int32_t>> keyed(at(n));
  for_each_item(n, [&](std::int64_t i) {
    keyed[at(i)] = {random_bits(seed, stream, static_cast<std::uint64_t>(i)), static_cast<std::int32_t>(i)};
  });
  std::sort(keyed.begin(), keyed.end());
  std::vector<std::int32_t> order;
  order.reserve(keyed.size());
  for (const auto& item : keyed) order.push_back(item.second);
  return order;
}

SpringBody spring_lattice(std::array<std::int64_t, 3> points, std::int64_t free_side, const Deformation& f) {
  const std::int64_t lattice = points[0] * points[1] * points[2],
                     n = lattice + free_side * free_side * free_side;
  SpringBody body;
  resize(body, n);
  const std::vector<std::int32_t> order = random_order(f.seed, kParticleOrder, n), number = inverse(order);
  for_each_item(n, [&](std::int64_t i) {
    const std::int64_t q = order[at(i)];
    Vec3& x = body.x[at(i)];
    Vec3& v = body.v[at(i)];
    if (q < lattice) {
      const auto point = lattice_point(points, q);
      for (std::size_t d = 0; d < 3; ++d)
        x[d] = static_cast<double>(point[d]) - 0.5 * static_cast<double>(points[d] - 1);
      deform(f, points, x, q, x, v);
    } else {
      const auto point = lattice_point({free_side, free_side, free_side}, q - lattice);
      const Vec3 jitter = random_vector(f.seed, kJitter, q), noise = random_vector(f.seed, kNoise, q);
      const Vec3 corner{70, -15, -15};
      for (std::size_t d = 0; d < 3; ++d) {
        x[d] = corner[d] + 2 * static_cast<double>(point[d]) + f.jitter * jitter[d];
        v[d] = f.speed * f.noise * noise[d];
      }
    }
    body.mass[at(i)] = mass_factor(f.seed, q);
  });

  constexpr std::array<std::array<std::int64_t, 3>, 9> directions{
      {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 0}, {1, -1, 0}, {1, 0, 1}, {1, 0, -1}, {0, 1, 1}, {0, 1, -1}}};
  struct Spring {
    std::int32_t a, b;
    bool diagonal;
  };
  std::vector<Spring> springs;
  springs.reserve(at(9 * lattice));
  for (std::int64_t q = 0; q < lattice; ++q) {
    const auto point = lattice_point(points, q);
    for (const auto& step : directions) {
      std::int64_t other = 0;
      bool inside = true;
      for (std::size_t d = 0; d < 3; ++d) {
        const std::int64_t c = point[d] + step[d];
        inside = inside && c >= 0 && c < points[d];
        other = other * points[d] + c;
      }
      if (!inside) continue;
      springs.push_back(
          {number[at(q)], number[at(other)], std::abs(step[0]) + std::abs(step[1]) + std::abs(step[2]) == 2});
    }
  }
  const auto m = static_cast<std::int64_t>(springs.size());
  const std::vector<std::int32_t> spring_order = random_order(f.seed, kElementOrder, m);
  body.springs.resize(springs.size());
  body.rest.resize(springs.size());
  for_each_item(m, [&](std::int64_t j) {
    const Spring& s = springs[at(spring_order[at(j)])];
    const std::size_t turned = random_bits(f.seed, kEnds, static_cast<std::uint64_t>(j)) & 1;
    body.springs[at(j)][turned] = s.a;
    body.springs[at(j)][1 - turned] = s.b;
    body.rest[at(j)] = s.diagonal ? std::numbers::sqrt2 : 1;
  });
  return body;
}

TetBody tet_block(std::array<std::int64_t, 3> cells, const Deformation& f) {
  const std::array<std::int64_t, 3> points{cells[0] + 1, cells[1] + 1, cells[2] + 1};
  const std::int64_t n = points[0] * points[1] * points[2], cubes = cells[0] * cells[1] * cells[2],
                     m = 6 * cubes;
  TetBody body;
  resize(body, n);
  body.rest.resize(at(n));
  const std::vector<std::int32_t> order = random_order(f.seed, kParticleOrder, n), number = inverse(order);
  for_each_item(n, [&](std::int64_t i) {
    const std::int64_t q = order[at(i)];
    const auto point = lattice_point(points, q);
    Vec3 p;
    for (std::size_t d = 0; d < 3; ++d)
      p[d] = static_cast<double>(point[d]) - 0.5 * static_cast<double>(cells[d]);
    const Vec3 jitter = random_vector(f.seed, kRestJitter, q);
    for (std::size_t d = 0; d < 3; ++d) body.x[at(i)][d] = body.rest[at(i)][d] = p[d] + f.jitter * jitter[d];
    deform(f, cells, p, q, body.x[at(i)], body.v[at(i)]);
  });

  // From the low corner of a cube to its high one, a step along each axis in the order of a permutation. Two
  // vertices of the odd ones change places.
  constexpr std::array<std::array<std::size_t, 3>, 6> paths{
      {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}}};
  constexpr std::array<std::array<std::size_t, 4>, 12> even{{{0, 1, 2, 3},
                                                             {0, 2, 3, 1},
                                                             {0, 3, 1, 2},
                                                             {1, 0, 3, 2},
                                                             {1, 2, 0, 3},
                                                             {1, 3, 2, 0},
                                                             {2, 0, 1, 3},
                                                             {2, 1, 3, 0},
                                                             {2, 3, 0, 1},
                                                             {3, 0, 2, 1},
                                                             {3, 1, 0, 2},
                                                             {3, 2, 1, 0}}};
  const std::vector<std::int32_t> tet_order = random_order(f.seed, kElementOrder, m);
  body.tets.resize(at(m));
  for_each_item(m, [&](std::int64_t j) {
    const std::int64_t tet = tet_order[at(j)];
    const std::size_t path = at(tet % 6);
    auto corner = lattice_point(cells, tet / 6);
    std::array<std::int32_t, 4> vertices;
    for (std::size_t k = 0; k < 4; ++k) {
      if (k > 0) ++corner[paths[path][k - 1]];
      vertices[k] = number[at((corner[0] * points[1] + corner[1]) * points[2] + corner[2])];
    }
    if (path >= 3) std::swap(vertices[2], vertices[3]);
    const auto& turned =
        even[at(static_cast<std::int64_t>(random_bits(f.seed, kEnds, static_cast<std::uint64_t>(j)) % 12))];
    for (std::size_t k = 0; k < 4; ++k) body.tets[at(j)][k] = vertices[turned[k]];
  });

  for (const auto& tet : body.tets) {
    Vec3 edge[3];
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t d = 0; d < 3; ++d)
        edge[k][d] = body.rest[at(tet[k + 1])][d] - body.rest[at(tet[0])][d];
    }
    for (const std::int32_t i : tet) body.mass[at(i)] += determinant(edge[0], edge[1], edge[2]) / 24;
  }
  for (std::int64_t i = 0; i < n; ++i) body.mass[at(i)] *= mass_factor(f.seed, order[at(i)]);
  return body;
}

Mat3 random_rotation(std::uint64_t seed, std::uint64_t stream, std::uint64_t item) {
  // Shoemake: three uniform numbers make a uniform unit quaternion.
  const double u = uniform01(seed, stream, 4 * item),
               a = 2 * std::numbers::pi * uniform01(seed, stream, 4 * item + 1),
               b = 2 * std::numbers::pi * uniform01(seed, stream, 4 * item + 2);
  const double x = std::sqrt(1 - u) * std::sin(a), y = std::sqrt(1 - u) * std::cos(a),
               z = std::sqrt(u) * std::sin(b), w = std::sqrt(u) * std::cos(b);
  return {{{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
           {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
           {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}}};
}

Vec3 operator*(const Mat3& a, const Vec3& x) {
  Vec3 y{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) y[i] += a[i][j] * x[j];
  }
  return y;
}

Mat3 operator*(const Mat3& a, const Mat3& b) {
  Mat3 c{};
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      for (std::size_t k = 0; k < 3; ++k) c[i][j] += a[i][k] * b[k][j];
    }
  }
  return c;
}

Mat3 transposed(const Mat3& a) {
  Mat3 t;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) t[i][j] = a[j][i];
  }
  return t;
}

void store(const SpringBody& body, Problem& p) {
  store_particles(body, p);
  const auto springs = array_of<std::int32_t>(p, "springs");
  const auto rest = array_of<float>(p, "rest");
  for (std::size_t j = 0; j < body.springs.size(); ++j) {
    for (std::size_t e = 0; e < 2; ++e) springs[2 * j + e] = body.springs[j][e];
    rest[j] = static_cast<float>(body.rest[j]);
  }
}

void store(const TetBody& body, Problem& p) {
  store_particles(body, p);
  const auto tets = array_of<std::int32_t>(p, "tets");
  const auto rest = array_of<float>(p, "X");
  for (std::size_t j = 0; j < body.tets.size(); ++j) {
    for (std::size_t e = 0; e < 4; ++e) tets[4 * j + e] = body.tets[j][e];
  }
  for (std::size_t i = 0; i < body.rest.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) rest[3 * i + d] = static_cast<float>(body.rest[i][d]);
  }
}

Check position_units_check(double v_tolerance) {
  return worst_over(
      {.name = "x_new_units",
       .array = "x_new",
       .quantity =
           "error of a coordinate beyond that of dt v_new, in units in the last place of x_new or x_new - x",
       .tolerance = 1,
       .why = "the step is known to far less than a unit, so that two correct results are the same float32 "
              "number "
              "or neighbours"},
      [v_tolerance](const Judged& j) {
        const HostArray &got = output(j, "x_new"), &expected = truth(j, "x_new"), &v = truth(j, "v_new"),
                        &x = input(j, "x");
        double square = 0;
        for (std::int64_t i = 0; i < v.size(); ++i) square += v.value(i) * v.value(i);
        const double slack =
            v_tolerance * std::sqrt(square / static_cast<double>(v.size())) * j.problem.scalar("dt");
        const auto error = [&got, &expected, &x, slack](std::int64_t i) {
          const double e = static_cast<double>(static_cast<float>(expected.value(i)));
          const double scale = std::max({std::abs(e), std::abs(e - x.value(i)), 0x1p-120});
          const double difference = std::abs(got.value(i) - e);
          return difference <= slack ? 0.0 : (difference - slack) / std::ldexp(1.0, std::ilogb(scale) - 23);
        };
        return Items{got.size(), error, [&got, &expected](std::int64_t i) {
                       return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, i), got.value(i),
                                          expected.value(i));
                     }};
      });
}

Check positions_follow_check() {
  return worst_over(
      {.name = "positions_follow",
       .array = "x_new",
       .quantity = "x_new - (x + dt v_new), in units in the last place of x_new or x_new - x",
       .tolerance = 2,
       .why =
           "half a unit for the rounding of x_new; v_new, its sum with x and products with dt make another",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &x_new = output(j, "x_new"), &v_new = output(j, "v_new"), &x = input(j, "x");
        return Items{x.size(), [&x_new, &v_new, &x, dt = j.problem.scalar("dt")](std::int64_t i) {
                       const double scale = std::max(
                           {std::abs(x_new.value(i)), std::abs(x_new.value(i) - x.value(i)), 0x1p-120});
                       return (x_new.value(i) - (x.value(i) + dt * v_new.value(i))) /
                              std::ldexp(1.0, std::ilogb(scale) - 23);
                     }};
      });
}

Check momentum_check(double tolerance, const std::string& why) {
  return conserved_sum({.name = "momentum",
                        .kind = CheckKind::invariant,
                        .array = "v_new",
                        .quantity = "sum of mass (v_new - v), over sum of mass (|v_new| + |v_new - v|)",
                        .tolerance = tolerance,
                        .why = why,
                        .needs_truth = false},
                       [](const Judged& j) {
                         const HostArray &got = output(j, "v_new"), &v = input(j, "v"),
                                         &mass = input(j, "mass");
                         const auto term = [&got, &v, &mass](std::int64_t i) {
                           Vec3 t;
                           for (std::size_t d = 0; d < 3; ++d) {
                             const auto c = 3 * i + static_cast<std::int64_t>(d);
                             t[d] = mass.value(i) * (got.value(c) - v.value(c));
                           }
                           return t;
                         };
                         double scale = 0;
                         for (std::int64_t i = 0; i < mass.size(); ++i) {
                           const Vec3 t = term(i);
                           scale += mass.value(i) * length(got, i) + std::hypot(t[0], t[1], t[2]);
                         }
                         return Terms{mass.size(), term, {0, 0, 0}, scale};
                       });
}

Check free_particles_check(const std::string& elements) {
  return worst_over({.name = "free_ballistic",
                     .array = "v_new",
                     .quantity = "v_new - v of what no element holds, m/s",
                     .tolerance = 0,
                     .why = "nothing acts on these, and v + 0 = v in any precision",
                     .needs_truth = false},
                    [elements](const Judged& j) {
                      const HostArray &got = output(j, "v_new"), &v = input(j, "v");
                      std::vector<char> held(static_cast<std::size_t>(v.shape()[0]), 0);
                      for (const std::int32_t i : input(j, elements).as<std::int32_t>()) held[at(i)] = 1;
                      return Items{v.size(), [&got, &v, held = std::move(held)](std::int64_t i) {
                                     return held[at(i / 3)] ? 0.0 : got.value(i) - v.value(i);
                                   }};
                    });
}

Check velocity_kept_check(double tolerance, const std::string& why) {
  return worst_over(
      {.name = "velocity_kept",
       .kind = CheckKind::invariant,
       .array = "v_new",
       .quantity = "v_new - v, m/s",
       .tolerance = tolerance,
       .why = why,
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &got = output(j, "v_new"), &v = input(j, "v");
        return Items{v.size(), [&got, &v](std::int64_t i) { return got.value(i) - v.value(i); }};
      });
}

}  // namespace gpuphys::elastic
