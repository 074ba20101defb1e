// Time loop of lbm_d3q19: what a flow must do over many steps of the module.
#pragma once

#include <string>

#include "tests/lattice_steps.hpp"

namespace gpuphys::testing {

inline void time_loop_lbm_d3q19(const std::string& label) {
  expect_plausible_flow({"lbm_d3q19", 19, true, true, label});
}

}  // namespace gpuphys::testing
