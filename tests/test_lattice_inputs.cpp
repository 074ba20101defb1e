// The velocity sets that generate and judge the lattice tasks, against the moments that a lattice must have.
#include <gtest/gtest.h>

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys {
namespace {

TEST(LatticeVelocitySet, MomentsAreThoseOfAnIsotropicLattice) {
  for (const int size : {19, 27}) {
    const lattice::VelocitySet& s = lattice::velocity_set(size);
    ASSERT_EQ(s.c.size(), static_cast<std::size_t>(size));
    double mass = 0, second[3][3] = {}, fourth_xxxx = 0, fourth_xxyy = 0;
    for (std::size_t q = 0; q < s.c.size(); ++q) {
      const auto& c = s.c[q];
      mass += s.w[q];
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) second[a][b] += s.w[q] * c[a] * c[b];
      }
      fourth_xxxx += s.w[q] * c[0] * c[0] * c[0] * c[0];
      fourth_xxyy += s.w[q] * c[0] * c[0] * c[1] * c[1];
      if (q % 2 == 1) {
        for (std::size_t d = 0; d < 3; ++d) EXPECT_EQ(c[d], -s.c[q + 1][d]) << "opposites are neighbours";
      }
      for (std::size_t p = 0; p < q; ++p) EXPECT_NE(s.c[p], c) << "velocities differ";
    }
    EXPECT_NEAR(mass, 1, 1e-15);
    EXPECT_NEAR(fourth_xxxx, 1.0 / 3, 1e-15);
    EXPECT_NEAR(fourth_xxyy, 1.0 / 9, 1e-15);
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) EXPECT_NEAR(second[a][b], a == b ? 1.0 / 3 : 0, 1e-15);
    }
  }
}

}  // namespace
}  // namespace gpuphys
