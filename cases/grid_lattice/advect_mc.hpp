// Contract of advect_mc (specification: cases/grid_lattice/advect_mc.md).
#pragma once

#include "cases/grid_lattice/mac_advection.hpp"

namespace gpuphys::advect_mc {

using Inputs = mac_advection::Inputs;
template <class Real>
using Outputs = mac_advection::Outputs<Real>;

}  // namespace gpuphys::advect_mc
