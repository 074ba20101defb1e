// Contract of ccd_vf (specification: cases/collision_query/ccd_vf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::ccd_vf {

struct Inputs {
  View<const float, 2> x0;           ///< vertex positions at t = 0, m
  View<const float, 2> x1;           ///< vertex positions at t = 1, m
  View<const std::int32_t, 2> tris;  ///< the three vertices of each triangle

  template <class V>
  void visit(V&& v) {
    v.array("x0", x0, "n,3", "m", between(-1e6, 1e6));
    v.array("x1", x1, "n,3", "m", between(-1e6, 1e6));
    v.array("tris", tris, "m,3", "", index_into("n"));
  }
};

template <class Real>
struct Outputs {
  View<Real, 1> toi;  ///< first time at which each vertex meets a triangle, in steps; 1 if none

  template <class V>
  void visit(V&& v) {
    v.array("toi", toi, "n", "");
  }
};

}  // namespace gpuphys::ccd_vf
