// solve_constraint_pbf: Jacobi iterations of the density constraints of fluid particles, FP32.
//
// Particles are sorted by cells once. Each iteration is two sweeps, because a move needs lambda of the
// neighbours: find_lambda() searches and keeps a list of neighbours, move() reads it. What iterates is the
// displacement; differences are (x_i - x_j) + (s_i - s_j), and it is added to x once. The search allows for
// how far particles may have moved since they were sorted. Mapping, search and what bounds it:
// references/blocks/fluid_search.cuh, with other block sizes (GPUPHYS_OTHER_BLOCKS); sweeps:
// fluid_operators.cuh.
#include "cases/position_constraint/solve_constraint_pbf.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/fluid_operators.cuh"
#include "references/common/alignment.hpp"

namespace gpuphys::solve_constraint_pbf {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    fluid_.allocate("solve_constraint_pbf", in.x.shape[0], true, in.iters);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("solve_constraint_pbf", "x", in.x.data);
    if (in.iters == 0) {
      GPUPHYS_CUDA(cudaMemcpyAsync(out.x_new.data, in.x.data,
                                   sizeof(float) * static_cast<std::size_t>(in.x.size()),
                                   cudaMemcpyDeviceToDevice));
      return;
    }
    fluid_.sort(in.x.data, nullptr, static_cast<int>(in.x.shape[0]), in.h);
    fluid_.solve(in.rho0, in.eps, in.k_corr, in.dq, in.iters, out.x_new.data);
  }

 private:
  fluid::Solver<fluid::With::nothing> fluid_;
};

}  // namespace
}  // namespace gpuphys::solve_constraint_pbf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(solve_constraint_pbf, solve_constraint_pbf::Reference)
}
