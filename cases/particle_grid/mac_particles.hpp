// Input sets shared by the transfers between particles and MAC grids (specification:
// cases/particle_grid/mac_particles.md): blocks of cells filled with jittered particles in random order, and
// velocities for particles and faces.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys::mac_particles {

using Vec3 = std::array<double, 3>;
using Cells = std::array<std::int64_t, 3>;

/// The paper's two sets and their two small ones differ in these numbers only.
struct BlockSet {
  std::string name;  ///< of the input set
  bool paper, hidden;
  Cells cells;      ///< of the box
  Cells low, high;  ///< the block's cells: [low, high) along each axis
  double margin;    ///< kept from whole and half multiples of the spacing, in cells
  std::int64_t n;   ///< particles kept
  std::uint64_t seed;
  double period;  ///< of the smooth fields, in cells
};
/// public, hidden, public_smoke, hidden_smoke.
const std::vector<BlockSet>& block_sets();
/// "33021538 particles, eight a cell of [0,128) x ... in random order, ..."
std::string describe(const BlockSet&);

inline constexpr double kDx = 0x1p-8;  ///< spacing of these sets, m

/// Writes the positions (n,3), in metres.
void fill_positions(const BlockSet&, HostArray& x);

/// Writes the particles' velocities v (n,3) at the positions x.
void fill_velocity(const BlockSet&, const HostArray& x, HostArray& v);

/// Writes `scale` times (the smooth field plus noise) on the faces of component c; `seed` is the field's own.
void fill_faces(const BlockSet&, std::uint64_t seed, double scale, int c, HostArray& u);

/// Entries scale * U, U uniform in [-1, 1), of an array of any shape.
void fill_uniform(std::uint64_t seed, std::uint64_t stream, double scale, HostArray& array);

/// Uniform in the box from `low` to `high` (in cells), rounded down to multiples of `step` plus half of it:
/// off every multiple of `step`.
Vec3 off_planes(std::uint64_t seed, std::uint64_t item, const Vec3& low, const Vec3& high, double step);
Vec3 random_vector(std::uint64_t seed, std::uint64_t stream, std::uint64_t item);

}  // namespace gpuphys::mac_particles
