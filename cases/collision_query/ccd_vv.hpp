// Contract of ccd_vv (specification: cases/collision_query/ccd_vv.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::ccd_vv {

struct Inputs {
  View<const float, 2> x0;  ///< vertex positions at t = 0, m
  View<const float, 2> x1;  ///< vertex positions at t = 1, m
  float d = 0;              ///< the distance that counts as contact, m

  template <class V>
  void visit(V&& v) {
    v.array("x0", x0, "n,3", "m", between(-1e6, 1e6));
    v.array("x1", x1, "n,3", "m", between(-1e6, 1e6));
    v.scalar("d", d, "m", between(0x1p-40, 1e6));
  }
};

template <class Real>
struct Outputs {
  View<Real, 1> toi;  ///< first time at which each vertex is within d of another, in steps; 1 if none

  template <class V>
  void visit(V&& v) {
    v.array("toi", toi, "n", "");
  }
};

}  // namespace gpuphys::ccd_vv
