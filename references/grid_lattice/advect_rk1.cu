// advect_rk1: semi-Lagrangian self-advection of a MAC-grid velocity, Euler (RK1) back-tracing, FP32.
//
// For every face: velocity at the face, a full step back with it, own component there.
//
// Mapping: the march of mac_advection.cuh, a thread a column of cells along x.
//
// What bounds it: L1 and issue slots, not DRAM (404 MB, 0.095 ms): 0.275 ms in the suite. Per cell 35 loads
// (24 for the departure points, 11 of the 18 for the velocities at the faces: the other 7 stay in registers
// from the cell before) and 262 instructions, against 107 and 631 of advect_rk2. What pays here more than
// there: carrying what neighbouring cells share, and a march of 8 cells, over which the 160 instructions in
// front of the loop are spread.
#include "cases/grid_lattice/advect_rk1.hpp"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_rk1 {
namespace {

using Policy = mac::TiledMarch<8>;  // another tile under GPUPHYS_OTHER_BLOCKS

using Reference = mac::SemiLagrangianSolver<Policy, mac::EulerTrace>;

}  // namespace
}  // namespace gpuphys::advect_rk1

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk1, advect_rk1::Reference)
}
