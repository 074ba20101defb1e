// The serial baseline of trt_collision_d3q19, validated on its own: by hand, by conservation, by symmetry and
// by relaxation.
#include <gtest/gtest.h>

#include "tests/time_loops/trt_collision_d3q19.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"trt_collision_d3q19", 19, true, false};

TEST(TrtCollisionD3Q19Baseline, OneCellByHand) {
  testing::expect_one_cell_by_hand(kModule, {1.0 / 3, 1.0 / 18, 1.0 / 36, 0});
}

TEST(TrtCollisionD3Q19Baseline, EvenAndOddPartsHaveTheirOwnRelaxation) {
  testing::expect_parts_relax_on_their_own(kModule);
}

TEST(TrtCollisionD3Q19Baseline, ConservesMassAndMomentumOfTheWholeGrid) {
  testing::expect_totals_conserved(kModule);
}

TEST(TrtCollisionD3Q19Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(TrtCollisionD3Q19Baseline, TheEquilibriumIsKept) {
  testing::expect_equilibrium_kept(kModule);
}

TEST(TrtCollisionD3Q19Baseline, CellsDoNotTouchEachOther) {
  testing::expect_cells_apart(kModule);
}

TEST(TrtCollisionD3Q19Baseline, TimeLoop) {
  testing::time_loop_trt_collision_d3q19("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
