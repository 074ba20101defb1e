// trt_collision_d3q19: the populations of every cell of a D3Q19 lattice collide with two relaxation times
// (TRT), FP32.
//
// For every cell: its 19 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-.
//
// Mapping: no cell touches another, so the grid is a line of cells; a thread owns two neighbours and reads
// and writes 8 bytes of every population.
//
// What bounds it: DRAM, 152 bytes a cell, 2550 MB at paper size: 0.600 ms at the copy rate of an H200 (0.627
// by ncu). 19 loads, all issued before the first use, by 768 threads (80 registers each) put 117 KB an SM in
// flight; 522 instructions for two cells take less than a fifth of the issue slots. The trick that pays:
// opposite populations are relaxed together, which halves the arithmetic (lattice.cuh).
#include "cases/grid_lattice/trt_collision_d3q19.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::trt_collision_d3q19 {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
struct Policy : lbm::LinePolicy<96, 1, 4> {};
#else
struct Policy : lbm::LinePolicy<256, 2, 3> {};
#endif

using Reference = lbm::Collision<lbm::Lattice<19>, Policy>;

}  // namespace
}  // namespace gpuphys::trt_collision_d3q19

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(trt_collision_d3q19, trt_collision_d3q19::Reference)
}
