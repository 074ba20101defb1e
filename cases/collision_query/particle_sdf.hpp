// Contract of particle_sdf (specification: cases/collision_query/particle_sdf.md).
#pragma once

#include <cstdint>

#include "core/contract/contract.hpp"

namespace gpuphys::particle_sdf {

struct Inputs {
  View<const float, 2> x;               ///< particle positions, m
  std::int32_t nx = 0, ny = 0, nz = 0;  ///< cells along each axis; the centre of [i,j,k] is (i+1/2, ...) dx
  float dx = 0;                         ///< edge of a cell, m
  float r = 0;                          ///< radius of every particle, m
  float clamp = 0;                      ///< largest value of phi, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", between(-1e30, 1e30));
    visitor.scalar("nx", nx, "1", between(1, 1 << 20));
    visitor.scalar("ny", ny, "1", between(1, 1 << 20));
    visitor.scalar("nz", nz, "1", between(1, 1 << 20));
    visitor.scalar("dx", dx, "m", between(1e-9, 1e9));
    visitor.scalar("r", r, "m", between(0, 64e9));
    visitor.scalar("clamp", clamp, "m", between(-64e9, 64e9));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> phi;  ///< clamped distance from the union of the particles' spheres, at cell centres, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("phi", phi, "nx,ny,nz", "m");
  }
};

}  // namespace gpuphys::particle_sdf
