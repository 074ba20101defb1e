// Contract of advect_rk3 (specification: cases/grid_lattice/advect_rk3.md).
#pragma once

#include "cases/grid_lattice/mac_advection.hpp"

namespace gpuphys::advect_rk3 {

using Inputs = mac_advection::Inputs;
template <class Real>
using Outputs = mac_advection::Outputs<Real>;

}  // namespace gpuphys::advect_rk3
