// Particles of the position-based fluid tasks: a cubic lattice, compressed by a wave and jittered, in a
// swirling flow; and the small arrangements that their hard cases share.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys::fluid {

using Vec3 = std::array<double, 3>;

struct Particle {
  Vec3 x{}, v{};
};
using Particles = std::vector<Particle>;

/// The paper's data. Particle q sits at lattice point p = spacing (q / (my mz), q / mz mod my, q mod mz).
struct Block {
  std::array<std::int64_t, 3> lattice{};
  std::uint64_t seed = 1;
  Vec3 corner{10, 10, 10};  ///< added to all positions, m
  double jitter = 0;        ///< each coordinate is displaced uniformly in [-jitter, jitter), m
  double wave = 0;          ///< A: each coordinate gains A/3 L/(2 pi) sin(2 pi p / L), m
  double wave_length = 16;  ///< L, m
  double flow = 0;          ///< amplitude of the ABC flow at p, m/s
  double flow_length = 8;   ///< its wavelength, m
  double noise = 0;         ///< each velocity component gets noise uniform in [-noise, noise), m/s
  double spacing = 1;       ///< of the lattice, m
};

/// The particles in random order. Streams under the seed: 0 jitter (item 3 q + axis), 2 velocity noise
/// (3 q + axis), 99 order (sorted by the bits of q).
Particles block(const Block&);

/// n particles uniform in a cube of half width `half`, with velocities uniform in [-speed, speed).
Particles cloud(std::uint64_t seed, std::int64_t n, const Vec3& centre, double half, double speed);

/// n particles along `axis` about the origin, 0.9 m apart to within a tenth, in an order that is not that of
/// the line.
Particles line(std::uint64_t seed, std::int64_t n, std::size_t axis, double speed);

/// Every particle multiplied by `scale`, then moved by `offset`; velocities stay.
Particles moved(Particles, double scale, const Vec3& offset);

Particles joined(Particles, const Particles&);

/// Every `every`-th particle is put where the one before it is; it keeps its velocity.
Particles with_coincident(Particles, std::size_t every);

/// Inputs of a contract for these particles: "x" and, where the task has one, "v". Scalars are still zero.
Problem problem_of(const Contract&, const Particles&);

}  // namespace gpuphys::fluid
