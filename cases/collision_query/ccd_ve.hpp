// Contract of ccd_ve (specification: cases/collision_query/ccd_ve.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::ccd_ve {

struct Inputs {
  View<const float, 2> x0;            ///< vertex positions at t = 0, m
  View<const float, 2> x1;            ///< vertex positions at t = 1, m
  View<const std::int32_t, 2> edges;  ///< the two vertices of each edge, in either order
  float d = 0;                        ///< the distance that counts as contact, m

  template <class V>
  void visit(V&& v) {
    v.array("x0", x0, "n,3", "m", between(-1e6, 1e6));
    v.array("x1", x1, "n,3", "m", between(-1e6, 1e6));
    v.array("edges", edges, "m,2", "", index_into("n"));
    v.scalar("d", d, "m", between(0x1p-40, 1e6));
  }
};

template <class Real>
struct Outputs {
  View<Real, 1> toi;  ///< first time at which each vertex comes within d of an edge, in steps; 1 if none

  template <class V>
  void visit(V&& v) {
    v.array("toi", toi, "n", "");
  }
};

}  // namespace gpuphys::ccd_ve
