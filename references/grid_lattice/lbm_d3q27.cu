// lbm_d3q27: one lattice Boltzmann step on a periodic grid, TRT collision then streaming, FP32.
#include "cases/grid_lattice/lbm_d3q27.hpp"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::lbm_d3q27 {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int longest_row = 96;  // the paper's rows take the path without shared memory
  static constexpr int threads = 64;
  static constexpr int blocks_per_sm = 8;
#else
  static constexpr int longest_row = 448;
  static constexpr int threads = 448;
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
    const auto collision = lbm::TrtCollision<D3Q27>::make(in.tau_plus, in.magic);
    lbm::launch_step<D3Q27, Policy>(in.f, out.f.data, collision);
  }
};

}  // namespace
}  // namespace gpuphys::lbm_d3q27

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(lbm_d3q27, lbm_d3q27::Reference)
}
