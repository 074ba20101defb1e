// Contract of pbf (specification: cases/position_constraint/pbf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::pbf {

struct Inputs {
  View<const float, 2> x;        ///< positions at the beginning of the step, m
  View<const float, 2> v;        ///< velocities, m/s
  float h = 0;                   ///< neighbours are nearer than this, m
  float rho0 = 0;                ///< rest density, > 0, 1/m^3
  float eps = 0;                 ///< relaxation of the constraint, > 0, 1/m^2
  float k_corr = 0;              ///< strength of the artificial pressure, >= 0, m^2
  float dq = 0;                  ///< distance where it is k_corr, in units of h
  std::int32_t iters = 0;        ///< Jacobi iterations, >= 0
  float dt = 0;                  ///< time step, > 0, s
  float gx = 0, gy = 0, gz = 0;  ///< gravity, m/s^2
  float c_visc = 0;              ///< XSPH viscosity, m^3
  float vort_eps = 0;            ///< strength of the vorticity confinement, m^4

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1e6, 1e6));
    visitor.scalar("h", h, "m", between(1e-3, 1e3));
    visitor.scalar("rho0", rho0, "1/m^3", positive());
    visitor.scalar("eps", eps, "1/m^2", positive());
    visitor.scalar("k_corr", k_corr, "m^2", at_least(0));
    visitor.scalar("dq", dq, "", between(0, 0.9));
    visitor.scalar("iters", iters, "", between(0, 1000));
    visitor.scalar("dt", dt, "s", between(1e-6, 1e3));
    visitor.scalar("gx", gx, "m/s^2", between(-1e6, 1e6));
    visitor.scalar("gy", gy, "m/s^2", between(-1e6, 1e6));
    visitor.scalar("gz", gz, "m/s^2", between(-1e6, 1e6));
    visitor.scalar("c_visc", c_visc, "m^3", finite());
    visitor.scalar("vort_eps", vort_eps, "m^4", between(-1e6, 1e6));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< positions at the end of the step, m
  View<Real, 2> v_new;  ///< velocities at the end of the step, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x_new", x_new, "n,3", "m");
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::pbf
