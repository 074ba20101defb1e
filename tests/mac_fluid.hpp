// What the unit tests of the fluid steps on a MAC grid share.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "cases/global_solve/mac_fluid_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

inline Problem fluid_at_rest(const std::string& task, mac_fluid::Extents n, const mac_fluid::Open& open,
                             const std::vector<std::pair<std::string, double>>& scalars) {
  Problem p = mac_fluid::make_fluid(find_task(task).contract, n, open);
  for (const auto& [name, value] : scalars) p.set_scalar(name, value);
  return p;
}

inline std::int64_t face(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return (i * u.shape()[1] + j) * u.shape()[2] + k;
}

/// The next problem of a time loop: outputs become inputs, rounded to float32 once.
inline void feed_velocity(const Arrays& out, Problem& p) {
  for (std::size_t c = 0; c < 3; ++c) {
    const auto u = p.inputs[c].as<float>();
    for (std::int64_t f = 0; f < out[c].size(); ++f)
      u[static_cast<std::size_t>(f)] = static_cast<float>(out[c].value(f));
  }
}

/// sum of w u^2, of outputs or of a problem's own velocity.
inline double kinetic_energy(const Problem& p, const Arrays& u) {
  double sum = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < u[c].size(); ++f)
      sum += p.inputs[3 + c].value(f) * u[c].value(f) * u[c].value(f);
  }
  return sum;
}

}  // namespace gpuphys::testing
