// Input sets and checks of advect_rk4 (specification: cases/grid_lattice/advect_rk4.md).
#include "cases/grid_lattice/mac_advection_inputs.hpp"

namespace gpuphys::advect_rk4 {

Task make_task() {
  Task task = mac_advection::semi_lagrangian_task(
      "advect_rk4", 18, {.velocity_evaluations = 4, .polynomial = {1.0, 1.0, 0.5, 1.0 / 6, 1.0 / 24}});
  task.title = "Semi-Lagrangian advection of a MAC-grid velocity with classical (RK4) back-tracing";
  task.target_floor_multiple = 7.5;
  return task;
}

}  // namespace gpuphys::advect_rk4
