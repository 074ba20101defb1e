// Input sets and checks of lbm_d3q27 (specification: cases/grid_lattice/lbm_d3q27.md).
#include "cases/grid_lattice/lbm_d3q27.hpp"

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys::lbm_d3q27 {

Task make_task() {
  Task task = lattice::step_task(
      {.q = 27, .collides = true, .streams = true, .contract = describe<Inputs, Outputs<float>>()},
      "lbm_d3q27", 25,
      "One D3Q27 lattice Boltzmann step: two-relaxation-time collision, then periodic streaming",
      {288, 256, 224}, 0.18, 0.15);
  task.target_floor_multiple = 1.08;
  return task;
}

}  // namespace gpuphys::lbm_d3q27
