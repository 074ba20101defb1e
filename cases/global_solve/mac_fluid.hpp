// Contracts of the fluid steps on a staggered (MAC) grid with cut-cell obstacles.
//
// Component c of the velocity is sampled on the cell faces normal to axis c, as in
// cases/grid_lattice/mac_advection.hpp; w holds the open fraction of each of these faces.
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::mac_fluid {

constexpr double kMostSpeed = 1e15;  ///< m/s: squares stay in float32 once scaled

struct Inputs {
  View<const float, 3> ux, uy, uz;  ///< velocity, m/s
  View<const float, 3> wx, wy, wz;  ///< open fraction of the faces
  float dx = 0;                     ///< cell size, m
  float dt = 0;                     ///< time step, s
  float tol = 0;                    ///< bound on the relative residual of every solve

  template <class V>
  void visit(V&& v) {
    arrays(v);
    v.scalar("tol", tol, "1", between(1e-6, 0.1));
  }

  template <class V>
  void arrays(V&& v) {
    const Valid speed = between(-kMostSpeed, kMostSpeed), open = between(0, 1);
    v.array("ux", ux, "nx+1,ny,nz", "m/s", speed);
    v.array("uy", uy, "nx,ny+1,nz", "m/s", speed);
    v.array("uz", uz, "nx,ny,nz+1", "m/s", speed);
    v.array("wx", wx, "nx+1,ny,nz", "1", open);
    v.array("wy", wy, "nx,ny+1,nz", "1", open);
    v.array("wz", wz, "nx,ny,nz+1", "1", open);
    v.scalar("dx", dx, "m", positive());
    v.scalar("dt", dt, "s", at_least(0));
  }
};

/// The same with viscosity.
struct ViscousInputs : Inputs {
  float nu = 0;  ///< kinematic viscosity, m^2/s

  template <class V>
  void visit(V&& v) {
    arrays(v);
    v.scalar("nu", nu, "m^2/s", at_least(0));
    v.scalar("tol", tol, "1", between(1e-6, 0.1));
  }
};

template <class Real>
struct Outputs {
  View<Real, 3> ux, uy, uz;  ///< velocity after the step, m/s

  template <class V>
  void visit(V&& v) {
    v.array("ux", ux, "nx+1,ny,nz", "m/s");
    v.array("uy", uy, "nx,ny+1,nz", "m/s");
    v.array("uz", uz, "nx,ny,nz+1", "m/s");
  }
};

}  // namespace gpuphys::mac_fluid
