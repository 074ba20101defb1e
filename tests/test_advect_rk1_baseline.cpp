// The serial baseline of advect_rk1, validated on its own.
#include "tests/mac_advection.hpp"

namespace gpuphys::testing {

// P(1/4) by hand: 1 + 1/4.
INSTANTIATE_TEST_SUITE_P(AdvectRk1Baseline, MacAdvection,
                         ::testing::Values(AdvectionScheme{"advect_rk1", 1, 1.25}));

}  // namespace gpuphys::testing
