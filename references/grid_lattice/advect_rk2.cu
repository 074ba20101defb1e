// advect_rk2: semi-Lagrangian self-advection of a MAC-grid velocity, midpoint (RK2) back-tracing, FP32.
//
// For every face: velocity at the face, half a step back, velocity there, a full step back with it, own
// component there.
//
// Mapping: the march of mac_advection.cuh, a thread a column of cells along x.
//
// What bounds it: L1, not DRAM. Per cell there are 11 loads for the velocities at the three faces (exact
// means of four; 7 more come in registers from the cell before), 72 for the midpoints and 24 for the
// departure points, nearly all L1 hits. A warp's load of 32 neighbours along z starts anywhere, so it spans
// two lines and takes 1.8 wavefronts (measured); before the 7 were carried, at 75 % of the L1 data pipe and
// 61 % of the issue slots, the kernel was a third above what that pipe alone would take. What pays is fewer
// instructions around those loads: floors are one rounded-down addition whose raw bits go straight into the
// offset, walls are float minima and maxima along each axis instead of index clamps or branches, a point
// costs four row pointers. Tried and dropped: a branch to an unclamped path for points clear of the walls
// (0.76 ms; the lanes near z walls drag a quarter of all warps through both), 16 x 2 lanes a warp (0.66),
// three blocks an SM instead of four (0.60), one component a launch (0.77), samples from shared memory
// (docs/lab/grid_lattice.md).
#include "cases/grid_lattice/advect_rk2.hpp"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::advect_rk2 {
namespace {

using Policy = mac::TiledMarch<4>;  // another tile under GPUPHYS_OTHER_BLOCKS

using Reference = mac::SemiLagrangianSolver<Policy, mac::MidpointTrace>;

}  // namespace
}  // namespace gpuphys::advect_rk2

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk2, advect_rk2::Reference)
}
