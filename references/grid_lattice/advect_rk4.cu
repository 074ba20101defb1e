// advect_rk4: semi-Lagrangian self-advection of a MAC-grid velocity, classical RK4 back-tracing, FP32.
//
// For every face: velocity at the face, half a step back, velocity there, half a step back with that,
// velocity there, a full step back with that, velocity there; a full step back with 1/6, 2/6, 2/6 and 1/6 of
// the four, own component there.
//
// Mapping: the march of mac_advection.cuh, a thread a column of cells along x.
//
// What bounds it: the gathers. 251 loads a cell (11 at the faces, 72 for each of three stages, 24 for the
// departure points) and 1510 instructions, against 107 and 631 of advect_rk2; in that kernel's mix of L1
// wavefronts and issue slots 1.30 ms were predicted for that, the suite measures 1.276. DRAM moves 404 MB
// (0.095 ms) meanwhile. Stages are held as displacements of half a step: two of the three sample points are
// stages as they are.
#include "cases/grid_lattice/advect_rk4.hpp"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_rk4 {
namespace {

using Policy = mac::TiledMarch<4>;  // another tile under GPUPHYS_OTHER_BLOCKS

using Reference = mac::SemiLagrangianSolver<Policy, mac::ClassicalTrace>;

}  // namespace
}  // namespace gpuphys::advect_rk4

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk4, advect_rk4::Reference)
}
