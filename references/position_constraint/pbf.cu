// pbf: a step of a position-based fluid, FP32.
//
//   predict     x + dt (v + dt g), for the box of the grid
//   sort        by the cells of the predicted positions: x with its displacement dt (v + dt g)
//   solve       iterations on the displacement s: find_lambda(), move(), sort again
//   confine     find_vorticity() and confine() of the velocities s / dt
//   even_out    viscosity; writes velocities, and x + s, in the order of the input
//
// One sort serves all: the search allows for how far particles have moved since. The three velocity sweeps
// see the same positions and share one list of neighbours. Mapping, search and what bounds it:
// references/blocks/fluid_search.cuh, with other block sizes (GPUPHYS_OTHER_BLOCKS); sweeps:
// fluid_operators.cuh.
#include "cases/position_constraint/pbf.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/fluid_operators.cuh"
#include "references/common/alignment.hpp"

namespace gpuphys::pbf {
namespace {

constexpr int kPredictThreads = 256;

__global__ void predict(const float* x, const float* v, float* predicted, float dt, float3 g, int words) {
  const int k = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (k >= words) return;
  const float pull = k % 3 == 0 ? g.x : k % 3 == 1 ? g.y : g.z;
  predicted[k] = x[k] + dt * (v[k] + dt * pull);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0];
    const auto count = static_cast<std::size_t>(n);
    fluid_.allocate("pbf", n, true, in.iters);
    predicted_ = DeviceBuffer<float>(3 * count);
    curl_ = DeviceBuffer<float4>(count);
    size_ = DeviceBuffer<float>(count);
    confined_ = DeviceBuffer<float4>(count);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("pbf", "x", in.x.data);
    require_aligned("pbf", "v", in.v.data);
    const int n = static_cast<int>(in.x.shape[0]);
    const float3 g{in.gx, in.gy, in.gz};
    predict<<<static_cast<unsigned>((3 * n + kPredictThreads - 1) / kPredictThreads), kPredictThreads>>>(
        in.x.data, in.v.data, predicted_.get(), in.dt, g, 3 * n);
    fluid_.sort(in.x.data, in.v.data, n, in.h, predicted_.get(), in.dt, g);
    fluid_.solve(in.rho0, in.eps, in.k_corr, in.dq, in.iters, nullptr);
    fluid_.confine_vorticity<true>({fluid_.other(), 1.0f / in.dt}, in.vort_eps, in.dt, curl_.get(),
                                   size_.get(), confined_.get(), nullptr);
    fluid_.viscosity<true>(confined_.get(), in.c_visc, out.v_new.data, out.x_new.data);
  }

 private:
  fluid::Solver<fluid::With::step> fluid_;
  DeviceBuffer<float> predicted_, size_;
  DeviceBuffer<float4> curl_, confined_;
};

}  // namespace
}  // namespace gpuphys::pbf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(pbf, pbf::Reference)
}
