// Input sets and checks of advect_rk3 (specification: cases/grid_lattice/advect_rk3.md).
#include "cases/grid_lattice/mac_advection_inputs.hpp"

namespace gpuphys::advect_rk3 {

Task make_task() {
  Task task = mac_advection::semi_lagrangian_task(
      "advect_rk3", 17, {.velocity_evaluations = 3, .polynomial = {1.0, 1.0, 0.5, 1.0 / 6}});
  task.title = "Semi-Lagrangian advection of a MAC-grid velocity with Ralston (RK3) back-tracing";
  task.target_floor_multiple = 5.5;
  return task;
}

}  // namespace gpuphys::advect_rk3
