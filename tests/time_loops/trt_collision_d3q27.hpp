// Time loop of trt_collision_d3q27: repeated collisions must lead to the equilibrium.
#pragma once

#include <string>

#include "tests/lattice_steps.hpp"

namespace gpuphys::testing {

inline void time_loop_trt_collision_d3q27(const std::string& label) {
  expect_relaxation_to_equilibrium({"trt_collision_d3q27", 27, true, false, label});
}

}  // namespace gpuphys::testing
