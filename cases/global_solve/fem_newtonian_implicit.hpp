// Contract of fem_newtonian_implicit (specification: cases/global_solve/fem_newtonian_implicit.md).
#pragma once

#include "core/contract/contract.hpp"

namespace gpuphys::fem_newtonian_implicit {

struct Inputs {
  View<const float, 2> X;            ///< positions of the vertices at rest, m
  View<const float, 2> x;            ///< positions, m
  View<const float, 2> v;            ///< velocities, m/s
  View<const float, 1> mass;         ///< masses, kg
  View<const std::int32_t, 2> tets;  ///< the four vertices of each tetrahedron
  float mu = 0;                      ///< Lame's second parameter, the shear modulus, Pa
  float lambda = 0;                  ///< Lame's first parameter, Pa
  float dt = 0;                      ///< time step, s
  float tol = 0;                     ///< of the gradient left, over that at the start

  template <class V>
  void visit(V&& visitor) {
    visitor.array("X", X, "n,3", "m", between(-1e8, 1e8));
    visitor.array("x", x, "n,3", "m", between(-1e8, 1e8));
    visitor.array("v", v, "n,3", "m/s", between(-1e10, 1e10));
    visitor.array("mass", mass, "n", "kg", between(1e-15, 1e15));
    visitor.array("tets", tets, "m,4", "", index_into("n"));
    visitor.scalar("mu", mu, "Pa", between(1e-3, 1e12));
    visitor.scalar("lambda", lambda, "Pa", between(0, 1e12));
    visitor.scalar("dt", dt, "s", between(1e-6, 1e5));
    visitor.scalar("tol", tol, "", between(1e-4, 1e-1));
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

}  // namespace gpuphys::fem_newtonian_implicit
