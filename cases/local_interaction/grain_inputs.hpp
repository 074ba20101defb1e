// Grains of the granular tasks: a jittered cubic lattice of overlapping spheres in a noisy shear
// flow.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gpuphys::grains {

using Vec3 = std::array<double, 3>;

struct Grain {
  Vec3 x, v;
  double radius;
  Vec3 omega{0, 0, 0};
};

/// The paper's data. Lattice spacing is 1 m; the lattice starts at the origin.
struct Packing {
  std::array<std::int64_t, 3> lattice;
  std::uint64_t seed;
  double jitter;             ///< each coordinate is displaced uniformly in [-jitter, jitter), m
  double smallest, largest;  ///< radii are uniform in between, m
  double shear;              ///< v_x grows by this per metre of z, 1/s
  double noise;              ///< each velocity component gets noise uniform in [-noise, noise), m/s
  Vec3 corner{0, 0, 0};      ///< added to all positions before they are rounded, m
  double spin = 0;           ///< angular velocity components are uniform in [-spin, spin), rad/s
};

/// The grains in random order. Streams under the seed: 0 jitter (item 3 q + axis for lattice point q), 1
/// radius, 2 velocity noise (3 q + axis), 3 spin (3 q + axis), 99 order (sorted by the bits of q).
std::vector<Grain> packing(const Packing&);

}  // namespace gpuphys::grains
