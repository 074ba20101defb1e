// Contract of contact_dem (specification: cases/local_interaction/contact_dem.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::contact_dem {

struct Inputs {
  View<const float, 2> x;       ///< centres of the grains, m
  View<const float, 2> v;       ///< velocities, m/s
  View<const float, 1> radius;  ///< radii, > 0, m
  float kn = 0;                 ///< Hertz stiffness: the force is kn sqrt(r* overlap) overlap
  float cn = 0;                 ///< damping: minus cn sqrt(r* overlap) times the speed of separation

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", between(-1e15, 1e15));
    visitor.array("v", v, "n,3", "m/s", between(-1e15, 1e15));
    visitor.array("radius", radius, "n", "m", between(1e-15, 1e15));
    visitor.scalar("kn", kn, "N/m^2", at_least(0));
    visitor.scalar("cn", cn, "N s/m^2", at_least(0));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> force;  ///< sum of the normal contact forces on each grain, N

  template <class V>
  void visit(V&& visitor) {
    visitor.array("force", force, "n,3", "N");
  }
};

}  // namespace gpuphys::contact_dem
