// Contract of poisson_dirichlet (specification: cases/global_solve/poisson_dirichlet.md).
#pragma once

#include "cases/global_solve/poisson.hpp"

namespace gpuphys::poisson_dirichlet {

using Inputs = poisson::Inputs;
template <class Real>
using Outputs = poisson::Outputs<Real>;

}  // namespace gpuphys::poisson_dirichlet
