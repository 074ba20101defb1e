// stable_fluids: one step of a fluid on a MAC grid with cut cells, FP32: semi-Lagrangian advection, implicit
// viscosity, pressure projection.
//
// Composed of the blocks of the single tasks: the march of the advection tasks with closed faces kept at rest
// (references/blocks/closed_advection.cuh), viscosity component by component and projection as seven-point
// systems (mac_systems.cuh), and the multigrid of the Poisson tasks for all four of them.
//
// What bounds it: the fine-grid passes of the four solves, some twelve to sixteen cycles in all; advection is
// bound by L1 (0.58 ms at paper size). The host waits once per cycle, to decide whether another one is
// needed.
//
// GPUPHYS_OTHER_BLOCKS chooses other tiles for the march and other blocks for the kernels around the
// multigrid.
#include "cases/global_solve/stable_fluids.hpp"

#include "references/blocks/closed_advection.cuh"
#include "references/global_solve/mac_systems.cuh"

namespace gpuphys::stable_fluids {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    mac::require_supported(in.ux, in.uy, in.uz);
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    advected_.allocate(in.ux, in.uy, in.uz);
    buffers_.allocate(g);
    viscosity_.allocate(g.n[0], g.n[1], g.n[2], /*singular=*/false, mac_systems::kViscosityTuning);
    pressure_.allocate(g.n[0], g.n[1], g.n[2], /*singular=*/true, mac_systems::kPressureTuning);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    const mac_systems::Open open{{in.wx.data, in.wy.data, in.wz.data}};
    const mac::OpenFaces open_faces{{in.wx.data, in.wy.data, in.wz.data}, {g.n[0], g.n[1], g.n[2]}};
    const mac::FaceArrays advected = advected_.arrays();
    mac::launch_march<mac::ClosedMarch>(
        mac::make_velocity(in.ux, in.uy, in.uz),
        mac::ClosedSemiLagrangian{
            mac::MidpointTrace{-(in.dt / in.dx)}, open_faces, {advected.u[0], advected.u[1], advected.u[2]}});

    const float alpha = in.nu / in.dx * (in.dt / in.dx);
    float* const u[3] = {out.ux.data, out.uy.data, out.uz.data};
    mac_systems::apply_viscosity<0>(g, open, advected.u[0], alpha, in.tol, buffers_, viscosity_, u[0]);
    mac_systems::apply_viscosity<1>(g, open, advected.u[1], alpha, in.tol, buffers_, viscosity_, u[1]);
    mac_systems::apply_viscosity<2>(g, open, advected.u[2], alpha, in.tol, buffers_, viscosity_, u[2]);

    mac_systems::project(g, open, u, in.tol, buffers_, pressure_, u);
  }

 private:
  mac::FaceBuffers advected_;
  mac_systems::SystemBuffers buffers_;
  multigrid::Solver viscosity_, pressure_;
};

}  // namespace
}  // namespace gpuphys::stable_fluids

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(stable_fluids, stable_fluids::Reference)
}
