// Contract of mpm_explicit (specification: cases/particle_grid/mpm_explicit.md).
#pragma once

#include <cstdint>

#include "core/contract/contract.hpp"

namespace gpuphys::mpm_explicit {

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
    visitor.array("v", v, "n,3", "m/s", between(-1e20, 1e20));
    visitor.array("F", F, "n,3,3", "1", between(-1e5, 1e5));
    visitor.scalar("nx", nx, "1", at_least(1));
    visitor.scalar("ny", ny, "1", at_least(1));
    visitor.scalar("nz", nz, "1", at_least(1));
    visitor.scalar("dx", dx, "m", between(0x1p-30, 0x1p30));
    visitor.scalar("dt", dt, "s", positive(1e10));
    visitor.scalar("mass_p", mass_p, "kg", between(1e-20, 1e20));
    visitor.scalar("V0", V0, "m^3", between(1e-20, 1e20));
    visitor.scalar("mu", mu, "Pa", between(0, 1e15));
    visitor.scalar("lambda", lambda, "Pa", between(0, 1e15));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v_new;  ///< velocity gathered from the nodes, m/s
  View<Real, 3> F_new;  ///< (I + dt grad v) F
  View<Real, 2> x_new;  ///< x + dt v, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v_new", v_new, "n,3", "m/s");
    visitor.array("F_new", F_new, "n,3,3", "1");
    visitor.array("x_new", x_new, "n,3", "m");
  }
};

}  // namespace gpuphys::mpm_explicit
