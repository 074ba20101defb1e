// Contract of stream_d3q19 (specification: cases/grid_lattice/stream_d3q19.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::stream_d3q19 {

using Inputs = lattice::StreamingInputs<19>;
template <class Real>
using Outputs = lattice::Outputs<19, Real>;

}  // namespace gpuphys::stream_d3q19
