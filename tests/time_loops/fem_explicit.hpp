// A block of jelly that falls on the ground, stepped by a module: what must hold for any correct one.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "cases/local_interaction/elastic_inputs.hpp"
#include "cases/local_interaction/fem_explicit.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

struct TetTotals {
  double kinetic = 0, elastic = 0, smallest_j = 1e300;
};

inline double determinant_of(const double (&a)[3][3]) {
  return a[0][0] * (a[1][1] * a[2][2] - a[1][2] * a[2][1]) -
         a[0][1] * (a[1][0] * a[2][2] - a[1][2] * a[2][0]) +
         a[0][2] * (a[1][0] * a[2][1] - a[1][1] * a[2][0]);
}

/// Energies by the invariants of F: mu/2 (|F|^2 - 3) - mu ln J + lambda/2 ln^2 J over each tetrahedron's
/// volume.
inline TetTotals tet_totals(const Problem& p) {
  const auto in = bind_inputs<fem_explicit::Inputs>(p);
  TetTotals t;
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    for (int c = 0; c < 3; ++c) {
      const double v = in.v(i, c);
      t.kinetic += 0.5 * static_cast<double>(in.mass(i)) * v * v;
    }
  }
  for (std::int64_t e = 0; e < in.tets.shape[0]; ++e) {
    double rest[3][3], now[3][3];
    for (int k = 0; k < 3; ++k) {
      for (int c = 0; c < 3; ++c) {
        rest[c][k] =
            static_cast<double>(in.X(in.tets(e, k + 1), c)) - static_cast<double>(in.X(in.tets(e, 0), c));
        now[c][k] =
            static_cast<double>(in.x(in.tets(e, k + 1), c)) - static_cast<double>(in.x(in.tets(e, 0), c));
      }
    }
    // Row c of F solves rest^T f = now row, by Cramer's rule.
    const double det = determinant_of(rest);
    double f[3][3], square = 0;
    for (int c = 0; c < 3; ++c) {
      for (int d = 0; d < 3; ++d) {
        double replaced[3][3];
        for (int a = 0; a < 3; ++a) {
          for (int k = 0; k < 3; ++k) replaced[a][k] = a == d ? now[c][k] : rest[a][k];
        }
        f[c][d] = determinant_of(replaced) / det;
        square += f[c][d] * f[c][d];
      }
    }
    const double j = determinant_of(f), log_j = std::log(j), mu = in.mu, lambda = in.lambda;
    t.elastic += det / 6 * (mu / 2 * (square - 3) - mu * log_j + lambda / 2 * log_j * log_j);
    t.smallest_j = std::min(t.smallest_j, j);
  }
  return t;
}

/// 100 steps under gravity above a floor: the block squashes, no element turns over, energy is not made, and
/// it leaves the floor again.
inline void time_loop_fem_explicit(const std::string& label) {
  constexpr double gravity = 10, dt = 5e-3, young = 1000;
  const Task& task = find_task("fem_explicit");
  elastic::TetBody block = elastic::tet_block(
      {5, 4, 6}, {.periods = 1, .strain = 0, .jitter = 0.02, .speed = 0, .noise = 0, .seed = 9});
  block.x = block.rest;
  for (auto& x : block.x) x[2] += 3.05;
  for (auto& v : block.v) v = {0.5, 0, -2};
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(block.x.size())},
                                           {"m", static_cast<std::int64_t>(block.tets.size())}});
  elastic::store(block, p);
  p.set_scalar("mu", young / 2.6);
  p.set_scalar("lambda", young * 0.3 / (1.3 * 0.4));
  p.set_scalar("dt", dt);
  const auto x = p.inputs[1].as<float>(), v = p.inputs[2].as<float>(), mass = p.inputs[3].as<float>();
  const auto energy = [&] {
    const TetTotals t = tet_totals(p);
    double potential = 0;
    for (std::size_t i = 0; i < mass.size(); ++i) {
      potential += gravity * static_cast<double>(mass[i]) * static_cast<double>(x[3 * i + 2]);
    }
    EXPECT_GT(t.smallest_j, 0.5);
    return t.kinetic + t.elastic + potential;
  };
  const auto height = [&] {
    float low = x[2], high = x[2];
    for (std::size_t i = 0; i < mass.size(); ++i) {
      low = std::min(low, x[3 * i + 2]);
      high = std::max(high, x[3 * i + 2]);
    }
    return static_cast<double>(high - low);
  };
  const double energy_before = energy(), height_before = height();
  double least_height = height_before;
  for (int step = 1; step <= 100; ++step) {
    for (std::size_t i = 0; i < mass.size(); ++i) v[3 * i + 2] -= static_cast<float>(gravity * dt);
    const Arrays out = run_module(task, label, p);
    for (std::size_t c = 0; c < x.size(); ++c) {
      const auto at = static_cast<std::int64_t>(c);
      ASSERT_TRUE(std::isfinite(find(out, "x_new", "outputs").value(at))) << "step " << step;
      x[c] = static_cast<float>(find(out, "x_new", "outputs").value(at));
      v[c] = static_cast<float>(find(out, "v_new", "outputs").value(at));
    }
    for (std::size_t i = 0; i < mass.size(); ++i) {
      if (x[3 * i + 2] >= 0) continue;
      x[3 * i + 2] = 0;
      v[3 * i + 2] = std::max(v[3 * i + 2], 0.0f);
    }
    least_height = std::min(least_height, height());
    if (step % 10 == 0) {
      EXPECT_LT(energy(), energy_before * 1.01) << "step " << step;
    }
  }
  double momentum = 0, total = 0;
  for (std::size_t i = 0; i < mass.size(); ++i) {
    momentum += static_cast<double>(mass[i]) * static_cast<double>(v[3 * i + 2]);
    total += static_cast<double>(mass[i]);
  }
  EXPECT_LT(least_height, 0.97 * height_before);
  EXPECT_GT(momentum / total, 0.3);  // upwards again
  EXPECT_GT(energy(), 0.5 * energy_before);
}

}  // namespace gpuphys::testing
