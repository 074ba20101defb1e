// trt_collision_d3q19: collision of the populations of every cell of a D3Q19 lattice with two relaxation
// times (TRT), FP32.
//
// For every cell: its 19 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-.
//
// Mapping: cells do not touch each other, so the grid is a line of cells; a thread owns two neighbours.
//
// What bounds it: DRAM, 152 bytes a cell, 2550 MB at paper size: 0.600 ms at the copy rate of an H200.
// The trick that pays: opposite populations are relaxed together, which halves the arithmetic (lattice.cuh).
#include "cases/grid_lattice/trt_collision_d3q19.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::trt_collision_d3q19 {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int cells = 1;
  static constexpr int threads = 96;
  static constexpr int blocks_per_sm = 4;
#else
  static constexpr int cells = 2;  // a thread
  static constexpr int threads = 256;
  static constexpr int blocks_per_sm = 2;
#endif
};

using D3Q19 = lbm::Lattice<19>;

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { lbm::make_grid(in.f); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto collision = lbm::TrtCollision<D3Q19>::make(in.tau_plus, in.magic);
    lbm::launch_collision<D3Q19, Policy>(in.f, out.f.data, collision);
  }
};

}  // namespace
}  // namespace gpuphys::trt_collision_d3q19

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(trt_collision_d3q19, trt_collision_d3q19::Reference)
}
