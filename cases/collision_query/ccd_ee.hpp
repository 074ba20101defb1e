// Contract of ccd_ee (specification: cases/collision_query/ccd_ee.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::ccd_ee {

struct Inputs {
  View<const float, 2> x0;            ///< vertex positions at t = 0, m
  View<const float, 2> x1;            ///< vertex positions at t = 1, m
  View<const std::int32_t, 2> edges;  ///< the two vertices of each edge, in either order

  template <class V>
  void visit(V&& v) {
    v.array("x0", x0, "n,3", "m", between(-1e6, 1e6));
    v.array("x1", x1, "n,3", "m", between(-1e6, 1e6));
    v.array("edges", edges, "m,2", "", index_into("n"));
  }
};

template <class Real>
struct Outputs {
  View<Real, 1> toi;  ///< time of the first impact of each edge in units of the step, 1 if there is none

  template <class V>
  void visit(V&& v) {
    v.array("toi", toi, "m", "", between(0, 1));
  }
};

}  // namespace gpuphys::ccd_ee
