// Input sets and checks of stream_d3q19 (specification: cases/grid_lattice/stream_d3q19.md).
#include "cases/grid_lattice/stream_d3q19.hpp"

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys::stream_d3q19 {

Task make_task() {
  Task task = lattice::step_task(
      {.q = 19, .collides = false, .streams = true, .contract = describe<Inputs, Outputs<float>>()},
      "stream_d3q19", 20, "Periodic streaming of the populations of a D3Q19 lattice", {288, 256, 224}, 0.3,
      0.36);
  task.target_floor_multiple = 1.06;
  return task;
}

}  // namespace gpuphys::stream_d3q19
