// Contract of trt_collision_d3q19 (specification: cases/grid_lattice/trt_collision_d3q19.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::trt_collision_d3q19 {

using Inputs = lattice::CollisionInputs<19>;
template <class Real>
using Outputs = lattice::Outputs<19, Real>;

}  // namespace gpuphys::trt_collision_d3q19
