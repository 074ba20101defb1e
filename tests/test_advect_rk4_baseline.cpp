// The serial baseline of advect_rk4, validated on its own.
#include "tests/mac_advection.hpp"

namespace gpuphys::testing {

// P(1/4) by hand: 1 + 1/4 + 1/32 + 1/384 + 1/6144.
INSTANTIATE_TEST_SUITE_P(AdvectRk4Baseline, MacAdvection,
                         ::testing::Values(AdvectionScheme{"advect_rk4", 4,
                                                           1.28125 + 1.0 / 384 + 1.0 / 6144}));

}  // namespace gpuphys::testing
