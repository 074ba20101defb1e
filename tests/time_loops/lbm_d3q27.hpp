// Time loop of lbm_d3q27: what a flow must do over many steps of the module.
#pragma once

#include <string>

#include "tests/lattice_steps.hpp"

namespace gpuphys::testing {

inline void time_loop_lbm_d3q27(const std::string& label) {
  expect_plausible_flow({"lbm_d3q27", 27, true, true, label});
}

}  // namespace gpuphys::testing
