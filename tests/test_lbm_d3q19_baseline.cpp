// The serial baseline of lbm_d3q19, validated on its own: by hand, by conservation, by symmetry and by the
// viscosity that its flows have.
#include <gtest/gtest.h>

#include "tests/time_loops/lbm_d3q19.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"lbm_d3q19", 19, true, true};

TEST(LbmD3Q19Baseline, OneCellByHand) {
  testing::expect_one_cell_by_hand(kModule, {1.0 / 3, 1.0 / 18, 1.0 / 36, 0});
}

TEST(LbmD3Q19Baseline, EvenAndOddPartsHaveTheirOwnRelaxation) {
  testing::expect_parts_relax_on_their_own(kModule);
}

TEST(LbmD3Q19Baseline, EveryPopulationMovesByItsVelocityAndWraps) {
  testing::expect_populations_move(kModule);
}

TEST(LbmD3Q19Baseline, ConservesMassAndMomentumOfTheWholeGrid) {
  testing::expect_totals_conserved(kModule);
}

TEST(LbmD3Q19Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(LbmD3Q19Baseline, TheEquilibriumIsKept) {
  testing::expect_equilibrium_kept(kModule);
}

TEST(LbmD3Q19Baseline, AShearWaveDecaysWithTheViscosityOfTauPlus) {
  testing::expect_viscosity_of_tau_plus(kModule);
}

TEST(LbmD3Q19Baseline, TimeLoop) {
  testing::time_loop_lbm_d3q19("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
