// vorticity_confinement_pbf: vorticity confinement of fluid particles, FP32.
//
// Particles are sorted by cells, positions with velocities; then two sweeps, because the slope of |omega|
// needs omega of the neighbours: the first searches and keeps a list of neighbours, the second reads it.
// Mapping, search and what bounds it: references/blocks/fluid_search.cuh; the sweeps are find_vorticity() and
// confine() of fluid_operators.cuh. omega and its slope are held without the kernel's factor, so that their
// squares stay within float32. Other block sizes (GPUPHYS_OTHER_BLOCKS) are there too.
#include "cases/local_interaction/vorticity_confinement_pbf.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/fluid_operators.cuh"
#include "references/common/alignment.hpp"

namespace gpuphys::vorticity_confinement_pbf {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0];
    fluid_.allocate("vorticity_confinement_pbf", n, true, 0);
    curl_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    size_ = DeviceBuffer<float>(static_cast<std::size_t>(n));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("vorticity_confinement_pbf", "x", in.x.data);
    require_aligned("vorticity_confinement_pbf", "v", in.v.data);
    fluid_.sort(in.x.data, in.v.data, static_cast<int>(in.x.shape[0]), in.h);
    fluid_.confine_vorticity<false>({fluid_.other(), 1.0f}, in.epsilon, in.dt, curl_.get(), size_.get(),
                                    nullptr, out.v_new.data);
  }

 private:
  fluid::Solver<fluid::With::velocity> fluid_;
  DeviceBuffer<float4> curl_;
  DeviceBuffer<float> size_;
};

}  // namespace
}  // namespace gpuphys::vorticity_confinement_pbf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(vorticity_confinement_pbf, vorticity_confinement_pbf::Reference)
}
