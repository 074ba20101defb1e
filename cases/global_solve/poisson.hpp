// The contract shared by the Poisson solves: a symmetric seven-point system on the active cells of a box.
//
// (A x)[i,j,k] = a_diag[i,j,k] x[i,j,k] + a_x[i,j,k] x[i+1,j,k] + a_x[i-1,j,k] x[i-1,j,k] + the same along y
// and z: the arrays hold signed matrix entries, a_x[i,j,k] the one that couples (i,j,k) and (i+1,j,k).
// A solver may use the input buffers as scratch memory, as in the paper.
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::poisson {

struct Inputs {
  View<const float, 3> a_diag;         ///< diagonal, > 0 on active cells
  View<const float, 3> a_x, a_y, a_z;  ///< couplings to the next cell along x, y, z, <= 0
  View<const float, 3> b;              ///< right-hand side, 0 on inactive cells
  View<const bool, 3> is_dof;          ///< true where the cell is active
  float tol = 0;                       ///< bound on ||b - A x|| / ||b||

  template <class V>
  void visit(V&& v) {
    v.array("a_diag", a_diag, "nx,ny,nz", "1", Access::overwritable, between(0, 1e15));
    v.array("a_x", a_x, "nx,ny,nz", "1", Access::overwritable, between(-1e15, 0));
    v.array("a_y", a_y, "nx,ny,nz", "1", Access::overwritable, between(-1e15, 0));
    v.array("a_z", a_z, "nx,ny,nz", "1", Access::overwritable, between(-1e15, 0));
    v.array("b", b, "nx,ny,nz", "1", Access::overwritable);
    v.array("is_dof", is_dof, "nx,ny,nz", "1", Access::overwritable);
    v.scalar("tol", tol, "1", positive(1));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> x;  ///< solution, exactly 0 on inactive cells

  template <class V>
  void visit(V&& v) {
    v.array("x", x, "nx,ny,nz", "1");
  }
};

}  // namespace gpuphys::poisson
