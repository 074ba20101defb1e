// Contract of self_collision_xpbd (specification: cases/position_constraint/self_collision_xpbd.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::self_collision_xpbd {

struct Inputs {
  View<const float, 2> x;         ///< positions, m
  View<const float, 1> inv_mass;  ///< inverse masses, 1/kg; 0 pins a particle
  float thickness = 0;            ///< distance below which a contact pushes, m
  float search_radius = 0;        ///< distance below which a pair is a contact at all, m
  float compliance = 0;           ///< inverse stiffness of every contact, m/N
  float dt = 0;                   ///< time step, s
  float relaxation = 0;           ///< share of a full correction in each sweep
  std::int32_t iters = 0;         ///< Jacobi sweeps

  template <class V>
  void visit(V&& v) {
    v.array("x", x, "n,3", "m", between(-1e6, 1e6));
    v.array("inv_mass", inv_mass, "n", "1/kg", between(0, 1e6));
    v.scalar("thickness", thickness, "m", between(1e-12, 1e6));
    v.scalar("search_radius", search_radius, "m", between(1e-12, 1e6));
    v.scalar("compliance", compliance, "m/N", between(0, 1e9));
    v.scalar("dt", dt, "s", between(1e-6, 1e6));
    v.scalar("relaxation", relaxation, "", between(0x1p-20, 1));
    v.scalar("iters", iters, "", between(0, 10000));
  }
};

template <class Real>
struct Outputs {
  View<Real, 2> x_new;  ///< positions without contacts below the thickness, as far as the sweeps get, m

  template <class V>
  void visit(V&& v) {
    v.array("x_new", x_new, "n,3", "m");
  }
};

}  // namespace gpuphys::self_collision_xpbd
