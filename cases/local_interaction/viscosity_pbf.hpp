// Contract of viscosity_pbf (specification: cases/local_interaction/viscosity_pbf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::viscosity_pbf {

struct Inputs {
  View<const float, 2> x;  ///< positions, m
  View<const float, 2> v;  ///< velocities, m/s
  float h = 0;             ///< neighbours are nearer than this, m
  float c = 0;  ///< XSPH viscosity: the share of the weighted velocity differences that is added, m^3

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.array("v", v, "n,3", "m/s", between(-1e10, 1e10));
    visitor.scalar("h", h, "m", between(1e-6, 1e6));
    visitor.scalar("c", c, "m^3", finite());
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> v_new;  ///< velocities after viscosity, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::viscosity_pbf
