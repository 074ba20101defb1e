//
#include "cases/grid_lattice/advect_rk2.hpp"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_rk2 {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
using Policy = mac::March<32, 2, 3, 8>;
#else
using Policy = mac::March<32, 4, 4, 8>;
#endif

using Reference = mac::SemiLagrangianSolver<Policy, mac::MidpointTrace>;

}  // namespace
}  // namespace gpuphys::advect_rk2

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk2, advect_rk2::Reference)
}
