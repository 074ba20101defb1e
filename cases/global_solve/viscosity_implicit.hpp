// Contract of viscosity_implicit (specification: cases/global_solve/viscosity_implicit.md).
#pragma once

#include "cases/global_solve/mac_fluid.hpp"

namespace gpuphys::viscosity_implicit {

using Inputs = mac_fluid::ViscousInputs;
template <class Real>
using Outputs = mac_fluid::Outputs<Real>;

}  // namespace gpuphys::viscosity_implicit
