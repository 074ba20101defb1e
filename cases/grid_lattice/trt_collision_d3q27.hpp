// Contract of trt_collision_d3q27 (specification: cases/grid_lattice/trt_collision_d3q27.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::trt_collision_d3q27 {

using Inputs = lattice::CollisionInputs<27>;
template <class Real>
using Outputs = lattice::Outputs<27, Real>;

}  // namespace gpuphys::trt_collision_d3q27
