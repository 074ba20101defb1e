// Contract of xpbd (specification: cases/position_constraint/xpbd.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::xpbd {

struct Inputs {
  View<const float, 2> x;               ///< positions, m
  View<const float, 2> v;               ///< velocities, m/s
  View<const float, 1> inv_mass;        ///< inverse masses, 1/kg; 0 pins a particle
  View<const std::int32_t, 2> springs;  ///< the two particles of each spring
  View<const float, 1> rest;            ///< rest lengths, m
  float dt = 0;                         ///< time step, s
  float spring_compliance = 0;          ///< inverse stiffness of every spring, m/N
  float contact_compliance = 0;         ///< inverse stiffness of every contact, m/N
  float thickness = 0;                  ///< distance below which a contact pushes, m
  float search_radius = 0;              ///< distance below which a pair is a contact at all, m
  float relaxation = 0;                 ///< share of a full correction of a contact in each iteration
  std::int32_t iters = 0;               ///< Jacobi iterations

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", between(-1e6, 1e6));
    visitor.array("v", v, "n,3", "m/s", between(-1e6, 1e6));
    visitor.array("inv_mass", inv_mass, "n", "1/kg", between(0, 1e6));
    visitor.array("springs", springs, "m,2", "", index_into("n"));
    visitor.array("rest", rest, "m", "m", between(0, 1e6));
    visitor.scalar("dt", dt, "s", between(1e-6, 1e6));
    visitor.scalar("spring_compliance", spring_compliance, "m/N", between(0, 1e9));
    visitor.scalar("contact_compliance", contact_compliance, "m/N", between(0, 1e9));
    visitor.scalar("thickness", thickness, "m", between(1e-12, 1e6));
    visitor.scalar("search_radius", search_radius, "m", between(1e-12, 1e6));
    visitor.scalar("relaxation", relaxation, "", between(0x1p-20, 1));
    visitor.scalar("iters", iters, "", between(0, 10000));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< positions at the end of the step, m
  View<Real, 2> v_new;  ///< velocities at the end of the step, m/s

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x_new", x_new, "n,3", "m");
    visitor.array("v_new", v_new, "n,3", "m/s");
  }
};

}  // namespace gpuphys::xpbd
