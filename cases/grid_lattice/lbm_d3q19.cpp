// Input sets and checks of lbm_d3q19 (specification: cases/grid_lattice/lbm_d3q19.md).
#include "cases/grid_lattice/lbm_d3q19.hpp"

#include "cases/grid_lattice/lattice_inputs.hpp"
#include "core/comparators.hpp"
#include "core/task.hpp"

namespace gpuphys::lbm_d3q19 {

Task make_task() {
  Task task;
  task.name = "lbm_d3q19";
  task.family = "grid_lattice";
  task.title = "One D3Q19 lattice Boltzmann step: two-relaxation-time collision, then periodic streaming";
  task.paper_number = 24;
  task.contract = describe<Inputs, Outputs<float>>();
  const lattice::Step step{19, true, true, task.contract};
  task.sets = lattice::flow_sets(step, {288, 256, 224}, 0.25, 0.21);
  for (InputSet& set : lattice::collision_hard_cases(step)) task.sets.push_back(std::move(set));
  task.checks = {
      relative_l2_check("f", 5e-6, "the paper's table of inputs and checks"),
      local_error_check(
          "f", 1e-5,
          "the rest population is four times the rms, so one float32 unit of it is 3.5e-7 of the rms, and "
          "the density enters it with the rounding of a sum of nineteen: room for thirty units, and a "
          "thousand times below a population from a wrong cell")};
  task.target_floor_multiple = 1.08;
  return task;
}

}  // namespace gpuphys::lbm_d3q19
