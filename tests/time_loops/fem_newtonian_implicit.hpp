// A block of Neo-Hookean tetrahedra stepped by Newton's method: what must hold for any correct module.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "cases/global_solve/fem_newtonian_implicit.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// Elastic energy at the positions x(i, c).
template <class Positions>
double neo_hookean_energy(const fem_newtonian_implicit::Inputs& in, const Positions& x) {
  double energy = 0;
  const double mu = in.mu, lambda = in.lambda;
  for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
    const auto rest = serial::edges<double>(in.X, in.tets, t);
    const auto f = serial::product(serial::edges<double>(x, in.tets, t), serial::inverse(rest));
    double square = 0;
    for (const auto& row : f) square += row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
    const double log_j = std::log(serial::determinant(f));
    energy +=
        serial::determinant(rest) / 6 * (mu * (0.5 * (square - 3) - log_j) + 0.5 * lambda * log_j * log_j);
  }
  return energy;
}

/// 100 steps of a wobbling block: kinetic and elastic energy together never grow.
inline void time_loop_fem_newtonian_implicit(const std::string& label) {
  const Task& task = find_task("fem_newtonian_implicit");
  const elastic::TetBody body = elastic::tet_block(
      {4, 3, 5}, {.periods = 1, .strain = 0.1, .jitter = 0.03, .speed = 1, .noise = 0.1, .seed = 11});
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                           {"m", static_cast<std::int64_t>(body.tets.size())}});
  elastic::store(body, p);
  p.set_scalar("mu", 400);
  p.set_scalar("lambda", 600);
  p.set_scalar("dt", 0.005);
  p.set_scalar("tol", 1e-2);
  const auto energy = [&] {
    const auto in = bind_inputs<fem_newtonian_implicit::Inputs>(p);
    double sum = neo_hookean_energy(in, in.x);
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
    EXPECT_LE(now, earlier * (1 + 1e-3)) << "step " << step;
    earlier = now;
  }
  EXPECT_LT(earlier, 0.9 * before);
}

}  // namespace gpuphys::testing
