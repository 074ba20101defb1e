// Input sets and checks of advect_rk2 (specification: cases/grid_lattice/advect_rk2.md).
#include "cases/grid_lattice/mac_advection_inputs.hpp"
#include "core/task.hpp"

namespace gpuphys::advect_rk2 {

Task make_task() {
  Task task;
  task.name = "advect_rk2";
  task.family = "grid_lattice";
  task.title = "Semi-Lagrangian advection of a MAC-grid velocity with midpoint (RK2) back-tracing";
  task.paper_number = 16;
  task.contract = mac_advection::contract();
  task.sets = mac_advection::input_sets();
  // Stability polynomial of the midpoint rule.
  task.sets.push_back(mac_advection::linear_field_set(32, {1.0, 1.0, 0.5}));
  task.checks = mac_advection::checks(
      1e-6, 5e-6, "the paper's table of inputs and checks",
      "float32 displacements of up to 10 cells are good to 1e-6 cells and neighbouring samples differ by up "
      "to half an rms "
      "velocity: ten times that, and below any face that uses another scheme or sample");
  task.target_floor_multiple = 3.5;
  return task;
}

}  // namespace gpuphys::advect_rk2
