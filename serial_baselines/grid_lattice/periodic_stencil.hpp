// Laplacian and gradient on a periodic grid with the neighbours of a D3Q19 lattice, for the serial baselines
// of the phase-field tasks, from their specifications alone.
#pragma once

#include <array>
#include <cstdint>

#include "serial_baselines/grid_lattice/lattice.hpp"

namespace gpuphys::serial {

template <class Real>
struct Derivatives {
  Real laplacian = 0;
  std::array<Real, 3> gradient{};
};

/// Of value(i, j, k) at one cell of a grid with these extents. Only differences from the cell itself enter.
template <class Real, class Value>
Derivatives<Real> derivatives(const Lattice<19>& lattice, const std::array<std::int64_t, 3>& n,
                              std::int64_t i, std::int64_t j, std::int64_t k, const Value& value) {
  const Real centre = value(i, j, k);
  Derivatives<Real> d;
  for (std::size_t q = 1; q < 19; ++q) {
    const std::array<int, 3>& c = lattice.velocity(q);
    const Real difference =
        value(periodic(i + c[0], n[0]), periodic(j + c[1], n[1]), periodic(k + c[2], n[2])) - centre;
    const Real weighted = static_cast<Real>(lattice.weight(q)) * difference;
    d.laplacian += 6 * weighted;
    for (std::size_t a = 0; a < 3; ++a) d.gradient[a] += 3 * static_cast<Real>(c[a]) * weighted;
  }
  return d;
}

/// The chemical potential 4 beta phi (phi - 1)(phi - 1/2) - kappa laplacian(phi).
template <class Real>
Real chemical_potential(Real phi, Real laplacian, Real beta, Real kappa) {
  return 4 * beta * phi * (phi - 1) * (phi - Real(0.5)) - kappa * laplacian;
}

}  // namespace gpuphys::serial
