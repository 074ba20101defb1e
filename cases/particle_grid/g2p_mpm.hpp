// Contract of g2p_mpm (specification: cases/particle_grid/g2p_mpm.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::g2p_mpm {

struct Inputs {
  View<const float, 2> x;           ///< particle positions, m
  View<const float, 3> F;           ///< deformation gradients, F[p][a][b] = dx_a/dX_b
  View<const float, 3> ux, uy, uz;  ///< velocity at the nodes, m/s; node [i,j,k] sits at (i, j, k) dx
  float dx = 0;                     ///< spacing of the nodes, m
  float dt = 0;                     ///< time step, s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("F", F, "n,3,3", "1", between(-1e5, 1e5));
    visitor.array("ux", ux, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.array("uy", uy, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.array("uz", uz, "nx,ny,nz", "m/s", between(-1e20, 1e20));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
    visitor.scalar("dt", dt, "s", positive(1e10));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v;      ///< velocity gathered from the nodes, m/s
  View<Real, 3> F_new;  ///< (I + dt grad v) F
  View<Real, 2> x_new;  ///< x + dt v, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v", v, "n,3", "m/s");
    visitor.array("F_new", F_new, "n,3,3", "1");
    visitor.array("x_new", x_new, "n,3", "m");
  }
};

}  // namespace gpuphys::g2p_mpm
