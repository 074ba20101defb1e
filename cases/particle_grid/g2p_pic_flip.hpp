// Contract of g2p_pic_flip (specification: cases/particle_grid/g2p_pic_flip.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::g2p_pic_flip {

struct Inputs {
  View<const float, 2> x;                       ///< particle positions, m
  View<const float, 2> v;                       ///< particle velocities, m/s
  View<const float, 3> ux_old, uy_old, uz_old;  ///< velocity on the faces before the step, m/s
  View<const float, 3> ux_new, uy_new, uz_new;  ///< the same after it
  float dx = 0;                                 ///< size of a cell, m
  float flip = 0;  ///< share of the change (FLIP); the rest is the new velocity (PIC)

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("ux_old", ux_old, "nx+1,ny,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uy_old", uy_old, "nx,ny+1,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uz_old", uz_old, "nx,ny,nz+1", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("ux_new", ux_new, "nx+1,ny,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uy_new", uy_new, "nx,ny+1,nz", "m/s", between(-1.01e30, 1.01e30));
    visitor.array("uz_new", uz_new, "nx,ny,nz+1", "m/s", between(-1.01e30, 1.01e30));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
    visitor.scalar("flip", flip, "1", between(0, 1));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v_new;  ///< new particle velocities, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::g2p_pic_flip
