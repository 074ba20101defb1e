// The contract of the test-only tasks: one array in, one array of the same length out.
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::one_array {

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

}  // namespace gpuphys::one_array
