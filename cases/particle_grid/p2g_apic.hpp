// Contract of p2g_apic (specification: cases/particle_grid/p2g_apic.md).
#pragma once

#include <cstdint>

#include "core/contract/contract.hpp"

namespace gpuphys::p2g_apic {

struct Inputs {
  View<const float, 2> x;  ///< particle positions, m
  View<const float, 2> v;  ///< particle velocities, m/s
  View<const float, 3> B;  ///< affine state, B[p][c][b] = dx^2/4 du_c/dx_b of the particle's field
  std::int32_t nx = 0, ny = 0, nz = 0;  ///< cells of the box along each axis
  float dx = 0;                         ///< size of a cell, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("B", B, "n,3,3", "m^2/s", finite());
    visitor.scalar("nx", nx, "1", at_least(1));
    visitor.scalar("ny", ny, "1", at_least(1));
    visitor.scalar("nz", nz, "1", at_least(1));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> ux, uy, uz;  ///< velocity on the faces, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("ux", ux, "nx+1,ny,nz", "m/s");
    visitor.array("uy", uy, "nx,ny+1,nz", "m/s");
    visitor.array("uz", uz, "nx,ny,nz+1", "m/s");
  }
};

}  // namespace gpuphys::p2g_apic
