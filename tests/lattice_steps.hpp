// What the serial baselines of the lattice tasks, and time loops around any module of theirs, must keep:
// shared by their unit tests (tests/test_<task>_baseline.cpp) and their time loops (tests/time_loops/).
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <string>
#include <vector>

#include "cases/grid_lattice/lattice_inputs.hpp"
#include "core/generators/abc_flow.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// A lattice task, run as one of its modules.
struct LatticeModule {
  std::string task_name;
  int q;
  bool collides, streams;
  std::string label = "baseline_f64";

  const Task& task() const { return find_task(task_name); }
  lattice::Step step() const { return {q, collides, streams, task().contract}; }
  const lattice::VelocitySet& velocities() const { return lattice::velocity_set(q); }
  HostArray run(const Problem& p) const { return std::move(run_module(task(), label, p)[0]); }
};

inline std::int64_t flat_index(const HostArray& f, std::size_t q, std::int64_t i, std::int64_t j,
                               std::int64_t k) {
  return ((static_cast<std::int64_t>(q) * f.shape()[1] + i) * f.shape()[2] + j) * f.shape()[3] + k;
}

/// visit(i, j, k) for every cell.
template <class Visit>
void for_each_cell(const lattice::Grid& g, const Visit& visit) {
  for (std::int64_t i = 0; i < g.nx; ++i) {
    for (std::int64_t j = 0; j < g.ny; ++j) {
      for (std::int64_t k = 0; k < g.nz; ++k) visit(i, j, k);
    }
  }
}

/// The next problem of a time loop: outputs become inputs, rounded to float32 once.
inline void feed_back(const HostArray& out, Problem& p) {
  const auto f = p.inputs[0].as<float>();
  for (std::int64_t i = 0; i < out.size(); ++i)
    f[static_cast<std::size_t>(i)] = static_cast<float>(out.value(i));
}

// ---- one step ----

/// Every population moves by its velocity and wraps. Cells of different densities at rest are equilibria that
/// collision keeps: populations only move.
inline void expect_populations_move(const LatticeModule& module) {
  const lattice::Grid g{3, 4, 5};
  const Problem p = lattice::problem_from(module.step(), g, [&](auto i, auto j, auto k) {
    return lattice::Macroscopic{1.0 + 0.01 * static_cast<double>((i * g.ny + j) * g.nz + k), {0, 0, 0}};
  });
  const HostArray out = module.run(p);
  const lattice::VelocitySet& s = module.velocities();
  for (std::size_t q = 0; q < s.c.size(); ++q) {
    for_each_cell(g, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      const auto a = (i + s.c[q][0] + g.nx) % g.nx, b = (j + s.c[q][1] + g.ny) % g.ny,
                 c = (k + s.c[q][2] + g.nz) % g.nz;
      EXPECT_NEAR(out.value(flat_index(out, q, a, b, c)), p.inputs[0].value(flat_index(out, q, i, j, k)),
                  module.collides ? 1e-7 : 0)
          << q << " " << i << " " << j << " " << k;
    });
  }
}

/// x -> -x, as a grid reversal and an exchange of velocities, gives the mirrored result: any mix-up of
/// directions breaks it.
inline void expect_mirror_symmetry(const LatticeModule& module) {
  const lattice::Grid g{5, 4, 3};
  const lattice::VelocitySet& s = module.velocities();
  const auto image = [&](std::size_t q) {
    const std::array<int, 3> mirrored{-s.c[q][0], s.c[q][1], s.c[q][2]};
    return static_cast<std::size_t>(std::find(s.c.begin(), s.c.end(), mirrored) - s.c.begin());
  };
  const auto mirror = [&](const HostArray& f, const auto& visit) {
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      for_each_cell(g, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
        visit(flat_index(f, q, i, j, k), flat_index(f, image(q), g.nx - 1 - i, j, k));
      });
    }
  };
  const Problem p = lattice::flow_problem(module.step(), g, {21, 1, 0.05, 0.05, 0.25});
  Problem mirrored = p.clone();
  const auto to = mirrored.inputs[0].as<float>();
  const auto from = p.inputs[0].as<float>();
  mirror(p.inputs[0], [&](std::int64_t a, std::int64_t b) {
    to[static_cast<std::size_t>(b)] = from[static_cast<std::size_t>(a)];
  });
  const HostArray x = module.run(p), y = module.run(mirrored);
  mirror(x, [&](std::int64_t a, std::int64_t b) {
    ASSERT_NEAR(x.value(a), y.value(b), module.collides ? 1e-15 : 0);
  });
}

/// A single cell at rest with w more in direction +x, w its weight: rho = 1 + w and u = (w/(1+w), 0, 0). With
/// tau+ = 1 and magic 1/4, tau- = 1 too, and the result is the equilibrium itself. `weights` are those of the
/// specification, by number of non-zero components.
inline void expect_one_cell_by_hand(const LatticeModule& module, const std::array<double, 4>& weights) {
  Problem p = lattice::problem_from(module.step(), {1, 1, 1}, [](auto, auto, auto) {
    return lattice::Macroscopic{1.0, {0, 0, 0}};
  });
  p.set_scalar("tau_plus", 1.0);
  p.set_scalar("magic", 0.25);
  p.inputs[0].as<float>()[1] = static_cast<float>(2 * weights[1]);
  const HostArray out = module.run(p);
  const double rho = 1 + weights[1], u = weights[1] / rho;
  for (std::size_t q = 0; q < module.velocities().c.size(); ++q) {
    const std::array<int, 3> c = module.velocities().c[q];
    const auto kind = static_cast<std::size_t>(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    const double along = c[0] == 0 ? 1 - 1.5 * u * u : 1 + c[0] * 3 * u + 3 * u * u;
    EXPECT_NEAR(out.value(static_cast<std::int64_t>(q)), rho * weights[kind] * along, 1e-7) << q;
  }
}

/// The even and the odd part relax by their own times. Populations of the xy edges are disturbed so that
/// density and momentum stay, hence the equilibrium, and the disturbance shrinks by its own factor.
inline void expect_parts_relax_on_their_own(const LatticeModule& module) {
  const double tau_plus = static_cast<double>(0.6f), tau_minus = 0.5 + 0.1875 / (tau_plus - 0.5);
  constexpr float e = 0x1p-9f;
  // Changes of populations in units of e: the even part by (+,+,-,-), and the odd part of (1,1,0), whose
  // momentum (2e, 2e, 0) is taken back by -2e in x and y, half in each of opposite populations.
  const std::array<float, 11> even{0, 0, 0, 0, 0, 0, 0, e, e, -e, -e},
      odd{0, -e, e, -e, e, 0, 0, e, -e, 0, 0};
  for (const auto& [change, tau] : {std::pair(even, tau_plus), std::pair(odd, tau_minus)}) {
    Problem p = lattice::problem_from(module.step(), {1, 1, 1}, [](auto, auto, auto) {
      return lattice::Macroscopic{1.0, {0, 0, 0}};
    });
    const auto f = p.inputs[0].as<float>();
    for (std::size_t q = 0; q < change.size(); ++q) f[q] += change[q];
    const HostArray out = module.run(p);
    for (std::size_t q = 0; q < change.size(); ++q) {
      EXPECT_NEAR(out.value(static_cast<std::int64_t>(q)) - module.velocities().w[q],
                  static_cast<double>(change[q]) * (1 - 1 / tau), 3e-8)
          << q;
    }
  }
}

/// A uniform moving equilibrium is kept to the rounding of its float32 populations.
inline void expect_equilibrium_kept(const LatticeModule& module) {
  const Problem p = module.task().set("hard_uniform_equilibrium").make();
  const HostArray out = module.run(p);
  for (std::int64_t i = 0; i < out.size(); ++i)
    ASSERT_NEAR(out.value(i), p.inputs[0].value(i), 2e-7 * p.inputs[0].value(i));
}

/// Changing one cell changes the result of that cell and of no other.
inline void expect_cells_apart(const LatticeModule& module) {
  const lattice::Grid g{3, 4, 5};
  Problem p = lattice::flow_problem(module.step(), g, {31, 1, 0.05, 0.05, 0.25});
  const HostArray before = module.run(p);
  for (std::size_t q = 0; q < module.velocities().c.size(); ++q)
    p.inputs[0].as<float>()[static_cast<std::size_t>(flat_index(before, q, 1, 2, 3))] *= 1.5f;
  const HostArray after = module.run(p);
  for (std::size_t q = 0; q < module.velocities().c.size(); ++q) {
    for_each_cell(g, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      const std::int64_t at = flat_index(before, q, i, j, k);
      EXPECT_EQ(after.value(at) != before.value(at), i == 1 && j == 2 && k == 3) << q << " " << i << j << k;
    });
  }
}

/// Streaming, exchanging opposite populations, streaming and exchanging again gives back the input, bitwise.
inline void expect_opposites_invert(const LatticeModule& module) {
  const lattice::Grid g{3, 5, 7};
  const Problem p = lattice::flow_problem(module.step(), g, {17, 1, 0.05, 0.05, 0.3});
  Problem back = p.clone();
  const auto exchange_into_back = [&](const HostArray& f) {
    for (std::size_t q = 0; q < module.velocities().c.size(); ++q) {
      const std::size_t opposite = q == 0 ? 0 : q % 2 == 1 ? q + 1 : q - 1;
      for_each_cell(g, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
        back.inputs[0].as<float>()[static_cast<std::size_t>(flat_index(f, opposite, i, j, k))] =
            static_cast<float>(f.value(flat_index(f, q, i, j, k)));
      });
    }
  };
  exchange_into_back(module.run(p));
  exchange_into_back(module.run(back));
  for (std::int64_t i = 0; i < p.inputs[0].size(); ++i)
    ASSERT_EQ(back.inputs[0].value(i), p.inputs[0].value(i)) << i;
}

// ---- whole grids and many steps ----

/// Mass, momentum and kinetic energy of the whole lattice, and the amplitude of a velocity pattern in it.
struct LatticeTotals {
  double mass = 0, energy = 0, pattern = 0;
  std::array<double, 3> momentum{};
};

inline LatticeTotals lattice_totals(const HostArray& f, const AbcFlow& pattern = {}) {
  const lattice::VelocitySet& s = lattice::velocity_set(static_cast<int>(f.shape()[0]));
  LatticeTotals total;
  double norm = 0;
  for_each_cell(
      {f.shape()[1], f.shape()[2], f.shape()[3]}, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
        double rho = 0;
        std::array<double, 3> momentum{};
        for (std::size_t q = 0; q < s.c.size(); ++q) {
          const double value = f.value(flat_index(f, q, i, j, k));
          rho += value;
          for (std::size_t d = 0; d < 3; ++d) momentum[d] += s.c[q][d] * value;
        }
        const auto u = pattern.at(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k));
        total.mass += rho;
        for (std::size_t d = 0; d < 3; ++d) {
          total.momentum[d] += momentum[d];
          total.energy += 0.5 * momentum[d] * momentum[d] / rho;
          total.pattern += momentum[d] * u[d];
          norm += u[d] * u[d];
        }
      });
  total.pattern /= norm;
  return total;
}

/// Mass and momentum of the whole grid stay, to FP64 rounding.
inline void expect_totals_conserved(const LatticeModule& module) {
  const Problem p = module.task().set("public_smoke").make();
  const LatticeTotals before = lattice_totals(p.inputs[0]), after = lattice_totals(module.run(p));
  EXPECT_NEAR(after.mass / before.mass, 1, 1e-12);
  for (std::size_t d = 0; d < 3; ++d)
    EXPECT_NEAR(after.momentum[d] / before.mass, before.momentum[d] / before.mass, 1e-13);
}

/// Decay rate of a transverse shear wave u_y = U sin(k x) over nu k^2, at the given relaxation.
inline double shear_wave_rate(const LatticeModule& module, std::int64_t n, double tau_plus, double magic,
                              int steps) {
  const double k = 2 * std::numbers::pi / static_cast<double>(n), amplitude = 1e-3;
  Problem p = lattice::problem_from(module.step(), {n, 1, 1}, [&](auto i, auto, auto) {
    return lattice::Macroscopic{1.0, {0, amplitude * std::sin(k * static_cast<double>(i)), 0}};
  });
  p.set_scalar("tau_plus", tau_plus);
  p.set_scalar("magic", magic);
  const auto amplitude_of = [&] {
    double sum = 0;
    for (std::size_t q = 0; q < module.velocities().c.size(); ++q) {
      for (std::int64_t i = 0; i < n; ++i) {
        sum += module.velocities().c[q][1] * p.inputs[0].value(static_cast<std::int64_t>(q) * n + i) *
               std::sin(k * static_cast<double>(i));
      }
    }
    return sum;
  };
  // The first steps set up the non-equilibrium part.
  for (int t = 0; t < 20; ++t) feed_back(module.run(p), p);
  const double start = amplitude_of();
  for (int t = 0; t < steps; ++t) feed_back(module.run(p), p);
  return std::log(start / amplitude_of()) / steps / ((tau_plus - 0.5) / 3 * k * k);
}

/// A shear wave decays with the viscosity of tau_plus; the error of the rate is of second order in k.
inline void expect_viscosity_of_tau_plus(const LatticeModule& module) {
  const double coarse = shear_wave_rate(module, 16, 0.8, 0.1875, 40) - 1,
               fine = shear_wave_rate(module, 32, 0.8, 0.1875, 40) - 1;
  EXPECT_LT(std::abs(fine), 0.01);
  EXPECT_GT(std::abs(coarse), 3 * std::abs(fine));
}

/// 100 steps of an ABC flow on a cube, an exact solution of the Navier-Stokes equations that only decays, and
/// 200 steps from noisy populations at a viscosity of 1/300 lattice units, which must stay bounded.
inline void expect_plausible_flow(const LatticeModule& module) {
  {
    constexpr int n = 22, steps = 100;
    const AbcFlow flow = AbcFlow::periodic(0.05 / 3, 1, {n, n, n});
    Problem p = lattice::problem_from(module.step(), {n, n, n}, [&](auto i, auto j, auto k) {
      return lattice::Macroscopic{
          1.0, flow.at(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k))};
    });
    const LatticeTotals before = lattice_totals(p.inputs[0], flow);
    ASSERT_NEAR(before.pattern, 1, 1e-6);
    for (int t = 0; t < steps; ++t) feed_back(module.run(p), p);
    const LatticeTotals after = lattice_totals(p.inputs[0], flow);
    // Float32 weights sum to 1 within 2e-8, which a step multiplies by the relaxation rate; the sums of a
    // cell add their rounding.
    EXPECT_NEAR(after.mass / before.mass, 1, 1e-7 * steps);
    for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(after.momentum[d] / before.mass, 0, 1e-6) << "axis " << d;
    // |u| falls as exp(-nu k^2 t); the lattice's own error of second order in k is a few percent of the rate.
    const double k = 2 * std::numbers::pi / n, nu = (lattice::kTauPlus - 0.5) / 3;
    const double rate = -std::log(after.pattern) / steps;
    EXPECT_NEAR(rate / (nu * k * k), 1, 0.03) << "decay rate " << rate;
  }
  {
    Problem p = lattice::flow_problem(module.step(), {18, 14, 22}, {3, 1, 0.05, 0.05, 0.05});
    p.set_scalar("tau_plus", 0.51);
    const LatticeTotals before = lattice_totals(p.inputs[0]);
    for (int t = 0; t < 200; ++t) feed_back(module.run(p), p);
    const LatticeTotals after = lattice_totals(p.inputs[0]);
    EXPECT_NEAR(after.mass / before.mass, 1, 1e-7 * 200);
    for (std::size_t d = 0; d < 3; ++d)
      EXPECT_NEAR((after.momentum[d] - before.momentum[d]) / before.mass, 0, 1e-6) << "axis " << d;
    // No driving: kinetic energy may only be exchanged with the sound waves that the initial density sets
    // off, whose energy c_s^2 (drho)^2 / 2 is of the same order.
    EXPECT_LT(after.energy, 2 * before.energy);
    EXPECT_TRUE(std::isfinite(after.energy));
    for (std::int64_t i = 0; i < p.inputs[0].size(); ++i) ASSERT_GT(p.inputs[0].value(i), 0) << i;
  }
}

/// 100 collisions without streaming: every cell ends at the equilibrium of the density and velocity that it
/// began with.
inline void expect_relaxation_to_equilibrium(const LatticeModule& module) {
  const lattice::Grid g{9, 7, 13};
  Problem p = lattice::flow_problem(module.step(), g, {4, 1, 0.05, 0.05, 0.25});
  const HostArray start = p.inputs[0].clone();
  for (int t = 0; t < 100; ++t) feed_back(module.run(p), p);
  const lattice::VelocitySet& s = module.velocities();
  for_each_cell(g, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
    lattice::Macroscopic m{0, {0, 0, 0}};
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      const double value = start.value(flat_index(start, q, i, j, k));
      m.density += value;
      for (std::size_t d = 0; d < 3; ++d) m.u[d] += s.c[q][d] * value;
    }
    for (double& u : m.u) u /= m.density;
    // Each step rounds density and momentum by some units of 2^-24, at random.
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      ASSERT_NEAR(p.inputs[0].value(flat_index(start, q, i, j, k)), lattice::equilibrium(s, q, m), 5e-6)
          << q << " " << i << " " << j << " " << k;
    }
  });
}

/// 96 steps of streaming on grids whose extents divide 12 bring every population back, bitwise; the
/// populations of every direction are the same all the time.
inline void expect_streaming_returns(const LatticeModule& module) {
  for (const lattice::Grid& g : {lattice::Grid{4, 6, 3}, lattice::Grid{3, 4, 12}}) {
    Problem p = lattice::flow_problem(module.step(), g, {7, 1, 0.05, 0.05, 0.3});
    const HostArray start = p.inputs[0].clone();
    const auto sorted = [&](const HostArray& f, std::size_t q) {
      const auto all = f.as<float>();
      const auto cells = static_cast<std::ptrdiff_t>(g.nx * g.ny * g.nz);
      std::vector<float> values(all.begin() + static_cast<std::ptrdiff_t>(q) * cells,
                                all.begin() + static_cast<std::ptrdiff_t>(q + 1) * cells);
      std::sort(values.begin(), values.end());
      return values;
    };
    for (int t = 0; t < 96; ++t) {
      feed_back(module.run(p), p);
      if (t % 16 != 0) continue;
      for (std::size_t q = 0; q < module.velocities().c.size(); ++q)
        EXPECT_EQ(sorted(p.inputs[0], q), sorted(start, q)) << "direction " << q << ", step " << t;
    }
    for (std::int64_t i = 0; i < start.size(); ++i) ASSERT_EQ(p.inputs[0].value(i), start.value(i)) << i;
  }
}

}  // namespace gpuphys::testing
