// The serial baseline of advect_rk3, validated on its own.
#include "tests/mac_advection.hpp"

namespace gpuphys::testing {

// P(1/4) by hand: 1 + 1/4 + 1/32 + 1/384.
INSTANTIATE_TEST_SUITE_P(AdvectRk3Baseline, MacAdvection,
                         ::testing::Values(AdvectionScheme{"advect_rk3", 3, 1.28125 + 1.0 / 384}));

}  // namespace gpuphys::testing
