// Contract of mc_r (specification: cases/global_solve/mc_r.md).
#pragma once

#include "cases/global_solve/mac_fluid.hpp"

namespace gpuphys::mc_r {

using Inputs = mac_fluid::Inputs;
template <class Real>
using Outputs = mac_fluid::Outputs<Real>;

}  // namespace gpuphys::mc_r
