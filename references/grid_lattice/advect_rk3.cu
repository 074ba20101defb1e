// advect_rk3: semi-Lagrangian self-advection of a MAC-grid velocity, Ralston's RK3 back-tracing, FP32.
//
// For every face: velocity at the face, half a step back, velocity there, three quarters of a step back with
// it, velocity there, a full step back with 2/9, 3/9 and 4/9 of the three, own component there.
//
// Mapping: the march of mac_advection.cuh, a thread a column of cells along x.
//
// What bounds it: the gathers. 179 loads a cell (11 at the faces, 72 for each of two stages, 24 for the
// departure points) and 1080 instructions, against 107 and 631 of advect_rk2; in that kernel's mix of L1
// wavefronts and issue slots 0.93 ms were predicted for that, the suite measures 0.909. DRAM moves 404 MB
// (0.095 ms) meanwhile. All stages are held as displacements of a whole step, so that a stage is three
// multiplications and no velocity is kept.
#include "cases/grid_lattice/advect_rk3.hpp"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_rk3 {
namespace {

using Policy = mac::TiledMarch<4>;  // another tile under GPUPHYS_OTHER_BLOCKS

using Reference = mac::SemiLagrangianSolver<Policy, mac::RalstonTrace>;

}  // namespace
}  // namespace gpuphys::advect_rk3

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk3, advect_rk3::Reference)
}
