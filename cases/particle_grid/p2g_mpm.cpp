// Input sets and checks of p2g_mpm (specification: cases/particle_grid/p2g_mpm.md).
#include "cases/particle_grid/p2g_mpm.hpp"

#include <fmt/format.h>

#include <cmath>
#include <functional>

#include "cases/particle_grid/particle_blocks.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/checks.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::p2g_mpm {
namespace {

using particle_blocks::diagonal;
using particle_blocks::Mat3;
using particle_blocks::product;
using particle_blocks::random_rotation;
using particle_blocks::transposed;
using particle_blocks::Vec3;
using Cells = std::array<std::int64_t, 3>;

constexpr double kDx = 0x1p-8, kDt = 5e-5, kDensity = 400, kYoung = 1.4e5, kPoisson = 0.2;
constexpr int kModes = 16, kMaxWaveNumber = 6;
constexpr double kNoise = 0.1;
constexpr double kTolerance = 1e-5, kLocalTolerance = 2e-4;
const std::array<std::string, 3> kNames{"ux", "uy", "uz"};

Problem empty_problem(const Cells& nodes, std::int64_t n) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(),
                           {{"n", n}, {"nx", nodes[0]}, {"ny", nodes[1]}, {"nz", nodes[2]}});
  const double volume = kDx * kDx * kDx / 8;
  p.set_scalar("dx", kDx);
  p.set_scalar("dt", kDt);
  p.set_scalar("V0", volume);
  p.set_scalar("mass_p", kDensity * volume);
  p.set_scalar("mu", kYoung / (2 * (1 + kPoisson)));
  p.set_scalar("lambda", kYoung * kPoisson / ((1 + kPoisson) * (1 - 2 * kPoisson)));
  return p;
}

Problem ball_problem(const Cells& nodes, double radius, std::uint64_t seed, double period, double jitter) {
  const auto particles = particle_blocks::ball(nodes, radius);
  const auto n = static_cast<std::int64_t>(particles.size());
  Problem p = empty_problem(nodes, n);
  const auto order = particle_blocks::random_order(n, seed);
  const auto x = p.inputs[0].as<float>();
  for (std::size_t q = 0; q < order.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d) x[3 * q + d] = particles[order[q]][d] * static_cast<float>(kDx);
  }
  particle_blocks::fill_velocity(p.inputs[0], seed, kModes, kMaxWaveNumber, period, kNoise, p.inputs[1]);
  particle_blocks::fill_deformation(seed, jitter, p.inputs[2]);
  return p;
}

InputSet ball_set(const std::string& name, SetKind kind, Size size, const Cells& nodes, double radius,
                  std::uint64_t seed, double period, double jitter) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "a ball of radius {:.4g} cells in {} x {} x {} nodes, 8 particles a cell in random order, F = I + {} "
      "U, "
      "seed {}",
      radius, nodes[0], nodes[1], nodes[2], jitter, seed);
  s.make = [=] { return ball_problem(nodes, radius, seed, period, jitter); };
  return s;
}

/// A problem with every particle given by position (in cells), velocity and deformation gradient.
struct Particle {
  Vec3 cell;
  Vec3 v;
  Mat3 f;
};

Problem problem_from(const Cells& nodes, std::int64_t n, const std::function<Particle(std::uint64_t)>& make) {
  Problem p = empty_problem(nodes, n);
  for (std::int64_t q = 0; q < n; ++q) {
    const Particle particle = make(static_cast<std::uint64_t>(q));
    const auto item = static_cast<std::size_t>(q);
    for (std::size_t a = 0; a < 3; ++a) {
      p.inputs[0].as<float>()[3 * item + a] = static_cast<float>(particle.cell[a] * kDx);
      p.inputs[1].as<float>()[3 * item + a] = static_cast<float>(particle.v[a]);
      for (std::size_t b = 0; b < 3; ++b)
        p.inputs[2].as<float>()[9 * item + 3 * a + b] = static_cast<float>(particle.f[a][b]);
    }
  }
  return p;
}

Vec3 random_vector(std::uint64_t seed, std::uint64_t stream, std::uint64_t item) {
  return {uniform11(seed, stream, 3 * item), uniform11(seed, stream, 3 * item + 1),
          uniform11(seed, stream, 3 * item + 2)};
}

/// Uniform in the box from `low` to `high` (in cells).
Vec3 random_point(std::uint64_t seed, std::uint64_t item, const Vec3& low, const Vec3& high) {
  Vec3 x;
  for (std::size_t d = 0; d < 3; ++d) x[d] = low[d] + (high[d] - low[d]) * uniform01(seed, 1, 3 * item + d);
  return x;
}

/// Q1 diag(s) Q2^T with random rotations.
Mat3 stretched(std::uint64_t seed, std::uint64_t item, double a, double b, double c) {
  return product(product(random_rotation(seed, 2 * item), diagonal(a, b, c)),
                 transposed(random_rotation(seed, 2 * item + 1)));
}

Mat3 jittered_identity(std::uint64_t seed, std::uint64_t item, double jitter) {
  Mat3 f = diagonal(1, 1, 1);
  for (std::size_t e = 0; e < 9; ++e) f[e / 3][e % 3] += jitter * uniform11(seed, 3, 9 * item + e);
  return f;
}

// ---- invariants ----

// Calls body(name, output, index) for every value of the three components until it returns false.
template <class Body>
void for_each_value(const Judged& j, Body&& body) {
  for (const std::string& name : kNames) {
    const HostArray& u = find(j.outputs, name, "outputs");
    for (std::int64_t i = 0; i < u.size(); ++i) {
      if (!body(u, i)) return;
    }
  }
}

Check all_finite() {
  return {"finite",
          CheckKind::invariant,
          "ux, uy, uz",
          "number of non-finite values",
          0,
          "finite particles give every node finite momentum, and a node with mass a finite velocity",
          false,
          [](const Judged& j) {
            Measured m;
            for_each_value(j, [&](const HostArray& u, std::int64_t i) {
              if (std::isfinite(u.value(i))) return true;
              if (m.error == 0) m.detail = fmt::format("first at {}", index_text(u, i));
              ++m.error;
              return true;
            });
            return m;
          }};
}

Check all_zero() {
  return {"exactly_zero",
          CheckKind::invariant,
          "ux, uy, uz",
          "number of values that are not 0",
          0,
          "a node that no particle reaches has velocity exactly 0",
          false,
          [](const Judged& j) {
            Measured m;
            for_each_value(j, [&](const HostArray& u, std::int64_t i) {
              if (u.value(i) == 0) return true;
              if (m.error == 0) m.detail = fmt::format("first at {}: {}", index_text(u, i), u.value(i));
              ++m.error;
              return true;
            });
            return m;
          }};
}

// Nodes that carry no mass in the truth must be exactly zero, the others not all zero at once.
Check empty_nodes_are_zero() {
  return {"support",
          CheckKind::invariant,
          "ux, uy, uz",
          "number of nodes whose value is exactly 0 in one of truth and result only",
          0,
          "whether a node has mass follows from exact positions: dx is a power of two",
          true,
          [](const Judged& j) {
            Measured m;
            const auto is_zero = [](const Arrays& u, std::int64_t i) {
              return u[0].value(i) == 0 && u[1].value(i) == 0 && u[2].value(i) == 0;
            };
            for (std::int64_t i = 0; i < j.outputs[0].size(); ++i) {
              if (is_zero(j.outputs, i) == is_zero(*j.truth, i)) continue;
              if (m.error == 0) m.detail = fmt::format("first at {}", index_text(j.outputs[0], i));
              ++m.error;
            }
            return m;
          }};
}

/// Every node that carries mass moves with `velocity`: particles that share it and exert no force.
Check moves_with(const Vec3& velocity, double tolerance, const std::string& why) {
  return {"uniform_motion",
          CheckKind::invariant,
          "ux, uy, uz",
          "largest |u - v| over nodes that are not exactly 0, m/s",
          tolerance,
          why,
          false,
          [=](const Judged& j) {
            Measured m;
            bool any = false;
            for (std::size_t c = 0; c < 3; ++c) {
              const HostArray& u = find(j.outputs, kNames[c], "outputs");
              for (std::int64_t i = 0; i < u.size(); ++i) {
                if (u.value(i) == 0) continue;
                any = true;
                const double e = std::abs(u.value(i) - velocity[c]);
                if (!(e <= m.error)) m = {e, fmt::format("{} = {:.9g}", index_text(u, i), u.value(i))};
                if (!std::isfinite(e)) return m;
              }
            }
            if (!any) m = {INFINITY, "no node moves"};
            return m;
          }};
}

Check error_over_largest(double tolerance, const std::string& why) {
  return {
      "error_over_largest",
      CheckKind::invariant,
      "ux, uy, uz",
      "largest error / largest |u|",
      tolerance,
      why,
      true,
      [](const Judged& j) {
        double scale = 0;
        for (const HostArray& u : *j.truth) {
          for (std::int64_t i = 0; i < u.size(); ++i) scale = std::max(scale, std::abs(u.value(i)));
        }
        Measured m;
        for_each_value(j, [&](const HostArray& u, std::int64_t i) {
          const double expected = find(*j.truth, u.name(), "truth").value(i);
          const double e = std::abs(u.value(i) - expected) / scale;
          if (!(e <= m.error))
            m = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(u, i), u.value(i), expected)};
          return std::isfinite(e);
        });
        return m;
      }};
}

// ---- hard cases ----

InputSet hard(const std::string& stress, const std::string& about, std::function<Problem()> make,
              std::vector<Check> invariants, bool use_task_checks = true) {
  invariants.push_back(all_finite());
  return hard_case(stress, about, std::move(make), std::move(invariants), use_task_checks);
}

// A quarter of a cell away from node planes and half-way planes, as in the paper's sets, at random places.
Vec3 lattice_point(std::uint64_t seed, std::uint64_t item, const Cells& low, const Cells& high) {
  Vec3 x;
  for (std::size_t d = 0; d < 3; ++d) {
    const double room = 2.0 * static_cast<double>(high[d] - low[d]);
    x[d] = static_cast<double>(low[d]) + 0.25 + 0.5 * std::floor(room * uniform01(seed, 1, 3 * item + d));
  }
  return x;
}

// Another material, step and spacing (a power of two); places are kept in cells.
struct Material {
  double dx, dt, density, volume_per_cell, young, poisson;
};
Problem made_of(Problem p, const Material& m) {
  const double volume = m.volume_per_cell * m.dx * m.dx * m.dx;
  for (float& x : p.inputs[0].as<float>()) x *= static_cast<float>(m.dx / kDx);
  p.set_scalar("dx", m.dx);
  p.set_scalar("dt", m.dt);
  p.set_scalar("V0", volume);
  p.set_scalar("mass_p", m.density * volume);
  p.set_scalar("mu", m.young / (2 * (1 + m.poisson)));
  p.set_scalar("lambda", m.young * m.poisson / ((1 + m.poisson) * (1 - 2 * m.poisson)));
  return p;
}

std::vector<Check> tight() {
  std::vector<Check> checks;
  for (const std::string& name : kNames)
    checks.push_back(as_invariant(relative_l2_check(name, 0, ""), name + "_rel_l2_tight", 3e-6,
                                  "a few thousand particles: the FP32 baseline stays below 5e-7"));
  return checks;
}

InputSet material_set(const std::string& stress, const std::string& about, std::uint64_t seed, double jitter,
                      const Material& material) {
  return hard(
      stress, about,
      [=] {
        return made_of(problem_from({15, 13, 18}, 4001,
                                    [=](std::uint64_t q) {
                                      return Particle{lattice_point(seed, q, {2, 2, 2}, {12, 10, 15}),
                                                      random_vector(seed, 4, q),
                                                      jittered_identity(seed, q, jitter)};
                                    }),
                       material);
      },
      tight());
}

// Particles near both ends of an axis with more nodes than 16 bits count.
InputSet long_axis_set(std::size_t axis) {
  Cells nodes{3, 4, 5};
  nodes[axis] = 70001;
  return hard(
      fmt::format("long_{}", "xyz"[axis]), "more nodes along an axis than 16 bits count",
      [=] {
        return problem_from(nodes, 601, [=](std::uint64_t q) {
          Vec3 x = lattice_point(50 + axis, q, {0, 0, 0}, {2, 3, 4});
          const double ends[] = {0.0, 65533.0, 69996.0};
          x[axis] = ends[q % 3] + 0.25 + 0.5 * std::floor(8 * uniform01(50 + axis, 5, q));
          return Particle{x, random_vector(50 + axis, 4, q), jittered_identity(50 + axis, q, 0.05)};
        });
      },
      {empty_nodes_are_zero(),
       error_over_largest(5e-5,
                          "a hundred units for the stress of a node that owns a corner of one particle")},
      false);
}

std::vector<InputSet> hard_cases() {
  constexpr Vec3 drift{1.5, -0.75, 0.5};
  std::vector<InputSet> sets;
  sets.push_back(hard(
      "rigid_rotation", "every particle rotated by its own random rotation, all moving alike: no force",
      [=] {
        return problem_from({18, 21, 16}, 9001, [=](std::uint64_t q) {
          return Particle{lattice_point(31, q, {2, 2, 2}, {15, 18, 13}), drift, random_rotation(31, q)};
        });
      },
      {moves_with(
          drift, 2e-4,
          "1e-5 of the speed of sound (19.7 m/s): a rotation rounded to float32 is off by 1e-7, which "
          "2 mu dt / (rho dx) = 3.7 m/s and the largest |grad w| / w of 8 per cell turn into some 1e-6")}));
  sets.push_back(hard(
      "inverted", "det F < 0: singular values 1.2, 0.9 and -0.4 in random directions; R must stay a rotation",
      [] {
        return problem_from({18, 14, 20}, 7003, [](std::uint64_t q) {
          return Particle{lattice_point(32, q, {2, 2, 2}, {15, 11, 17}), random_vector(32, 4, q),
                          stretched(32, q, 1.2, 0.9, -0.4)};
        });
      },
      {empty_nodes_are_zero()}));
  sets.push_back(hard("compressed", "F = 0.05 Q, Q a random rotation",
                      [] {
                        return problem_from({14, 14, 17}, 5003, [](std::uint64_t q) {
                          return Particle{lattice_point(33, q, {2, 2, 2}, {11, 11, 14}),
                                          random_vector(33, 4, q), stretched(33, q, 0.05, 0.05, 0.05)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(hard("stretched", "F = 20 Q, Q a random rotation: stresses of 1e12 Pa",
                      [] {
                        return problem_from({14, 17, 14}, 5003, [](std::uint64_t q) {
                          return Particle{lattice_point(34, q, {2, 2, 2}, {11, 14, 11}),
                                          random_vector(34, 4, q), stretched(34, q, 20, 20, 20)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(hard("near_singular",
                      "one or two singular values of F between 0 and 1e-2, either sign of det F: flat and "
                      "needle-like particles",
                      [] {
                        return problem_from({14, 17, 20}, 6007, [](std::uint64_t q) {
                          constexpr std::array<double, 8> thin{1e-2, 1e-4, -1e-3, 1e-6, 0, -1e-5, 1e-3, 1e-7};
                          const double s = thin[q % 8];
                          // Needles only with det F > 0: with det F < 0 the two thin values must differ
                          // (specification).
                          const bool needle = q % 16 >= 8 && s > 0;
                          return Particle{lattice_point(35, q, {2, 2, 2}, {11, 14, 17}),
                                          random_vector(35, 4, q),
                                          stretched(35, q, 1.1, needle ? 1.5 * s : 0.8, s)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(hard(
      "one_cell_1e5", "100,003 particles in one cell: one list, 27 nodes",
      [] {
        return problem_from({9, 10, 11}, 100003, [](std::uint64_t q) {
          const Vec3 x = random_point(36, q, {3.55, 4.55, 5.55}, {4.45, 5.45, 6.45});
          return Particle{x, random_vector(36, 4, q), jittered_identity(36, q, 0.05)};
        });
      },
      {error_over_largest(3e-4,
                          "a running float32 sum of 1e5 terms wanders by sqrt(1e5) units of 2^-24 = 2e-5 of "
                          "itself; sums in parts do better"),
       empty_nodes_are_zero()},
      false));
  sets.push_back(
      hard("array_edge",
           "particles up to three cells outside the array on every side: what falls outside is dropped",
           [] {
             return problem_from({17, 9, 13}, 20011, [](std::uint64_t q) {
               Vec3 x = random_point(37, q, {-12, -12, -12}, {76, 44, 60});
               for (double& c : x) c = std::floor(c) / 4 + 0.125;  // an eighth of a cell from every break
               return Particle{x, random_vector(37, 4, q), jittered_identity(37, q, 0.05)};
             });
           },
           {empty_nodes_are_zero()}));
  sets.push_back(hard("mass_12_decades",
                      "sparse particles at random places: node masses over more than 12 decades",
                      [=] {
                        return problem_from({26, 29, 31}, 1201, [=](std::uint64_t q) {
                          // Multiples of 2^-12 cells, off the breaks by an odd 2^-13: smallest weight
                          // (2^-27)^3.
                          Vec3 x = random_point(38, q, {1, 1, 1}, {24, 27, 29});
                          for (double& c : x) c = std::floor(c * 0x1p12) * 0x1p-12 + 0x1p-13;
                          return Particle{x, random_vector(38, 4, q), diagonal(1, 1, 1)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(material_set("soft_and_heavy",
                              "dx = 1/8 m, dt = 1 ms, 2600 kg/m^3, 300 kPa, Poisson's ratio 0.4", 41, 0.05,
                              {0.125, 1e-3, 2600, 0.2, 3e5, 0.4}));
  sets.push_back(material_set("stiff_and_light",
                              "dx = 2 m, dt = 0.2 ms, 1.25 kg/m^3, 20 MPa, Poisson's ratio 0.05", 42, 0.07,
                              {2, 2e-4, 1.25, 0.11, 2e7, 0.05}));
  sets.push_back(
      material_set("small_strain", "F = I + 0.003 U, 100 kPa", 43, 3e-3, {kDx, 3e-5, 431, 0.15, 1e5, 0.31}));
  sets.push_back(hard("lone_particles",
                      "particles out of each other's reach, 2^-8 to 2^-12 cells off a break of the spline",
                      [] {
                        return problem_from({41, 33, 25}, 8 * 6 * 4, [](std::uint64_t q) {
                          const double site[3] = {static_cast<double>(q % 8), static_cast<double>(q / 8 % 6),
                                                  static_cast<double>(q / 48)};
                          Vec3 x;
                          for (std::size_t d = 0; d < 3; ++d) {
                            const double off = std::ldexp(1.0, -8 - static_cast<int>((q + d) % 5));
                            x[d] = 2.5 + 5 * site[d] + (q >> d & 1 ? off : -off);
                          }
                          return Particle{x, random_vector(44, 4, q), jittered_identity(44, q, 0.02)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(hard("stretched_1e4", "F = 1e4 Q, Q a random rotation: the largest that is valid",
                      [] {
                        return problem_from({12, 11, 15}, 3001, [](std::uint64_t q) {
                          return Particle{lattice_point(45, q, {2, 2, 2}, {9, 8, 12}),
                                          random_vector(45, 4, q), stretched(45, q, 9e3, 9e3, 9e3)};
                        });
                      },
                      {empty_nodes_are_zero()}));
  sets.push_back(hard(
      "at_rest", "no strain, velocities of 0 and -0",
      [] {
        return problem_from({9, 8, 7}, 1003, [](std::uint64_t q) {
          return Particle{lattice_point(46, q, {1, 1, 1}, {7, 6, 5}), {0.0, -0.0, 0.0}, diagonal(1, 1, 1)};
        });
      },
      {all_zero()}));
  for (const std::size_t axis : {std::size_t{0}, std::size_t{1}, std::size_t{2}})
    sets.push_back(long_axis_set(axis));
  sets.push_back(hard("all_outside",
                      "every particle beyond the reach of the array, some by 1e4 and by 1e30 m",
                      [] {
                        return problem_from({8, 6, 7}, 257, [](std::uint64_t q) {
                          constexpr std::array<double, 6> far{-1.75, 1e6, -3e6, 2.56e32, -2.56e32, 9.75};
                          Vec3 x{3.25, 2.25, 3.75};
                          x[q % 3] = far[q % 6];
                          return Particle{x, random_vector(39, 4, q), diagonal(1, 1, 1)};
                        });
                      },
                      {all_zero()}));
  sets.push_back(
      hard("one_particle",
           "a single particle in an array of one node along y: every node it reaches moves with it",
           [=] {
             return problem_from({5, 1, 3}, 1, [=](std::uint64_t) {
               return Particle{{2.25, 0.125, 0.875}, drift, diagonal(1, 1, 1)};
             });
           },
           {moves_with(drift, 1e-6, "quotient of two sums of one term: a few units in the last place"),
            empty_nodes_are_zero()}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Particle-to-grid transfer of momentum and elastic forces (MPM, quadratic B-splines)";
  t.paper_number = 33;
  t.contract = describe<Inputs, Outputs<float>>();
  t.unordered = {{"n", {}}};
  t.sets = {
      // Radius as a fraction of the width: 16,862,656 particles.
      ball_set("public", SetKind::open, Size::paper, {256, 256, 256}, 0.3107 * 256, 1, 1.0, 0.05),
      ball_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, 0.3107 * 256, 2, 1.0, 0.06),
      ball_set("public_smoke", SetKind::open, Size::smoke, {37, 34, 45}, 10.3, 1, 64 * kDx, 0.05),
      ball_set("hidden_smoke", SetKind::hidden, Size::smoke, {33, 42, 38}, 10.1, 2, 64 * kDx, 0.06),
  };
  for (InputSet& s : hard_cases()) t.sets.push_back(std::move(s));
  for (const std::string& name : kNames) {
    t.checks.push_back(relative_l2_check(name, kTolerance, "the paper's table of inputs and checks"));
    t.checks.push_back(local_error_check(name, kLocalTolerance,
                                         "the paper allows 1e-5 of the rms on average; at the surface the "
                                         "largest |grad w| / w of 8 per cell times "
                                         "2 mu dt / (rho dx) = 3.7 m/s turns the 1e-7 of a float32 rotation "
                                         "into 3e-6 m/s a particle, some 3e-5 "
                                         "of the rms over all nodes (seven in eight are empty) for a few "
                                         "particles; the margin is for the largest "
                                         "of millions"));
  }
  t.target_floor_multiple = 3.5;
  return t;
}

}  // namespace gpuphys::p2g_mpm
