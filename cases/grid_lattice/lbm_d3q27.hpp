// Contract of lbm_d3q27 (specification: cases/grid_lattice/lbm_d3q27.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::lbm_d3q27 {

using Inputs = lattice::CollisionInputs<27>;
template <class Real>
using Outputs = lattice::Outputs<27, Real>;

}  // namespace gpuphys::lbm_d3q27
