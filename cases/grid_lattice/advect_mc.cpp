// Input sets and checks of advect_mc (specification: cases/grid_lattice/advect_mc.md).
#include <fmt/format.h>

#include "cases/grid_lattice/mac_advection_inputs.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::advect_mc {
namespace {

constexpr double kOff = 2e-5;  // of the component's rms: no rounding comes near

// Faces limited by the samples on the other side of a plane are rare; a share of them is allowed for.
Check faces_off(const std::string& array) {
  return {array + "_local",
          CheckKind::local,
          array,
          fmt::format("share of faces that differ by more than {:g} rms", kOff),
          4e-6,
          "a departure point is good to 4e-7 cells in float32 and three planes of samples are near it: "
          "about 2e-6 of the faces may be limited by samples beyond one, and no rounding reaches the bound",
          true,
          [array](const Judged& j) {
            const HostArray& got = find(j.outputs, array, "outputs");
            Measured m = count_above(got, find(*j.truth, array, "truth"), kOff);
            m.error /= static_cast<double>(got.size());
            return m;
          }};
}

}  // namespace

Task make_task() {
  Task task = mac_advection::family_task(
      "advect_mc", 19,
      {.velocity_evaluations = 4, .polynomial = {1.0, 1.0, 0.5, 0.0, -0.125}, .limited = true});
  task.title = "MacCormack advection of a MAC-grid velocity with midpoint (RK2) back-tracing and a limiter";
  for (const std::string u : {"ux", "uy", "uz"}) {
    task.checks.push_back(relative_l2_check(u, 1e-4, "the paper's table of inputs and checks"));
    task.checks.push_back(faces_off(u));
  }
  task.target_floor_multiple = 8;
  return task;
}

}  // namespace gpuphys::advect_mc
