// lbm_d3q19: one lattice Boltzmann step on a periodic grid, TRT collision then streaming, FP32.
//
// For every cell: its 19 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-, and population q stored at the cell that c_q leads to.
//
// Mapping: a thread owns two neighbouring cells along z, a block whole rows (two of the paper's), 8 bytes of
// every population an access. 19 loads, all issued before the first use, by 672 threads put 102 KB an SM in
// flight; nothing is read twice.
//
// What bounds it: DRAM, 152 bytes a cell (19 populations read, 19 written), 2510 MB at paper size: 0.591 ms
// at the copy rate of an H200. 692 instructions for two cells are about a quarter of the issue slots at that
// speed. The trick that pays is in lattice.cuh: in the ten directions that move along z one of the two
// populations stays with its thread and the other passes through shared memory, so that every store is whole
// aligned lines.
#include "cases/grid_lattice/lbm_d3q19.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::lbm_d3q19 {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
// The paper's rows take the path without shared memory.
struct Policy : lbm::RowPolicy<64, 8> {};
#else
// Two of the paper's rows a block; 80 registers a thread: six rows an SM.
struct Policy : lbm::RowPolicy<224, 3> {};
#endif

using Reference = lbm::CollisionThenStreaming<lbm::Lattice<19>, Policy>;

}  // namespace
}  // namespace gpuphys::lbm_d3q19

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(lbm_d3q19, lbm_d3q19::Reference)
}
