// mc_r: one advection-reflection step of a fluid on a MAC grid with cut cells, FP32: half a step of
// MacCormack advection, projection, reflection, half a step along the projected velocity, projection.
//
// Composed of the blocks of the single tasks: MacCormack marches with closed faces kept at rest
// (references/blocks/closed_advection.cuh), projection as a seven-point system (mac_systems.cuh) and the
// multigrid of the Poisson tasks. The reflection is formed where the gradient is subtracted: 2 u_1/2 - u~
// takes no pass of its own.
//
// What bounds it: the marches, by L1 (1.34 ms per advection at paper size), and the fine-grid passes of the
// two solves, some four cycles each. The host waits once per cycle, to decide whether another one is needed.
//
// GPUPHYS_OTHER_BLOCKS chooses other tiles for the marches and other blocks for the kernels around the
// multigrid.
#include "cases/global_solve/mc_r.hpp"

#include "references/blocks/closed_advection.cuh"
#include "references/global_solve/mac_systems.cuh"

namespace gpuphys::mc_r {
namespace {

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    mac::require_supported(in.ux, in.uy, in.uz);
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    for (mac::FaceBuffers* b : {&middle_, &reflected_}) b->allocate(in.ux, in.uy, in.uz);
    advection_.allocate(in.ux, in.uy, in.uz);
    buffers_.allocate(g);
    pressure_.allocate(g.n[0], g.n[1], g.n[2], /*singular=*/true, mac_systems::kPressureTuning);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const mac_systems::Grid g = mac_systems::make_grid(in.ux, in.uy);
    const mac_systems::Open open{{in.wx.data, in.wy.data, in.wz.data}};
    const mac::OpenFaces open_faces{{in.wx.data, in.wy.data, in.wz.data}, {g.n[0], g.n[1], g.n[2]}};
    const float half_step = 0.5f * (in.dt / in.dx);
    const mac::FaceArrays middle = middle_.arrays(), reflected = reflected_.arrays();

    const float* const start[3] = {in.ux.data, in.uy.data, in.uz.data};
    advection_.advect(mac::make_velocity(in.ux, in.uy, in.uz), open_faces, start, half_step, middle);
    mac_systems::project(g, open, middle.u, in.tol, buffers_, pressure_, middle.u, reflected.u);

    const auto samples = [](const float* u, const View<const float, 3>& like) {
      return View<const float, 3>{u, {like.shape[0], like.shape[1], like.shape[2]}};
    };
    const mac::Velocity by = mac::make_velocity(samples(middle.u[0], in.ux), samples(middle.u[1], in.uy),
                                                samples(middle.u[2], in.uz));
    const float* const carried[3] = {reflected.u[0], reflected.u[1], reflected.u[2]};
    const mac::FaceArrays u{{out.ux.data, out.uy.data, out.uz.data}};
    advection_.advect(by, open_faces, carried, half_step, u);
    mac_systems::project(g, open, u.u, in.tol, buffers_, pressure_, u.u);
  }

 private:
  mac::FaceBuffers middle_, reflected_;
  mac::ClosedMacCormack advection_;
  mac_systems::SystemBuffers buffers_;
  multigrid::Solver pressure_;
};

}  // namespace
}  // namespace gpuphys::mc_r

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(mc_r, mc_r::Reference)
}
