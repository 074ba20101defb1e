// lbm_d3q27: one lattice Boltzmann step on a periodic grid, TRT collision then streaming, FP32.
//
// For every cell: its 27 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-, and population q stored at the cell that c_q leads to.
//
// Mapping: a thread owns two neighbouring cells along z, a block whole rows (two of the paper's), 8 bytes of
// every population an access. 27 loads, all issued before the first use, by 448 threads put 97 KB an SM in
// flight; nothing is read twice.
//
// What bounds it: DRAM, 216 bytes a cell (27 populations read, 27 written), 3567 MB at paper size: 0.839 ms
// at the copy rate of an H200. 921 instructions for two cells are about a quarter of the issue slots at that
// speed. The trick that pays is in lattice.cuh: in the eighteen directions that move along z one of the two
// populations stays with its thread and the other passes through shared memory, so that every store is whole
// aligned lines.
#include "cases/grid_lattice/lbm_d3q27.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::lbm_d3q27 {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
// The paper's rows take the path without shared memory.
struct Policy : lbm::RowPolicy<64, 8> {};
#else
// Two of the paper's rows a block; up to 128 registers a thread: four rows an SM.
struct Policy : lbm::RowPolicy<224, 2> {};
#endif

using Reference = lbm::CollisionThenStreaming<lbm::Lattice<27>, Policy>;

}  // namespace
}  // namespace gpuphys::lbm_d3q27

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(lbm_d3q27, lbm_d3q27::Reference)
}
