// Contract of g2p_apic (specification: cases/particle_grid/g2p_apic.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::g2p_apic {

struct Inputs {
  View<const float, 2> x;           ///< particle positions, m
  View<const float, 3> ux, uy, uz;  ///< velocity on the faces, m/s
  float dx = 0;                     ///< size of a cell, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("ux", ux, "nx+1,ny,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uy", uy, "nx,ny+1,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uz", uz, "nx,ny,nz+1", "m/s", between(-1.01e30, 1.01e30));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v;  ///< velocity at the particles, m/s
  View<Real, 3> B;  ///< affine state, B[p][c][b] = sum w u_c (x_face - x_p)_b, m^2/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v", v, "n,3", "m/s");
    visitor.array("B", B, "n,3,3", "m^2/s");
  }
};

}  // namespace gpuphys::g2p_apic
