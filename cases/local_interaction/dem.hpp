// Contract of dem (specification: cases/local_interaction/dem.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::dem {

struct Inputs {
  View<const float, 2> x;       ///< centres of the grains, m
  View<const float, 2> v;       ///< velocities, m/s
  View<const float, 2> omega;   ///< angular velocities, rad/s
  View<const float, 1> radius;  ///< radii, m
  float kn = 0;                 ///< Hertz stiffness, N/m^2
  float cn = 0;                 ///< normal damping, N s/m^2
  float gt = 0;                 ///< tangential damping: friction while its cap is not reached, N s/m
  float mu = 0;                 ///< friction coefficient: the cap is mu times the normal force
  float rho = 0;                ///< density of the grains, kg/m^3
  float dt = 0;                 ///< time step, s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", between(-1e9, 1e9));
    visitor.array("v", v, "n,3", "m/s", between(-1e9, 1e9));
    visitor.array("omega", omega, "n,3", "rad/s", between(-1e6, 1e6));
    visitor.array("radius", radius, "n", "m", between(1e-6, 1e6));
    visitor.scalar("kn", kn, "N/m^2", between(0, 1e12));
    visitor.scalar("cn", cn, "N s/m^2", between(0, 1e12));
    visitor.scalar("gt", gt, "N s/m", between(0, 1e12));
    visitor.scalar("mu", mu, "1", between(0, 1e6));
    visitor.scalar("rho", rho, "kg/m^3", between(1e-3, 1e6));
    visitor.scalar("dt", dt, "s", between(1e-9, 1e3));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;      ///< centres after the step, m
  View<Real, 2> v_new;      ///< velocities after the step, m/s
  View<Real, 2> omega_new;  ///< angular velocities after the step, rad/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x_new", x_new, "n,3", "m");
    visitor.array("v_new", v_new, "n,3", "m/s");
    visitor.array("omega_new", omega_new, "n,3", "rad/s");
  }
};

}  // namespace gpuphys::dem
