// Contract of lbm_d3q19 (specification: cases/grid_lattice/lbm_d3q19.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::lbm_d3q19 {

using Inputs = lattice::CollisionInputs<19>;
template <class Real>
using Outputs = lattice::Outputs<19, Real>;

}  // namespace gpuphys::lbm_d3q19
