// Contract of solve_constraint_xpbd (specification: cases/position_constraint/solve_constraint_xpbd.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::solve_constraint_xpbd {

struct Inputs {
  View<const float, 2> x;               ///< predicted positions, m
  View<const float, 1> inv_mass;        ///< inverse masses, 1/kg; 0 pins a particle
  View<const std::int32_t, 2> springs;  ///< the two particles of each spring
  View<const float, 1> rest;            ///< rest lengths, m
  float compliance = 0;                 ///< inverse stiffness of every spring, m/N
  float dt = 0;                         ///< time step, s
  std::int32_t iters = 0;               ///< Jacobi iterations

  template <class V>
  void visit(V&& v) {
    v.array("x", x, "n,3", "m", between(-1e15, 1e15));
    v.array("inv_mass", inv_mass, "n", "1/kg", between(0, 1e12));
    v.array("springs", springs, "m,2", "", index_into("n"));
    v.array("rest", rest, "m", "m", between(0, 1e15));
    v.scalar("compliance", compliance, "m/N", between(0, 1e12));
    v.scalar("dt", dt, "s", between(1e-9, 1e9));
    v.scalar("iters", iters, "", between(0, 1e6));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< projected positions, m

  template <class V>
  void visit(V&& v) {
    v.array("x_new", x_new, "n,3", "m");
  }
};

}  // namespace gpuphys::solve_constraint_xpbd
