// trt_collision_d3q27: collision of the populations of every cell of a D3Q27 lattice with two relaxation
// times (TRT), FP32.
//
// For every cell: its 27 populations, their density and velocity, relaxation of the even part at 1/tau+ and
// of the odd part at 1/tau-.
//
// Mapping: cells do not touch each other, so the grid is a line of cells; a thread owns two neighbours.
//
// What bounds it: DRAM, 216 bytes a cell, 3624 MB at paper size: 0.853 ms at the copy rate of an H200.
// The trick that pays: opposite populations are relaxed together, which halves the arithmetic (lattice.cuh).
#include "cases/grid_lattice/trt_collision_d3q27.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::trt_collision_d3q27 {
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

using D3Q27 = lbm::Lattice<27>;

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { lbm::make_grid(in.f); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const auto collision = lbm::TrtCollision<D3Q27>::make(in.tau_plus, in.magic);
    lbm::launch_collision<D3Q27, Policy>(in.f, out.f.data, collision);
  }
};

}  // namespace
}  // namespace gpuphys::trt_collision_d3q27

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(trt_collision_d3q27, trt_collision_d3q27::Reference)
}
