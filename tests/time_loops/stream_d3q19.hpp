// Time loop of stream_d3q19: streaming must lose nothing.
#pragma once

#include <string>

#include "tests/lattice_steps.hpp"

namespace gpuphys::testing {

inline void time_loop_stream_d3q19(const std::string& label) {
  expect_streaming_returns({"stream_d3q19", 19, false, true, label});
}

}  // namespace gpuphys::testing
