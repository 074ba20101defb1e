// Input sets and checks of trt_collision_d3q27 (specification: cases/grid_lattice/trt_collision_d3q27.md).
#include "cases/grid_lattice/trt_collision_d3q27.hpp"

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys::trt_collision_d3q27 {

Task make_task() {
  Task task = lattice::step_task(
      {.q = 27, .collides = true, .streams = false, .contract = describe<Inputs, Outputs<float>>()},
      "trt_collision_d3q27", 23, "Two-relaxation-time collision on a D3Q27 lattice", {256, 256, 256}, 0.2,
      0.17);
  task.target_floor_multiple = 1.08;
  return task;
}

}  // namespace gpuphys::trt_collision_d3q27
