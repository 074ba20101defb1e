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
  task.checks = {relative_l2_check("f", 5e-6, "the paper's table of inputs and checks"),
                 local_error_check(
                     "f", 5e-6,
                     "float32 rounding of the largest population, four times the rms, is 2.4e-7 of the rms "
                     "a unit: room for twenty units, and far below a population from a wrong cell (1e-2)")};
  task.target_floor_multiple = 1.08;
  return task;
}

}  // namespace gpuphys::lbm_d3q19
