// lbm_d3q19: one lattice Boltzmann step on a periodic grid, TRT collision then streaming, FP32.
//
// For every cell: its 19 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-, and population q stored at the cell that c_q leads to.
//
// Mapping: a thread owns one cell, a block whole rows along z (two of the paper's). 19 loads, all issued
// before the first use, put 68 KB an SM in flight; nothing is read twice.
//
// What bounds it: DRAM, 152 bytes a cell (19 populations read, 19 written), 2510 MB at paper size: 0.591 ms
// at the copy rate of an H200. About 470 instructions a cell fill a third of the issue slots at that speed.
// The trick that pays is in lattice.cuh: the ten directions that move along z are shifted inside the block,
// through shared memory, so that every store is whole aligned lines.
#include "cases/grid_lattice/lbm_d3q19.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::lbm_d3q19 {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int longest_row = 96;  // the paper's rows take the path without shared memory
  static constexpr int threads = 64;
  static constexpr int blocks_per_sm = 8;
#else
  static constexpr int longest_row = 512;
  static constexpr int threads = 448;      // two of the paper's rows
  static constexpr int blocks_per_sm = 2;  // 64 registers a thread: four rows of 224 an SM
#endif
  // Evict-first hints gain nothing and make the time depend on where the arrays happen to lie.
  static constexpr bool streaming_loads = false;
  static constexpr bool streaming_stores = false;
};

using D3Q19 = lbm::Lattice<19>;

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { lbm::make_grid(in.f); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto collision = lbm::TrtCollision<D3Q19>::make(in.tau_plus, in.magic);
    lbm::launch_step<D3Q19, Policy>(in.f, out.f.data, collision);
  }
};

}  // namespace
}  // namespace gpuphys::lbm_d3q19

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(lbm_d3q19, lbm_d3q19::Reference)
}
