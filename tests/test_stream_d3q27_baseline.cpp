// The serial baseline of stream_d3q27, validated on its own: by hand, by symmetry, and by bitwise return.
#include <gtest/gtest.h>

#include "tests/time_loops/stream_d3q27.hpp"

namespace gpuphys {
namespace {

const testing::LatticeModule kModule{"stream_d3q27", 27, false, true};

TEST(StreamD3Q27Baseline, EveryPopulationMovesByItsVelocityAndWraps) {
  testing::expect_populations_move(kModule);
}

TEST(StreamD3Q27Baseline, MovesMassAndMomentumAsTheyAre) {
  testing::expect_totals_conserved(kModule);
}

TEST(StreamD3Q27Baseline, AMirroredLatticeGivesTheMirroredResult) {
  testing::expect_mirror_symmetry(kModule);
}

TEST(StreamD3Q27Baseline, StreamingOfTheOppositesTakesItBack) {
  testing::expect_opposites_invert(kModule);
}

TEST(StreamD3Q27Baseline, TimeLoop) {
  testing::time_loop_stream_d3q27("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
