// A lattice of springs stepped by projective dynamics: what must hold for any correct module.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "cases/global_solve/mass_spring_pd.hpp"
#include "cases/local_interaction/elastic_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

inline double spring_energy(const mass_spring_pd::Inputs& in, const HostArray& x) {
  double energy = 0;
  for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
    const std::int64_t a = 3 * in.springs(j, 0), b = 3 * in.springs(j, 1);
    const double length =
        std::hypot(x.value(a) - x.value(b), x.value(a + 1) - x.value(b + 1), x.value(a + 2) - x.value(b + 2));
    const double stretch = length - static_cast<double>(in.rest(j));
    energy += 0.5 * static_cast<double>(in.k) * stretch * stretch;
  }
  return energy;
}

/// |z - y|^2_M / (2 dt^2) + E(z) of the outputs, which each iteration lowers.
inline double incremental_energy(const Problem& p, const Arrays& out) {
  const auto in = bind_inputs<mass_spring_pd::Inputs>(p);
  double energy = spring_energy(in, find(out, "x_new", "outputs"));
  for (std::int64_t i = 0; i < in.mass.shape[0]; ++i) {
    for (std::int64_t d = 0; d < 3; ++d) {
      const double change = find(out, "v_new", "outputs").value(3 * i + d) - static_cast<double>(in.v(i, d));
      energy += 0.5 * static_cast<double>(in.mass(i)) * change * change;
    }
  }
  return energy;
}

/// 100 steps: kinetic and elastic energy together never grow, and the implicit step damps them.
inline void time_loop_mass_spring_pd(const std::string& label) {
  const Task& task = find_task("mass_spring_pd");
  const elastic::SpringBody body = elastic::spring_lattice(
      {7, 6, 8}, 1, {.periods = 1, .strain = 0.03, .jitter = 0.02, .speed = 2, .noise = 0.2, .seed = 11});
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(body.x.size())},
                                           {"m", static_cast<std::int64_t>(body.rest.size())}});
  elastic::store(body, p);
  p.set_scalar("k", 1000);
  p.set_scalar("dt", 0.02);
  p.set_scalar("iters", 20);
  const auto energy = [&] {
    const auto in = bind_inputs<mass_spring_pd::Inputs>(p);
    double sum = spring_energy(in, p.inputs[0]);
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
    for (std::int64_t c = 0; c < p.inputs[0].size(); ++c) {
      const auto at = static_cast<std::size_t>(c);
      p.inputs[0].as<float>()[at] = static_cast<float>(find(out, "x_new", "outputs").value(c));
      p.inputs[1].as<float>()[at] = static_cast<float>(find(out, "v_new", "outputs").value(c));
    }
    const double now = energy();
    ASSERT_TRUE(std::isfinite(now)) << "step " << step;
    EXPECT_LE(now, earlier * (1 + 1e-4)) << "step " << step;
    earlier = now;
  }
  EXPECT_LT(earlier, 0.9 * before);
}

}  // namespace gpuphys::testing
