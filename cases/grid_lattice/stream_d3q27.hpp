// Contract of stream_d3q27 (specification: cases/grid_lattice/stream_d3q27.md).
#pragma once

#include "cases/grid_lattice/lattice.hpp"

namespace gpuphys::stream_d3q27 {

using Inputs = lattice::StreamingInputs<27>;
template <class Real>
using Outputs = lattice::Outputs<27, Real>;

}  // namespace gpuphys::stream_d3q27
