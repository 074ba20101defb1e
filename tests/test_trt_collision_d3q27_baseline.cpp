// The serial baseline of trt_collision_d3q27, validated on its own: by hand, by conservation, by symmetry and
// by relaxation.
#include <gtest/gtest.h>

#include "tests/time_loops/trt_collision_d3q27.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"trt_collision_d3q27", 27, true, false};

TEST(TrtCollisionD3Q27Baseline, OneCellByHand) {
  testing::expect_one_cell_by_hand(kModule, {8.0 / 27, 2.0 / 27, 1.0 / 54, 1.0 / 216});
}

TEST(TrtCollisionD3Q27Baseline, EvenAndOddPartsHaveTheirOwnRelaxation) {
  testing::expect_parts_relax_on_their_own(kModule);
}

TEST(TrtCollisionD3Q27Baseline, ConservesMassAndMomentumOfTheWholeGrid) {
  testing::expect_totals_conserved(kModule);
}

TEST(TrtCollisionD3Q27Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(TrtCollisionD3Q27Baseline, TheEquilibriumIsKept) {
  testing::expect_equilibrium_kept(kModule);
}

TEST(TrtCollisionD3Q27Baseline, CellsDoNotTouchEachOther) {
  testing::expect_cells_apart(kModule);
}

TEST(TrtCollisionD3Q27Baseline, TimeLoop) {
  testing::time_loop_trt_collision_d3q27("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
