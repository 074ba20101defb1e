// A task whose time is memory traffic alone, for planting slowdowns of known size: v = u + 1.
#pragma once

#include "tests/one_array_contract.hpp"

namespace gpuphys::slowdown_target {

using one_array::Inputs;
template <class Real>
using Outputs = one_array::Outputs<Real>;

}  // namespace gpuphys::slowdown_target
