// viscosity_pbf: XSPH viscosity of fluid particles, FP32.
//
// Particles are sorted by cells, positions with velocities; then one sweep: each particle looks for its
// neighbours and sums (v_j - v_i) W. Mapping, search and what bounds it: references/blocks/fluid_search.cuh;
// the sweep is even_out() of fluid_operators.cuh. The change is summed by itself and added once.
// Other block sizes (GPUPHYS_OTHER_BLOCKS) are there too.
#include "cases/local_interaction/viscosity_pbf.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/fluid_operators.cuh"
#include "references/common/alignment.hpp"

namespace gpuphys::viscosity_pbf {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    fluid_.allocate("viscosity_pbf", in.x.shape[0], false, 0);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("viscosity_pbf", "x", in.x.data);
    require_aligned("viscosity_pbf", "v", in.v.data);
    fluid_.sort(in.x.data, in.v.data, static_cast<int>(in.x.shape[0]), in.h);
    fluid_.viscosity<false>(fluid_.other(), in.c, out.v_new.data, nullptr);
  }

 private:
  fluid::Solver<fluid::With::velocity> fluid_;
};

}  // namespace
}  // namespace gpuphys::viscosity_pbf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(viscosity_pbf, viscosity_pbf::Reference)
}
