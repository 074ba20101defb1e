// poisson_neumann: A x = b on the active cells of a box, A a seven-point matrix whose rows sum to zero; the
// solution with zero mean, exactly zero on inactive cells. FP32 throughout.
//
// Geometric multigrid: V(1,1) cycles of red-black over-relaxation on 2x2x2 aggregates with rediscretised
// couplings, residuals summed over children, corrections interpolated linearly. The cycle is the iteration as
// long as it converges quickly by itself; when it does not, a truncated GCR iteration takes over with the
// cycle as its preconditioner. Either way a solve ends only after the true residual of the shifted solution,
// as it is written out, has been measured with the given matrix.
//
// Work: two passes over the fine grid per cycle (multigrid_smooth.cuh), each a march of tiles through the
// box; smaller levels the same way, the smallest ones in one cluster (multigrid_tail.cuh). Bound by L2 and
// DRAM traffic and the latency within a step of the fine-grid passes. The trick that pays: a pass does two
// half-sweeps and, on the way down, the residual and its restriction in one trip through memory, without
// changing what is computed.
#include <cstdint>

#include "cases/global_solve/poisson_neumann.hpp"
#include "core/contract/module.hpp"
#include "references/global_solve/multigrid_solver.cuh"

namespace gpuphys::poisson_neumann {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    solver_.allocate(static_cast<int>(in.b.shape[0]), static_cast<int>(in.b.shape[1]),
                     static_cast<int>(in.b.shape[2]), true, {.leave_out_empty_planes = false});
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    solver_.solve(in.a_diag.data, in.a_x.data, in.a_y.data, in.a_z.data, in.b.data, in.is_dof.data, in.tol,
                  out.x.data);
  }

 private:
  multigrid::Solver solver_;
};

}  // namespace
}  // namespace gpuphys::poisson_neumann

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(poisson_neumann, poisson_neumann::Reference)
}
