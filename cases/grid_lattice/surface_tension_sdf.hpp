// Contract of surface_tension_sdf (specification: cases/grid_lattice/surface_tension_sdf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::surface_tension_sdf {

struct Inputs {
  View<const float, 3> phi;  ///< level set at cell centres, negative inside, m
  float sigma = 0;           ///< surface tension, N/m
  float dx = 0;              ///< edge of a cell, m

  template <class V>
  void visit(V&& v) {
    v.array("phi", phi, "nx,ny,nz", "m", between(-0x1p50, 0x1p50));
    v.scalar("sigma", sigma, "N/m", between(-0x1p20, 0x1p20));
    v.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> fx, fy, fz;  ///< force per volume, N/m^3

  template <class V>
  void visit(V&& v) {
    v.array("fx", fx, "nx,ny,nz", "N/m^3");
    v.array("fy", fy, "nx,ny,nz", "N/m^3");
    v.array("fz", fz, "nx,ny,nz", "N/m^3");
  }
};

}  // namespace gpuphys::surface_tension_sdf
