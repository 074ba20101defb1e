// The serial baseline of stream_d3q19, validated on its own: by hand, by symmetry, and by bitwise return.
#include <gtest/gtest.h>

#include "tests/time_loops/stream_d3q19.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"stream_d3q19", 19, false, true};

TEST(StreamD3Q19Baseline, EveryPopulationMovesByItsVelocityAndWraps) {
  testing::expect_populations_move(kModule);
}

TEST(StreamD3Q19Baseline, MovesMassAndMomentumAsTheyAre) {
  testing::expect_totals_conserved(kModule);
}

TEST(StreamD3Q19Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(StreamD3Q19Baseline, StreamingOfTheOppositesTakesItBack) {
  testing::expect_opposites_invert(kModule);
}

TEST(StreamD3Q19Baseline, TimeLoop) {
  testing::time_loop_stream_d3q19("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
