// Contract of cahn_hilliard (specification: cases/grid_lattice/cahn_hilliard.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::cahn_hilliard {

struct Inputs {
  View<const float, 4> h;           ///< populations of a D3Q19 lattice, whose sum is the phase field
  View<const float, 3> ux, uy, uz;  ///< velocity of the fluid, lattice units
  float tau = 0;                    ///< relaxation time, in time steps
  float beta = 0;                   ///< strength of the double well
  float kappa = 0;                  ///< strength of the gradient energy
  float eta = 0;                    ///< mobility is eta (tau - 1/2)/3

  template <class V>
  void visit(V&& v) {
    v.array("h", h, "19,nx,ny,nz", "1", between(-1e6, 1e6));
    v.array("ux", ux, "nx,ny,nz", "1", between(-1, 1));
    v.array("uy", uy, "nx,ny,nz", "1", between(-1, 1));
    v.array("uz", uz, "nx,ny,nz", "1", between(-1, 1));
    v.scalar("tau", tau, "1", Valid{0.5, 1e6, true, {}});
    v.scalar("beta", beta, "1", between(0, 1e3));
    v.scalar("kappa", kappa, "1", between(0, 1e3));
    v.scalar("eta", eta, "1", between(-1e3, 1e3));
  }
};

template <class Real>
struct Outputs {
  View<Real, 4> h;  ///< populations after the step

  template <class V>
  void visit(V&& v) {
    v.array("h", h, "19,nx,ny,nz", "1");
  }
};

}  // namespace gpuphys::cahn_hilliard
