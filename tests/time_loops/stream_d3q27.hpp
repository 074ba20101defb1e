// Time loop of stream_d3q27: streaming must lose nothing.
#pragma once

#include <string>

#include "tests/lattice_steps.hpp"

namespace gpuphys::testing {

inline void time_loop_stream_d3q27(const std::string& label) {
  expect_streaming_returns({"stream_d3q27", 27, false, true, label});
}

}  // namespace gpuphys::testing
