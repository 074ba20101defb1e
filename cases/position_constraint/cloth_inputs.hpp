// Cloth for the XPBD tasks: a square sheet of particles and springs, rolled up, together with loose
// particles, all in random order.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gpuphys::position_constraint {

/// The sheet has `rows` x `columns` particles at unit spacing: row index along the roll's spiral, column
/// index along its axis, which is y. The spiral is r(theta) = start_radius + turn_gap theta / (2 pi) about
/// the origin.
struct RolledCloth {
  std::int64_t rows = 1024, columns = 1024;
  std::int64_t free_side = 16;  ///< free_side^3 particles without springs, spacing 2, from (70, -15, -15) m
  double start_radius = 5;      ///< m
  double turn_gap = 0.45;       ///< distance of neighbouring turns, m
  double strain = 0.005;        ///< amplitude of the gradient of the in-plane displacement
  double periods = 4;           ///< of displacement and velocity, along each side of the sheet
  double jitter = 0.005;        ///< largest random displacement along each axis, m
  double speed = 2;             ///< amplitude of the velocity, m/s
  double noise = 0.1;           ///< random part of the velocity over its amplitude
  std::uint64_t seed = 1;
};

struct Cloth {
  std::vector<std::array<double, 3>> position;       ///< m
  std::vector<std::array<double, 3>> velocity;       ///< m/s
  std::vector<std::array<std::int32_t, 2>> springs;  ///< particles of each spring
  std::vector<double> rest;                          ///< rest lengths in the flat sheet, m
};

/// The rolled cloth with its particles, springs and the ends of each spring in random order.
Cloth make_rolled_cloth(const RolledCloth&);

/// Springs of a rows x columns sheet whose particle (a, b) is number a * columns + b: to the neighbours at
/// (1,0), (0,1), (1,1), (1,-1) and, against bending, (2,0) and (0,2).
std::vector<std::array<std::int32_t, 2>> sheet_springs(std::int64_t rows, std::int64_t columns);

/// A random permutation of 0..n-1: items in the order of (random bits, index).
std::vector<std::int32_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t n);

}  // namespace gpuphys::position_constraint
