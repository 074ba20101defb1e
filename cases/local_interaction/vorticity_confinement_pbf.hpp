// Contract of vorticity_confinement_pbf (specification:
// cases/local_interaction/vorticity_confinement_pbf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::vorticity_confinement_pbf {

struct Inputs {
  View<const float, 2> x;  ///< positions, m
  View<const float, 2> v;  ///< velocities, m/s
  float h = 0;             ///< neighbours are nearer than this, m
  float epsilon = 0;       ///< strength of the confinement, m^4
  float dt = 0;            ///< time step, s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1e6, 1e6));
    visitor.scalar("h", h, "m", between(1e-3, 1e3));
    visitor.scalar("epsilon", epsilon, "m^4", between(-1e6, 1e6));
    visitor.scalar("dt", dt, "s", between(-1e3, 1e3));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v_new;  ///< velocities after confinement, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::vorticity_confinement_pbf
