// 100 steps of an explicit MPM simulation around one module of p2g_mpm: an elastic ball, set spinning and
// stretched, in free flight. The way back from the grid is done here, in FP64 and plain PIC.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <string>

#include "cases/particle_grid/particle_blocks.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

namespace p2g_mpm_loop {

using particle_blocks::Mat3;
using particle_blocks::Vec3;

inline double determinant(const Mat3& f) {
  return f[0][0] * (f[1][1] * f[2][2] - f[1][2] * f[2][1]) -
         f[0][1] * (f[1][0] * f[2][2] - f[1][2] * f[2][0]) +
         f[0][2] * (f[1][0] * f[2][1] - f[1][1] * f[2][0]);
}

/// Orthogonal polar factor of a matrix with positive determinant: X <- (X + X^-T) / 2.
inline Mat3 rotation_of(Mat3 x) {
  for (int step = 0; step < 30; ++step) {
    const double det = determinant(x);
    Mat3 next{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        const std::size_t i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
        next[i][j] = 0.5 * (x[i][j] + (x[i1][j1] * x[i2][j2] - x[i1][j2] * x[i2][j1]) / det);
      }
    }
    x = next;
  }
  return x;
}

/// Energy density mu |F - R|^2 + lambda/2 (J - 1)^2 (Stomakhin et al. 2012).
inline double energy_density(const Mat3& f, double mu, double lambda) {
  const Mat3 r = rotation_of(f);
  double square = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) square += (f[i][j] - r[i][j]) * (f[i][j] - r[i][j]);
  }
  const double change = determinant(f) - 1;
  return mu * square + 0.5 * lambda * change * change;
}

struct Totals {
  Vec3 momentum{};
  double elastic = 0, kinetic = 0;
};

inline Mat3 deformation(const Problem& p, std::int64_t q) {
  Mat3 f;
  for (std::size_t e = 0; e < 9; ++e)
    f[e / 3][e % 3] = p.inputs[2].value(9 * q + static_cast<std::int64_t>(e));
  return f;
}

inline Totals totals(const Problem& p) {
  Totals t;
  const double mass = p.scalar("mass_p");
  for (std::int64_t q = 0; q < p.inputs[0].shape()[0]; ++q) {
    for (std::int64_t d = 0; d < 3; ++d) {
      const double v = p.inputs[1].value(3 * q + d);
      t.momentum[static_cast<std::size_t>(d)] += mass * v;
      t.kinetic += 0.5 * mass * v * v;
    }
    t.elastic += p.scalar("V0") * energy_density(deformation(p, q), p.scalar("mu"), p.scalar("lambda"));
  }
  return t;
}

/// v <- sum w u, F <- (I + dt sum u grad w^T) F, x <- x + dt v.
inline void back_to_particles(const Arrays& u, Problem& p) {
  const double dx = p.scalar("dx"), dt = p.scalar("dt");
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>(), f = p.inputs[2].as<float>();
  const Shape& n = u[0].shape();
  for (std::size_t q = 0; q < x.size() / 3; ++q) {
    std::array<std::int64_t, 3> base;
    std::array<std::array<double, 3>, 3> w, slope;
    for (std::size_t d = 0; d < 3; ++d) {
      const double g = static_cast<double>(x[3 * q + d]) / dx;
      base[d] = static_cast<std::int64_t>(std::llround(g)) - 1;
      for (std::size_t o = 0; o < 3; ++o) {
        // The spline as a function of the distance to the node.
        const double r = g - static_cast<double>(base[d] + static_cast<std::int64_t>(o)), a = std::abs(r);
        w[d][o] = a < 0.5 ? 0.75 - a * a : 0.5 * (1.5 - a) * (1.5 - a);
        slope[d][o] = (a < 0.5 ? -2 * r : (r > 0 ? a - 1.5 : 1.5 - a)) / dx;
      }
    }
    Vec3 velocity{};
    Mat3 gradient{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t k = 0; k < 3; ++k) {
          const std::int64_t at =
              ((base[0] + static_cast<std::int64_t>(i)) * n[1] + base[1] + static_cast<std::int64_t>(j)) *
                  n[2] +
              base[2] + static_cast<std::int64_t>(k);
          const Vec3 node{u[0].value(at), u[1].value(at), u[2].value(at)};
          const Vec3 grad{slope[0][i] * w[1][j] * w[2][k], w[0][i] * slope[1][j] * w[2][k],
                          w[0][i] * w[1][j] * slope[2][k]};
          for (std::size_t a = 0; a < 3; ++a) {
            velocity[a] += w[0][i] * w[1][j] * w[2][k] * node[a];
            for (std::size_t b = 0; b < 3; ++b) gradient[a][b] += node[a] * grad[b];
          }
        }
      }
    }
    Mat3 step = gradient;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) step[a][b] = (a == b ? 1.0 : 0.0) + dt * gradient[a][b];
    }
    const Mat3 next = particle_blocks::product(step, deformation(p, static_cast<std::int64_t>(q)));
    for (std::size_t a = 0; a < 3; ++a) {
      v[3 * q + a] = static_cast<float>(velocity[a]);
      x[3 * q + a] = static_cast<float>(static_cast<double>(x[3 * q + a]) + dt * velocity[a]);
      for (std::size_t b = 0; b < 3; ++b) f[9 * q + 3 * a + b] = static_cast<float>(next[a][b]);
    }
  }
}

inline Problem spinning_ball() {
  const Task& task = find_task("p2g_mpm");
  const Shape nodes{22, 22, 22};
  const auto particles = particle_blocks::ball({22, 22, 22}, 5.2);
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                           {"nx", nodes[0]},
                                           {"ny", nodes[1]},
                                           {"nz", nodes[2]}});
  const Problem like = task.set("public_smoke").make();
  for (const char* name : {"dx", "dt", "mass_p", "V0", "mu", "lambda"}) p.set_scalar(name, like.scalar(name));
  const double dx = p.scalar("dx");
  for (std::size_t q = 0; q < particles.size(); ++q) {
    const Vec3 r{particles[q][0] - 11.0, particles[q][1] - 11.0, particles[q][2] - 11.0};  // cells
    // A drift, a spin of 0.2 m/s a cell about z, and a uniform stretch by 3 % along x.
    const Vec3 v{1.0 - 0.2 * r[1], -0.5 + 0.2 * r[0], 0.25};
    const Mat3 f = particle_blocks::diagonal(1.03, 0.99, 1.0);
    for (std::size_t a = 0; a < 3; ++a) {
      p.inputs[0].as<float>()[3 * q + a] = static_cast<float>(static_cast<double>(particles[q][a]) * dx);
      p.inputs[1].as<float>()[3 * q + a] = static_cast<float>(v[a]);
      for (std::size_t b = 0; b < 3; ++b)
        p.inputs[2].as<float>()[9 * q + 3 * a + b] = static_cast<float>(f[a][b]);
    }
  }
  return p;
}

}  // namespace p2g_mpm_loop

/// Momentum is kept, the energy only falls (PIC damps, explicit steps of a quarter of the limit do not pump),
/// and the elastic energy stays a bounded oscillation.
inline void time_loop_p2g_mpm(const std::string& label) {
  const Task& task = find_task("p2g_mpm");
  Problem p = p2g_mpm_loop::spinning_ball();
  const auto start = p2g_mpm_loop::totals(p);
  const double energy = start.elastic + start.kinetic;
  double largest_elastic = 0;
  for (int step = 0; step < 100; ++step) {
    const Arrays u = run_module(task, label, p);
    ASSERT_EQ(u.size(), 3u);
    p2g_mpm_loop::back_to_particles(u, p);
    const auto now = p2g_mpm_loop::totals(p);
    ASSERT_TRUE(std::isfinite(now.elastic + now.kinetic)) << "step " << step;
    largest_elastic = std::max(largest_elastic, now.elastic);
    ASSERT_LE(now.elastic + now.kinetic, 1.001 * energy) << "step " << step;
  }
  const auto end = p2g_mpm_loop::totals(p);
  const double scale =
      std::abs(start.momentum[0]) + std::abs(start.momentum[1]) + std::abs(start.momentum[2]);
  for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(end.momentum[d], start.momentum[d], 2e-6 * scale);
  // The spin turns into strain and back only in part.
  EXPECT_LE(largest_elastic, start.elastic + 0.5 * start.kinetic);
  // The ball has moved with its drift: 100 steps of 5e-5 s at (1, -0.5, 0.25) m/s.
  const double mass = p.scalar("mass_p") * static_cast<double>(p.inputs[0].shape()[0]);
  EXPECT_NEAR(end.momentum[0] / mass, 1.0, 1e-5);
}

}  // namespace gpuphys::testing
