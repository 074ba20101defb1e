// Contract of stable_fluids (specification: cases/global_solve/stable_fluids.md).
#pragma once

#include "cases/global_solve/mac_fluid.hpp"

namespace gpuphys::stable_fluids {

using Inputs = mac_fluid::ViscousInputs;
template <class Real>
using Outputs = mac_fluid::Outputs<Real>;

}  // namespace gpuphys::stable_fluids
