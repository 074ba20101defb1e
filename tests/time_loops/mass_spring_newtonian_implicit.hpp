// A lattice of springs stepped by Newton's method: what must hold for any correct module.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "cases/global_solve/mass_spring_newtonian_implicit.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

/// 100 steps: kinetic and elastic energy together never grow, and the implicit step damps them.
inline void time_loop_mass_spring_newtonian_implicit(const std::string& label) {
  const Task& task = find_task("mass_spring_newtonian_implicit");
  const elastic::SpringBody body = elastic::spring_lattice(
      {7, 6, 8}, 1, {.periods = 1, .strain = 0.03, .jitter = 0.02, .speed = 2, .noise = 0.2, .seed = 11});
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                           {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", 1000);
  p.set_scalar("dt", 0.005);
  p.set_scalar("tol", 1e-2);
  const auto energy = [&] {
    const auto in = bind_inputs<mass_spring_newtonian_implicit::Inputs>(p);
    double sum = 0;
    for (std::int64_t c = 0; c < in.v.size(); ++c) {
      const double v = in.v.data[c];
      sum += 0.5 * static_cast<double>(in.mass(c / 3)) * v * v;
    }
    for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
      double square = 0;
      for (std::int64_t c = 0; c < 3; ++c) {
        const double d =
            static_cast<double>(in.x(in.springs(j, 0), c)) - static_cast<double>(in.x(in.springs(j, 1), c));
        square += d * d;
      }
      const double stretch = std::sqrt(square) - static_cast<double>(in.rest(j));
      sum += 0.5 * static_cast<double>(in.k) * stretch * stretch;
    }
    return sum;
  };
  const double before = energy();
  double earlier = before;
  for (int step = 1; step <= 100; ++step) {
    const Arrays out = run_module(task, label, p);
    for (std::int64_t c = 0; c < p.inputs[0].size(); ++c) {
      const auto at = static_cast<std::size_t>(c);
      p.inputs[0].as<float>()[at] = static_cast<float>(find(out, "x_new", "outputs").value(c));
      p.inputs[1].as<float>()[at] = static_cast<float>(find(out, "v_new", "outputs").value(c));
    }
    const double now = energy();
    ASSERT_TRUE(std::isfinite(now)) << "step " << step;
    EXPECT_LE(now, earlier * (1 + 1e-3)) << "step " << step;
    earlier = now;
  }
  EXPECT_LT(earlier, 0.9 * before);
}

}  // namespace gpuphys::testing
