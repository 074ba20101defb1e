// Contracts of the lattice Boltzmann tasks: populations of a D3Q19 or D3Q27 lattice on a periodic grid.
//
// f[q,i,j,k] is the population of velocity q at cell (i,j,k) along (x,y,z), in lattice units (cell size and
// time step 1). The velocities, their order and weights are listed in the tasks' specifications.
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::lattice {

template <int Q>
constexpr const char* shape() {
  static_assert(Q == 19 || Q == 27, "D3Q19 or D3Q27");
  return Q == 19 ? "19,nx,ny,nz" : "27,nx,ny,nz";
}

/// Inputs of the tasks that only stream.
template <int Q>
struct StreamingInputs {
  View<const float, 4> f;  ///< populations

  template <class V>
  void visit(V&& v) {
    v.array("f", f, shape<Q>(), "1");
  }
};

/// Inputs of the tasks that collide with two relaxation times (TRT).
template <int Q>
struct CollisionInputs {
  View<const float, 4> f;  ///< populations
  float tau_plus = 0;      ///< relaxation time of the symmetric part, in time steps, > 1/2
  float magic = 0;         ///< (tau_plus - 1/2)(tau_minus - 1/2), > 0

  template <class V>
  void visit(V&& v) {
    v.array("f", f, shape<Q>(), "1", between(-1e30, 1e30));
    v.scalar("tau_plus", tau_plus, "1", between(0.5001, 1e4));
    v.scalar("magic", magic, "1", between(1e-4, 1e4));
  }
};

template <int Q, class Real>
struct Outputs {
  View<Real, 4> f;  ///< populations after the step

  template <class V>
  void visit(V&& v) {
    v.array("f", f, shape<Q>(), "1");
  }
};

}  // namespace gpuphys::lattice
