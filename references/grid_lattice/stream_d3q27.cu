// stream_d3q27: the populations of a D3Q27 lattice move to the neighbour cells that their velocities lead to,
// FP32.
//
// Mapping: population by population, 27 copies one after the other in one launch. A thread moves four pieces
// of four neighbouring populations along z.
//
// What bounds it: DRAM, 216 bytes a cell, 3567 MB at paper size: 0.839 ms at the copy rate of an H200. A
// piece of 16 bytes takes about 40 instructions, a sixth of the issue slots at that speed; four of them
// before the first store put 64 bytes a thread, 80 KB an SM and more, in flight. The trick that pays: nothing
// is computed, so cells need not be whole. A copy of one population at a time has one place in memory that is
// read and one that is written, where a thread a cell has 54. The shift along z by one element is made in
// registers: the neighbour element comes from the cache, the store is aligned.
#include "cases/grid_lattice/stream_d3q27.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::stream_d3q27 {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int pieces = 1;
  static constexpr int longest_row = 96;
  static constexpr int threads = 64;
  static constexpr int blocks_per_sm = 8;
#else
  static constexpr int pieces = 4;  // of 16 bytes a thread
  static constexpr int longest_row = 512;
  static constexpr int threads = 256;
  static constexpr int blocks_per_sm = 2;
#endif
  static constexpr bool streaming_loads = false;
  static constexpr bool streaming_stores = false;
};

using D3Q27 = lbm::Lattice<27>;

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { lbm::make_grid(in.f); }

  void compute(const Inputs& in, const Outputs<float>& out) {
#if GPUPHYS_TRY == 1
    lbm::launch_step<D3Q27, Policy>(in.f, out.f.data, lbm::NoCollision<D3Q27>{});
#else
    lbm::launch_streaming<D3Q27, Policy>(in.f, out.f.data);
#endif
  }
};

}  // namespace
}  // namespace gpuphys::stream_d3q27

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(stream_d3q27, stream_d3q27::Reference)
}
