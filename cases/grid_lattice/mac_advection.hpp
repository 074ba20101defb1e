// The contract shared by the semi-Lagrangian advection tasks: a velocity on a staggered (MAC) grid, carried
// by itself.
//
// Component c of the velocity is sampled at the centres of the cell faces normal to axis c: ux[i,j,k] sits at
// (i, j+1/2, k+1/2) dx, uy[i,j,k] at (i+1/2, j, k+1/2) dx and uz[i,j,k] at (i+1/2, j+1/2, k) dx.
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::mac_advection {

struct Inputs {
  View<const float, 3> ux, uy, uz;  ///< velocity, m/s
  float dt = 0;                     ///< time step, s
  float dx = 0;                     ///< cell size, m

  template <class V>
  void visit(V&& v) {
    v.array("ux", ux, "nx+1,ny,nz", "m/s", between(-5e37, 5e37));
    v.array("uy", uy, "nx,ny+1,nz", "m/s", between(-5e37, 5e37));
    v.array("uz", uz, "nx,ny,nz+1", "m/s", between(-5e37, 5e37));
    v.scalar("dt", dt, "s", between(0, 1e30));
    v.scalar("dx", dx, "m", positive(1e30));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> ux, uy, uz;  ///< advected velocity, m/s

  template <class V>
  void visit(V&& v) {
    v.array("ux", ux, "nx+1,ny,nz", "m/s");
    v.array("uy", uy, "nx,ny+1,nz", "m/s");
    v.array("uz", uz, "nx,ny,nz+1", "m/s");
  }
};

}  // namespace gpuphys::mac_advection
