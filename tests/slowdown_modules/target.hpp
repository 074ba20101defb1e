// A task whose time is memory traffic alone, for planting slowdowns of known size: v = u + 1.
#pragma once

#include "core/contract.hpp"

namespace gpuphys::slowdown_target {

struct Inputs {
  View<const float, 1> u;
  template <class V>
  void visit(V&& v) {
    v.array("u", u, "n", "m");
  }
};

template <class Real>
struct Outputs {
  View<Real, 1> v;
  template <class V>
  void visit(V&& visitor) {
    visitor.array("v", v, "n", "m");
  }
};

}  // namespace gpuphys::slowdown_target
