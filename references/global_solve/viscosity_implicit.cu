// viscosity_implicit: implicit viscosity of the three velocity components on a MAC grid with cut cells, each
// a seven-point system of its own, FP32.
//
// Per component: one kernel assembles the system in the layout of the multigrid (mac_systems.cuh), the
// multigrid of the Poisson tasks solves it from zero (multigrid_solver.cuh) and measures the true residual of
// what it returns, one kernel writes the faces. The open fraction is a mass term to the multigrid, neighbours
// at rest are faces held at zero; both are what the diagonal holds beyond its couplings.
//
// What bounds it: the passes of the cycles over the fine grid, as in the Poisson tasks: three components of
// three to four cycles each at the paper's tolerance; assembly and writing move 29 bytes per entry and
// component. The host waits once per cycle, to decide whether another one is needed.
//
// GPUPHYS_OTHER_BLOCKS chooses other blocks for the kernels around the multigrid (mac_systems.cuh).
#include "cases/global_solve/viscosity_implicit.hpp"

#include "references/global_solve/mac_systems.cuh"

namespace gpuphys::viscosity_implicit {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    buffers_.allocate(g);
    solver_.allocate(g.n[0], g.n[1], g.n[2], /*singular=*/false, mac_systems::kViscosityTuning);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    const mac_systems::Open open{{in.wx.data, in.wy.data, in.wz.data}};
    // In this order neither dt / dx^2 nor the product leaves float32 where alpha does not.
    const float alpha = in.nu / in.dx * (in.dt / in.dx);
    mac_systems::apply_viscosity<0>(g, open, in.ux.data, alpha, in.tol, buffers_, solver_, out.ux.data);
    mac_systems::apply_viscosity<1>(g, open, in.uy.data, alpha, in.tol, buffers_, solver_, out.uy.data);
    mac_systems::apply_viscosity<2>(g, open, in.uz.data, alpha, in.tol, buffers_, solver_, out.uz.data);
  }

 private:
  mac_systems::SystemBuffers buffers_;
  multigrid::Solver solver_;
};

}  // namespace
}  // namespace gpuphys::viscosity_implicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(viscosity_implicit, viscosity_implicit::Reference)
}
