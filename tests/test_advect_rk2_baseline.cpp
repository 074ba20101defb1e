// The serial baseline of advect_rk2, validated on its own.
#include "tests/mac_advection.hpp"

namespace gpuphys::testing {

// P(1/4) by hand: 1 + 1/4 + 1/32.
INSTANTIATE_TEST_SUITE_P(AdvectRk2Baseline, MacAdvection,
                         ::testing::Values(AdvectionScheme{"advect_rk2", 2, 1.28125}));

}  // namespace gpuphys::testing
