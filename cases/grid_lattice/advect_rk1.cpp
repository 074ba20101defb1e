// Input sets and checks of advect_rk1 (specification: cases/grid_lattice/advect_rk1.md).
#include "cases/grid_lattice/mac_advection_inputs.hpp"

namespace gpuphys::advect_rk1 {

Task make_task() {
  Task task = mac_advection::semi_lagrangian_task("advect_rk1", 15,
                                                  {.velocity_evaluations = 1, .polynomial = {1.0, 1.0}});
  task.title = "Semi-Lagrangian advection of a MAC-grid velocity with Euler (RK1) back-tracing";
  task.target_floor_multiple = 1.6;
  return task;
}

}  // namespace gpuphys::advect_rk1
