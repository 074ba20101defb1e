// poisson_dirichlet: A x = b on the active cells of a box, A a seven-point matrix of positive face
// conductances with zero beyond every face that has no active cell on its other side; exactly zero on
// inactive cells. FP32 throughout.
//
// The multigrid of poisson_neumann (multigrid_solver.cuh), which sees the faces held at zero as what the
// diagonal holds beyond its couplings. What is this task's own: random conductances. The first coarse level
// conducts less than their mean. And a schedule: the first cycles have relaxation of their own, chosen for
// the residual after five cycles and a way down, which is all that a tolerance of 1e-6 takes. The last way
// down under-relaxes the cells that it comes to last, which leaves a smaller residual for a larger error.
//
// Bound by the passes over the fine grid, which visit only the planes of their tiles with active cells: of
// 256^3 cells, half of them active, 65 % of the planes on the way down and 66 % on the way up.
// docs/lab/global_solve.md has what was measured.
#include <cstdint>

#include "cases/global_solve/poisson_dirichlet.hpp"
#include "core/contract/module.hpp"
#include "references/global_solve/multigrid_solver.cuh"

namespace gpuphys::poisson_dirichlet {
namespace {

/// Chosen with a CPU emulation of the cycle in FP32, the schedule at 128^3 (docs/lab/global_solve.md). Where
/// it is not enough, what follows converges by itself.
constexpr multigrid::Tuning kTuning{
    .omega_down = {1.3f, 1.15f},
    .omega_up = {1.15f, 1.25f},
    .first_coupling = 0.447f,
    .outlook = 3.0f,
    .scheduled = 6,
    .schedule = {{{0.92f, 1.24f}, {1.08f, 1.13f}, 0.85f},
                 {{1.20f, 1.27f}, {1.13f, 1.15f}, 1.03f},
                 {{1.20f, 1.27f}, {1.13f, 1.15f}, 1.03f},
                 {{1.20f, 1.27f}, {1.13f, 1.15f}, 1.03f},
                 {{1.15f, 1.34f}, {1.15f, 1.19f}, 0.98f},
                 {{1.12f, 0.76f}, {1.15f, 1.25f}, 1.00f}},
    .schedule_below = {{1.58f, 1.19f}, {1.20f, 1.87f}},
};

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    solver_.allocate(static_cast<int>(in.b.shape[0]), static_cast<int>(in.b.shape[1]),
                     static_cast<int>(in.b.shape[2]), /*singular=*/false, kTuning);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    solver_.solve(in.a_diag.data, in.a_x.data, in.a_y.data, in.a_z.data, in.b.data, in.is_dof.data, in.tol,
                  out.x.data);
  }

 private:
  multigrid::TiledSolver<16> solver_;
};

}  // namespace
}  // namespace gpuphys::poisson_dirichlet

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(poisson_dirichlet, poisson_dirichlet::Reference)
}
