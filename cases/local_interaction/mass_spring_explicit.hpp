// Contract of mass_spring_explicit (specification: cases/local_interaction/mass_spring_explicit.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::mass_spring_explicit {

struct Inputs {
  View<const float, 2> x;               ///< positions, m
  View<const float, 2> v;               ///< velocities, m/s
  View<const float, 1> mass;            ///< masses, kg
  View<const std::int32_t, 2> springs;  ///< the two particles of each spring
  View<const float, 1> rest;            ///< rest lengths, m
  float k = 0;                          ///< stiffness of every spring, N/m
  float dt = 0;                         ///< time step, s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", between(-1e15, 1e15));
    visitor.array("v", v, "n,3", "m/s", between(-1e15, 1e15));
    visitor.array("mass", mass, "n", "kg", between(1e-10, 1e10));
    visitor.array("springs", springs, "m,2", "", index_into("n"));
    visitor.array("rest", rest, "m", "m", between(0, 1e15));
    visitor.scalar("k", k, "N/m", between(0, 1e10));
    visitor.scalar("dt", dt, "s", between(1e-10, 1e5));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< positions after the step, m
  View<Real, 2> v_new;  ///< velocities after the step, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x_new", x_new, "n,3", "m");
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::mass_spring_explicit
