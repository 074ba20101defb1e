// stream_d3q19: the populations of a D3Q19 lattice move to the neighbour cells that their velocities lead to.
//
// Mapping: population by population, 19 copies one after the other in one launch. A thread moves four pieces
// of four neighbouring populations along z.
//
// What bounds it: DRAM, 152 bytes a cell, 2510 MB at paper size: 0.591 ms at the copy rate of an H200 (0.605
// by ncu). A piece of 16 bytes takes some 60 instructions, a quarter of the issue slots; four of them before
// the first store put 64 bytes a thread, 98 KB an SM, in flight. The trick that pays: nothing is computed, so
// that a thread need not hold whole cells. A copy of one population at a time has one place in memory that is
// read and one that is written, where whole cells have 38. The shift along z by one element is made in
// registers: the neighbour element comes from the cache, and the store is aligned.
#include "cases/grid_lattice/stream_d3q19.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::stream_d3q19 {
namespace {

struct Policy : lbm::StreamingPolicy {};
using Reference = lbm::Streaming<lbm::Lattice<19>, Policy>;

}  // namespace
}  // namespace gpuphys::stream_d3q19

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(stream_d3q19, stream_d3q19::Reference)
}
