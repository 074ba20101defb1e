// The serial baseline of lbm_d3q27, validated on its own: by hand, by conservation, by symmetry and by the
// viscosity that its flows have.
#include <gtest/gtest.h>

#include "tests/time_loops/lbm_d3q27.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"lbm_d3q27", 27, true, true};

TEST(LbmD3Q27Baseline, OneCellByHand) {
  testing::expect_one_cell_by_hand(kModule, {8.0 / 27, 2.0 / 27, 1.0 / 54, 1.0 / 216});
}

TEST(LbmD3Q27Baseline, EvenAndOddPartsHaveTheirOwnRelaxation) {
  testing::expect_parts_relax_on_their_own(kModule);
}

TEST(LbmD3Q27Baseline, EveryPopulationMovesByItsVelocityAndWraps) {
  testing::expect_populations_move(kModule);
}

TEST(LbmD3Q27Baseline, ConservesMassAndMomentumOfTheWholeGrid) {
  testing::expect_totals_conserved(kModule);
}

TEST(LbmD3Q27Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(LbmD3Q27Baseline, TheEquilibriumIsKept) {
  testing::expect_equilibrium_kept(kModule);
}

TEST(LbmD3Q27Baseline, AShearWaveDecaysWithTheViscosityOfTauPlus) {
  testing::expect_viscosity_of_tau_plus(kModule);
}

TEST(LbmD3Q27Baseline, TimeLoop) {
  testing::time_loop_lbm_d3q27("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
