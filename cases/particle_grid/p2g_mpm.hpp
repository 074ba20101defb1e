// Contract of p2g_mpm (specification: cases/particle_grid/p2g_mpm.md).
#pragma once

#include <cstdint>

#include "core/contract/contract.hpp"

namespace gpuphys::p2g_mpm {

struct Inputs {
  View<const float, 2> x;               ///< particle positions, m
  View<const float, 2> v;               ///< particle velocities, m/s
  View<const float, 3> F;               ///< deformation gradients, F[p][a][b] = dx_a/dX_b
  std::int32_t nx = 0, ny = 0, nz = 0;  ///< nodes along each axis; node [i,j,k] sits at (i, j, k) dx
  float dx = 0;                         ///< spacing of the nodes, m
  float dt = 0;                         ///< time step, s
  float mass_p = 0;                     ///< mass of a particle, kg
  float V0 = 0;                         ///< rest volume of a particle, m^3
  float mu = 0, lambda = 0;             ///< Lame parameters, Pa

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1e15, 1e15));
    visitor.array("F", F, "n,3,3", "1", between(-1e4, 1e4));
    visitor.scalar("nx", nx, "1", at_least(1));
    visitor.scalar("ny", ny, "1", at_least(1));
    visitor.scalar("nz", nz, "1", at_least(1));
    visitor.scalar("dx", dx, "m", positive(1e10));
    visitor.scalar("dt", dt, "s", positive(1e10));
    visitor.scalar("mass_p", mass_p, "kg", positive(1e15));
    visitor.scalar("V0", V0, "m^3", positive(1e15));
    visitor.scalar("mu", mu, "Pa", positive(1e15));
    visitor.scalar("lambda", lambda, "Pa", positive(1e15));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> ux, uy, uz;  ///< velocity at the nodes, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("ux", ux, "nx,ny,nz", "m/s");
    visitor.array("uy", uy, "nx,ny,nz", "m/s");
    visitor.array("uz", uz, "nx,ny,nz", "m/s");
  }
};

}  // namespace gpuphys::p2g_mpm
