// Input sets and checks of trt_collision_d3q19 (specification: cases/grid_lattice/trt_collision_d3q19.md).
#include "cases/grid_lattice/trt_collision_d3q19.hpp"

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys::trt_collision_d3q19 {

Task make_task() {
  Task task = lattice::step_task(
      {.q = 19, .collides = true, .streams = false, .contract = describe<Inputs, Outputs<float>>()},
      "trt_collision_d3q19", 22, "Two-relaxation-time collision on a D3Q19 lattice", {256, 256, 256}, 0.3,
      0.26);
  task.target_floor_multiple = 1.06;
  return task;
}

}  // namespace gpuphys::trt_collision_d3q19
