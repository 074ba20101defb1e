// Contract of solve_constraint_pbf (specification: cases/position_constraint/solve_constraint_pbf.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::solve_constraint_pbf {

struct Inputs {
  View<const float, 2> x;  ///< predicted positions, m
  float h = 0;             ///< neighbours are nearer than this, m
  float rho0 = 0;          ///< rest density, > 0, 1/m^3
  float eps = 0;           ///< relaxation of the constraint, > 0, 1/m^2
  float k_corr = 0;        ///< strength of the artificial pressure, >= 0, m^2
  float dq = 0;            ///< distance where it is k_corr, in units of h
  std::int32_t iters = 0;  ///< Jacobi iterations, >= 0

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x", x, "n,3", "m", finite());
    visitor.scalar("h", h, "m", between(1e-3, 1e3));
    visitor.scalar("rho0", rho0, "1/m^3", positive());
    visitor.scalar("eps", eps, "1/m^2", positive());
    visitor.scalar("k_corr", k_corr, "m^2", at_least(0));
    visitor.scalar("dq", dq, "", between(0, 0.9));
    visitor.scalar("iters", iters, "", between(0, 1000));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< positions after the last iteration, m

  template <class V>
  void visit(V&& visitor) {
    visitor.array("x_new", x_new, "n,3", "m");
  }
};

}  // namespace gpuphys::solve_constraint_pbf
