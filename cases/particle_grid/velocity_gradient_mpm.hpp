// Contract of velocity_gradient_mpm (specification: cases/particle_grid/velocity_gradient_mpm.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::velocity_gradient_mpm {

struct Inputs {
  View<const float, 2> x;           ///< particle positions, m
  View<const float, 3> ux, uy, uz;  ///< velocity at the nodes, m/s; node [i,j,k] sits at (i, j, k) dx
  float dx = 0;                     ///< spacing of the nodes, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("ux", ux, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.array("uy", uy, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.array("uz", uz, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> G;  ///< velocity gradient, G[p][a][b] = dv_a/dx_b, 1/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("G", G, "n,3,3", "1/s");
  }
};

}  // namespace gpuphys::velocity_gradient_mpm
