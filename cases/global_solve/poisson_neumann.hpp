// Contract of poisson_neumann (specification: cases/global_solve/poisson_neumann.md).
#pragma once

#include "cases/global_solve/poisson.hpp"

namespace gpuphys::poisson_neumann {

using Inputs = poisson::Inputs;
template <class Real>
using Outputs = poisson::Outputs<Real>;

}  // namespace gpuphys::poisson_neumann
