// A block of corotated tetrahedra stepped by projective dynamics: what must hold for any correct module.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "cases/global_solve/fem_pd.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Sum of mu V |F - R|^2 at the positions x (n, 3).
inline double corotated_energy(const fem_pd::Inputs& in, const std::vector<double>& x) {
  double energy = 0;
  const auto at = [&](std::int64_t i, std::int64_t c) { return x[static_cast<std::size_t>(3 * i + c)]; };
  for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
    const auto rest = serial::edges<double>(in.X, in.tets, t);
    const auto f = serial::product(serial::edges<double>(at, in.tets, t), serial::inverse(rest));
    const auto r = serial::nearest_rotation(f);
    double square = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) square += (f[a][b] - r[a][b]) * (f[a][b] - r[a][b]);
    }
    energy += static_cast<double>(in.mu) * serial::determinant(rest) / 6 * square;
  }
  return energy;
}

inline std::vector<double> values_of(const HostArray& a) {
  std::vector<double> v(static_cast<std::size_t>(a.size()));
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = a.value(static_cast<std::int64_t>(i));
  return v;
}

/// |z - y|^2_M / (2 dt^2) + E(z) of the outputs, which each iteration lowers.
inline double incremental_energy(const fem_pd::Inputs& in, const Arrays& out) {
  double energy = corotated_energy(in, values_of(find(out, "x_new", "outputs")));
  for (std::int64_t c = 0; c < in.v.size(); ++c) {
    const double change = find(out, "v_new", "outputs").value(c) - static_cast<double>(in.v.data[c]);
    energy += 0.5 * static_cast<double>(in.mass(c / 3)) * change * change;
  }
  return energy;
}

/// 100 steps of a wobbling block: kinetic and elastic energy together never grow.
inline void time_loop_fem_pd(const std::string& label) {
  const Task& task = find_task("fem_pd");
  const elastic::TetBody body = elastic::tet_block(
      {4, 3, 5}, {.periods = 1, .strain = 0.1, .jitter = 0.03, .speed = 1, .noise = 0.1, .seed = 11});
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                           {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", 400);
  p.set_scalar("dt", 0.02);
  p.set_scalar("iters", 8);
  const auto energy = [&] {
    const auto in = bind_inputs<fem_pd::Inputs>(p);
    double sum = corotated_energy(in, values_of(p.inputs[1]));
    for (std::int64_t c = 0; c < in.v.size(); ++c) {
      const double v = in.v.data[c];
      sum += 0.5 * static_cast<double>(in.mass(c / 3)) * v * v;
    }
    return sum;
  };
  const double before = energy();
  double earlier = before;
  for (int step = 1; step <= 100; ++step) {
    const Arrays out = run_module(task, label, p);
    for (std::int64_t c = 0; c < p.inputs[1].size(); ++c) {
      const auto at = static_cast<std::size_t>(c);
      p.inputs[1].as<float>()[at] = static_cast<float>(find(out, "x_new", "outputs").value(c));
      p.inputs[2].as<float>()[at] = static_cast<float>(find(out, "v_new", "outputs").value(c));
    }
    const double now = energy();
    ASSERT_TRUE(std::isfinite(now)) << "step " << step;
    EXPECT_LE(now, earlier * (1 + 1e-4)) << "step " << step;
    earlier = now;
  }
  EXPECT_LT(earlier, 0.9 * before);
}

}  // namespace gpuphys::testing
