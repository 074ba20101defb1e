// Input sets and checks of advect_rk2 (specification: cases/grid_lattice/advect_rk2.md).
#include "cases/grid_lattice/mac_advection_inputs.hpp"

namespace gpuphys::advect_rk2 {

Task make_task() {
  Task task = mac_advection::semi_lagrangian_task("advect_rk2", 16,
                                                  {.velocity_evaluations = 2, .polynomial = {1.0, 1.0, 0.5}});
  task.title = "Semi-Lagrangian advection of a MAC-grid velocity with midpoint (RK2) back-tracing";
  task.target_floor_multiple = 3.5;
  return task;
}

}  // namespace gpuphys::advect_rk2
