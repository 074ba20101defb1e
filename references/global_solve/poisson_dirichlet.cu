#include <cstdint>

#include "cases/global_solve/poisson_dirichlet.hpp"
#include "core/module.hpp"
#include "references/global_solve/multigrid_solver.cuh"

namespace gpuphys::poisson_dirichlet {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    solver_.allocate(static_cast<int>(in.b.shape[0]), static_cast<int>(in.b.shape[1]),
                     static_cast<int>(in.b.shape[2]), false);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    solver_.solve(in.a_diag.data, in.a_x.data, in.a_y.data, in.a_z.data, in.b.data, in.is_dof.data, in.tol,
                  out.x.data);
  }

 private:
  multigrid::Solver solver_;
};

}  // namespace
}  // namespace gpuphys::poisson_dirichlet

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(poisson_dirichlet, poisson_dirichlet::Reference)
}
