// Input sets and checks of fem_newtonian_implicit (specification:
// cases/global_solve/fem_newtonian_implicit.md).
#include "cases/global_solve/fem_newtonian_implicit.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "cases/global_solve/newton_checks.hpp"
#include "cases/local_interaction/elastic_hard_inputs.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::fem_newtonian_implicit {
namespace {

using elastic::Deformation;
using elastic::Mat3;
using elastic::TetBody;
using elastic::Vec3;
using elastic::operator*;

// Young's modulus 1e4 Pa and Poisson's ratio 0.3 by default.
struct Scalars {
  double young = 1e4, poisson = 0.3, dt = 0.05, tol = 1e-3;
  double mu() const { return young / (2 * (1 + poisson)); }
  double lambda() const { return young * poisson / ((1 + poisson) * (1 - 2 * poisson)); }
};

Problem problem_of(const TetBody& body, Scalars s = {}) {
  Problem p = make_problem(
      describe<Inputs, Outputs<float>>(),
      {{"n", static_cast<std::int64_t>(body.x.size())}, {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", s.mu());
  p.set_scalar("lambda", s.lambda());
  p.set_scalar("dt", s.dt);
  p.set_scalar("tol", s.tol);
  return p;
}

Deformation public_field() {
  return {.periods = 2, .strain = 0.08, .jitter = 0.05, .speed = 5, .noise = 0.10, .seed = 1};
}
Deformation hidden_field() {
  return {.periods = 3, .strain = 0.07, .jitter = 0.04, .speed = 5, .noise = 0.12, .seed = 2};
}

// For a block of a fifth of the cells: the same wavelengths, so that a step deforms it as much.
Deformation lengthened(Deformation f) {
  f.periods /= 5;
  return f;
}

InputSet block_set(std::string name, SetKind kind, Size size, std::array<std::int64_t, 3> cells,
                   const Deformation& f) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about =
      fmt::format("{}x{}x{} cubes of six tetrahedra, {} periods, strain {}, jitter {}, noise {}, seed {}",
                  cells[0], cells[1], cells[2], f.periods, f.strain, f.jitter, f.noise, f.seed);
  s.make = [=] { return problem_of(elastic::tet_block(cells, f)); };
  return s;
}

// Tetrahedra in FP64 for the checks.
struct Tet {
  std::size_t corner[4];  // first coordinates
  Mat3 f, cofactor;       // F, and the cofactors of D_m
  double volume6, j;      // det D_m, det F
};

Mat3 cofactors(const Mat3& a) {
  Mat3 c;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const std::size_t i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      c[i][j] = a[i1][j1] * a[i2][j2] - a[i1][j2] * a[i2][j1];
    }
  }
  return c;
}
double determinant(const Mat3& a) {
  const Mat3 c = cofactors(a);
  return a[0][0] * c[0][0] + a[0][1] * c[0][1] + a[0][2] * c[0][2];
}

template <class Visit>
void for_each_tet(const Problem& p, const std::vector<double>& z, Visit&& visit) {
  const HostArray& rest = find(p.inputs, "X", "inputs");
  const auto tets = find(p.inputs, "tets", "inputs").as<std::int32_t>();
  for (std::size_t t = 0; t < tets.size() / 4; ++t) {
    Tet tet;
    for (std::size_t a = 0; a < 4; ++a) tet.corner[a] = 3 * static_cast<std::size_t>(tets[4 * t + a]);
    Mat3 dm, ds;
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < 3; ++c) {
        dm[c][k] = rest.value(static_cast<std::int64_t>(tet.corner[k + 1] + c)) -
                   rest.value(static_cast<std::int64_t>(tet.corner[0] + c));
        ds[c][k] = z[tet.corner[k + 1] + c] - z[tet.corner[0] + c];
      }
    }
    tet.cofactor = cofactors(dm);
    tet.volume6 = determinant(dm);
    tet.f = ds * elastic::transposed(tet.cofactor);
    for (Vec3& row : tet.f) {
      for (double& e : row) e /= tet.volume6;
    }
    tet.j = determinant(tet.f);
    visit(tet);
  }
}

newton::Elastic neo_hookean() {
  return {.add_gradient =
              [](const Problem& p, const std::vector<double>& z, std::vector<double>& g) {
                const double mu = p.scalar("mu"), lambda = p.scalar("lambda");
                for_each_tet(p, z, [&](const Tet& t) {
                  const Mat3 c = cofactors(t.f);
                  Mat3 stress;
                  for (std::size_t e = 0; e < 9; ++e) {
                    const double inverse = c[e / 3][e % 3] / t.j;
                    stress[e / 3][e % 3] =
                        mu * (t.f[e / 3][e % 3] - inverse) + lambda * std::log(t.j) * inverse;
                  }
                  const Mat3 pull = stress * t.cofactor;  // times 6
                  for (std::size_t k = 0; k < 3; ++k) {
                    for (std::size_t d = 0; d < 3; ++d) {
                      g[t.corner[k + 1] + d] += pull[d][k] / 6;
                      g[t.corner[0] + d] -= pull[d][k] / 6;
                    }
                  }
                });
              },
          .energy =
              [](const Problem& p, const std::vector<double>& z) {
                const double mu = p.scalar("mu"), lambda = p.scalar("lambda");
                double sum = 0;
                for_each_tet(p, z, [&](const Tet& t) {
                  double square = 0;
                  for (const Vec3& row : t.f) square += row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
                  const double log_j = t.j > 0 ? std::log(t.j) : std::numeric_limits<double>::infinity();
                  sum += t.volume6 / 6 * (mu * (0.5 * (square - 3) - log_j) + 0.5 * lambda * log_j * log_j);
                });
                return sum;
              }};
}

Check no_element_turned_over() {
  return count_where({.name = "turned_over",
                      .array = "x_new",
                      .quantity = "tetrahedra with det F <= 0 at x_new",
                      .tolerance = 0,
                      .why = "the energy is infinite there",
                      .needs_truth = false},
                     [](const Judged& j) {
                       const HostArray& x = output(j, "x_new");
                       std::vector<double> z(static_cast<std::size_t>(x.size()));
                       for (std::size_t c = 0; c < z.size(); ++c)
                         z[c] = x.value(static_cast<std::int64_t>(c));
                       std::vector<char> over;
                       for_each_tet(j.problem, z, [&](const Tet& t) { over.push_back(!(t.j > 0)); });
                       const auto count = static_cast<std::int64_t>(over.size());
                       return Items{count, [over = std::move(over)](std::int64_t t) {
                                      return static_cast<double>(over[static_cast<std::size_t>(t)]);
                                    }};
                     });
}

// ---- hard cases ----

TetBody small_block(std::uint64_t seed, double jitter = 0.05) {
  Deformation f = public_field();
  f.seed = seed;
  f.periods = 1;
  f.jitter = jitter;
  return elastic::tet_block({5, 7, 6}, f);
}

InputSet hard(const std::string& stress, const std::string& about, std::function<TetBody()> make,
              Scalars s = {}) {
  return hard_case(stress, about, [=] { return problem_of(make(), s); },
                   {elastic::momentum_check(
                       2e-2, "what tol leaves of the gradient; forces of a tetrahedron add up to zero")});
}

TetBody masses_over_three_decades() {
  TetBody b = small_block(47);
  for (std::size_t i = 0; i < b.mass.size(); ++i) b.mass[i] *= std::pow(10.0, 1.5 * uniform11(47, 70, i));
  return b;
}

TetBody hub() {
  TetBody b = elastic::separate_tets(44, 300, -0.1, 0.1);
  for (auto& tet : b.tets) tet[0] = 0;
  b.mass[0] = 100;
  return b;
}

// Squeezed to a fiftieth along one direction.
TetBody crushed() {
  TetBody b;
  for (std::uint64_t i = 0; i < 101; ++i) {
    const Mat3 f = elastic::random_rotation(41, 63, i) * elastic::diagonal(1, 0.02, 1) *
                   elastic::random_rotation(41, 64, i);
    elastic::add_tet(b, {}, 1, elastic::kIdentity, f, 100, 41, i);
  }
  return b;
}

// At rest, turned by 90 degrees, moving as one by multiples of 2^-4: g(y) = 0 exactly.
TetBody turned() {
  TetBody b = small_block(36, 0);
  for (std::size_t i = 0; i < b.x.size(); ++i) {
    b.x[i] = Mat3{{{0, -1, 0}, {1, 0, 0}, {0, 0, 1}}} * b.rest[i];
    b.v[i] = {1, -2, 0.5};
  }
  return b;
}
Check turned_known() {
  return equals_known(
      {.name = "x_new_known",
       .kind = CheckKind::invariant,
       .array = "x_new",
       .quantity = "x_new - (x + dt v), m",
       .tolerance = 0,
       .why = "D_m and F hold zeros and ones only, so that g(y) = 0 in any precision",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &x = input(j, "x"), &v = input(j, "v");
        std::vector<double> y(static_cast<std::size_t>(x.size()));
        for (std::int64_t c = 0; c < x.size(); ++c)
          y[static_cast<std::size_t>(c)] = x.value(c) + 0.0625 * v.value(c);
        return y;
      },
      1);
}

TetBody loose_vertices() {
  TetBody b = small_block(49);
  for (std::uint64_t i = 0; i < 100; ++i) {
    b.rest.push_back({0, 0, static_cast<double>(i)});
    b.x.push_back({static_cast<double>(i), -0.0, 0});
    b.v.push_back({uniform11(49, 70, i), -0.0, 0});
    b.mass.push_back(1);
  }
  return b;
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto block = [](std::uint64_t seed) { return [seed] { return small_block(seed); }; };
  sets.push_back(hard("loose", "tol = 0.1", block(31), {1e4, 0.3, 0.05, 0.1}));
  sets.push_back(hard("tight", "tol = 2e-4", block(32), {1e4, 0.3, 0.05, 2e-4}));
  sets.push_back(hard("soft_nu_0", "Young's modulus 100 Pa, Poisson's ratio 0, dt = 0.1 s", block(33),
                      {100, 0, 0.1, 1e-3}));
  sets.push_back(hard("nu_0.49", "Poisson's ratio 0.49", block(34), {1e4, 0.49, 0.05, 1e-3}));
  sets.push_back(hard("stiff", "Young's modulus 1e6 Pa, dt = 0.02 s", block(35), {1e6, 0.3, 0.02, 1e-3}));
  sets.push_back(hard("masses", "masses over three decades", masses_over_three_decades));
  sets.push_back(hard("crushed", "separate tetrahedra squeezed to a fiftieth", crushed, {1, 0.3, 0.1, 1e-3}));
  sets.push_back(hard("stretched", "separate tetrahedra, stretches from 0.4 to 2.5",
                      [] { return elastic::separate_tets(42, 201, -0.4, 0.4); }, {100, 0.3, 0.1, 1e-3}));
  sets.push_back(hard("slivers", "dihedral angles of one degree", [] { return elastic::slivers(43, 101); },
                      {100, 0.3, 0.02, 1e-2}));
  sets.push_back(hard("hub_300", "300 tetrahedra have one vertex in common", hub, {100, 0.3, 0.1, 1e-3}));
  sets.push_back(hard("loose_vertices", "100 vertices that belong to no tetrahedron", loose_vertices));
  sets.push_back(hard("turned_90", "a block at rest, turned by 90 degrees, moving as one", turned,
                      {1e4, 0.3, 0.0625, 1e-3}));
  sets.back().use_task_checks = false;
  sets.back().invariants.push_back(turned_known());
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Implicit step of Neo-Hookean tetrahedra by Newton's method";
  t.paper_number = 5;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      block_set("public", SetKind::open, Size::paper, {64, 64, 64}, public_field()),
      block_set("hidden", SetKind::hidden, Size::paper, {64, 64, 64}, hidden_field()),
      block_set("public_smoke", SetKind::open, Size::smoke, {12, 9, 14}, lengthened(public_field())),
      block_set("hidden_smoke", SetKind::hidden, Size::smoke, {10, 13, 11}, lengthened(hidden_field())),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      newton::residual_check(neo_hookean(), 1e-5),
      newton::velocity_check(6e-6),
      newton::local_residual_check(
          neo_hookean(), 0.02,
          "the rms is at most a thousandth; a tetrahedron left out is of the size of one"),
      newton::velocity_units_check(),
      newton::free_particles_check("tets"),
      newton::energy_check(neo_hookean()),
      no_element_turned_over(),
  };
  t.knob = AccuracyKnob{"tol", {1e-1, 1e-2, 1e-3, 2e-4}};
  t.unordered = {{"n", {"tets"}}, {"m", {}}};
  t.target_floor_multiple = 300;
  return t;
}

}  // namespace gpuphys::fem_newtonian_implicit
