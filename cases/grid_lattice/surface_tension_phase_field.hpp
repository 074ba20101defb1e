// Contract of surface_tension_phase_field (specification: cases/grid_lattice/surface_tension_phase_field.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::surface_tension_phase_field {

struct Inputs {
  View<const float, 3> phi;  ///< phase field, 0 outside and 1 inside
  float beta = 0;            ///< strength of the double well
  float kappa = 0;           ///< strength of the gradient energy

  template <class V>
  void visit(V&& v) {
    v.array("phi", phi, "nx,ny,nz", "1", between(-1e6, 1e6));
    v.scalar("beta", beta, "1", between(-1e6, 1e6));
    v.scalar("kappa", kappa, "1", between(-1e6, 1e6));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> fx, fy, fz;  ///< force per volume, lattice units

  template <class V>
  void visit(V&& v) {
    v.array("fx", fx, "nx,ny,nz", "1");
    v.array("fy", fy, "nx,ny,nz", "1");
    v.array("fz", fz, "nx,ny,nz", "1");
  }
};

}  // namespace gpuphys::surface_tension_phase_field
