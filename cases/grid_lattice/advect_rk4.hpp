// Contract of advect_rk4 (specification: cases/grid_lattice/advect_rk4.md).
#pragma once

#include "cases/grid_lattice/mac_advection.hpp"

namespace gpuphys::advect_rk4 {

using Inputs = mac_advection::Inputs;
template <class Real>
using Outputs = mac_advection::Outputs<Real>;

}  // namespace gpuphys::advect_rk4
