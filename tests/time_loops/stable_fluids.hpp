// Time loop of stable_fluids: flow around an obstacle in a closed box, whatever module does the steps.
#pragma once

#include <string>

#include "tests/mac_fluid.hpp"

namespace gpuphys::testing {

/// 100 steps from Taylor-Green modes: kinetic energy never grows, divergence stays at what tol gives.
inline void time_loop_stable_fluids(const std::string& label) {
  const Task& task = find_task("stable_fluids");
  const mac_fluid::Extents n{20, 18, 16};
  Problem p = fluid_at_rest("stable_fluids", n, mac_fluid::ball({9.3, 8.4, 7.6}, 4.2),
                            {{"dx", 0x1p-4}, {"dt", 0x1p-4}, {"nu", 0x1p-12}, {"tol", 1e-4}});
  mac_fluid::set_taylor_green(p, {5, 6, 2});
  const Check divergence = mac_fluid::divergence_check("divergence", CheckKind::invariant, 1e-3, "");
  double earlier = 0;
  for (int step = 0; step < 100; ++step) {
    const Arrays out = run_module(task, label, p);
    const double energy = kinetic_energy(p, out);
    ASSERT_TRUE(std::isfinite(energy)) << "step " << step;
    if (step > 0) {
      EXPECT_LE(energy, earlier * (1 + 1e-6)) << "step " << step;
    }
    EXPECT_LT(divergence.measure({p, out, nullptr}).error, 1e-3) << "step " << step;
    earlier = energy;
    feed_velocity(out, p);
  }
  EXPECT_GT(earlier, 0);
}

}  // namespace gpuphys::testing
