// trt_collision_d3q27: the populations of every cell of a D3Q27 lattice collide with two relaxation times
// (TRT), FP32.
//
// For every cell: its 27 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-.
//
// Mapping: no cell touches another, so the grid is a line of cells; a thread owns two neighbours and reads
// and writes 8 bytes of every population.
//
// What bounds it: DRAM, 216 bytes a cell, 3624 MB at paper size: 0.853 ms at the copy rate of an H200 (0.890
// by ncu). 27 loads, all issued before the first use, by 512 threads (128 registers each) put 111 KB an SM in
// flight; 698 instructions for two cells take less than a fifth of the issue slots. The trick that pays:
// opposite populations are relaxed together, which halves the arithmetic (lattice.cuh).
#include "cases/grid_lattice/trt_collision_d3q27.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::trt_collision_d3q27 {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
struct Policy : lbm::LinePolicy<96, 1, 4> {};
#else
struct Policy : lbm::LinePolicy<256, 2, 2> {};
#endif

using Reference = lbm::Collision<lbm::Lattice<27>, Policy>;

}  // namespace
}  // namespace gpuphys::trt_collision_d3q27

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(trt_collision_d3q27, trt_collision_d3q27::Reference)
}
