// Phase fields of drops in a periodic box: what cahn_hilliard and surface_tension_phase_field are given.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "cases/grid_lattice/lattice_inputs.hpp"

namespace gpuphys::drops {

using lattice::Grid;

/// A sphere, in cells; cell (i,j,k) has its centre at (i,j,k).
struct Drop {
  std::array<double, 3> centre;
  double radius;
};

/// How many drops of which sizes: centres uniform in the box (random streams 60, 61, 62 for x, y, z), radii
/// uniform in [smallest, largest) (stream 63); item = number of the drop.
struct Layout {
  std::uint64_t seed;
  std::int64_t count;
  double smallest, largest;
};
std::vector<Drop> random_drops(const Layout&, Grid);

/// The equilibrium profile of an interface of this width at a signed distance to it, positive inside:
/// (1 + tanh(2 distance / width)) / 2. What is below 2^-40 is 0.
double profile(double distance, double width);

/// Shape (nx,ny,nz): the largest profile of all drops, with the distance to the nearest periodic image.
std::vector<float> field(Grid, const std::vector<Drop>&, double width);

/// A rough field without any symmetry: independent values uniform in [low, high) (random stream 64, item =
/// flat cell index).
std::vector<float> noise(Grid, std::uint64_t seed, double low, double high);

}  // namespace gpuphys::drops
