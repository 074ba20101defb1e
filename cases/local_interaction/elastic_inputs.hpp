// Bodies of the elastic tasks, mass-spring and finite elements: lattices under a smooth deformation with
// noise, in random order, and the checks that these tasks share.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/contract/task.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::elastic {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<Vec3, 3>;

/// Positions, velocities and masses, in FP64; rounded to float32 once by store().
struct Particles {
  std::vector<Vec3> x, v;    ///< m, m/s
  std::vector<double> mass;  ///< kg
};

struct SpringBody : Particles {
  std::vector<std::array<std::int32_t, 2>> springs;
  std::vector<double> rest;  ///< m
};

struct TetBody : Particles {
  std::vector<Vec3> rest;                         ///< X, m
  std::vector<std::array<std::int32_t, 4>> tets;  ///< det of the edges from the first vertex > 0 at rest
};

/// How a lattice is deformed and moved. With p the centred lattice point, L_d the extent of the lattice along
/// d, w_d = 2 pi periods / L_d and U uniform in [-1, 1):
///   D_d(p) = sin(w_{d+1} p_{d+1} + d) cos(w_{d+2} p_{d+2})         (indices of axes modulo 3)
///   x = X + strain / (2 pi periods / largest L_d) D(p) + jitter U,   v = speed (D(p + 7) + noise U)
/// and masses are `mass` times a factor uniform in [0.8, 1.2).
struct Deformation {
  double periods, strain, jitter, speed, noise;
  std::uint64_t seed;
};

/// points[0] x points[1] x points[2] particles at spacing 1 m, centred at the origin, with springs along the
/// 3 axes and the 6 diagonals of faces, of rest lengths 1 and sqrt 2; and free_side^3 particles without
/// springs at spacing 2 from (70, -15, -15), with jitter and random velocity only. Masses are 1 kg times
/// their factor. Particles, springs and the two ends of each are in random order.
SpringBody spring_lattice(std::array<std::int64_t, 3> points, std::int64_t free_side, const Deformation&);

/// Cubes of 1 m, cells[0] x cells[1] x cells[2], centred at the origin, each cut into six tetrahedra around
/// its diagonal (1,1,1). Rest positions have jitter of their own, as large as that of x. Masses are those of
/// density 1 kg/m^3, a quarter of each tetrahedron's to each vertex, times their factor. Vertices, tetrahedra
/// and their vertices (by even permutations) are in random order.
TetBody tet_block(std::array<std::int64_t, 3> cells, const Deformation&);

/// A random permutation of 0..n-1: items in the order of (random bits, index).
std::vector<std::int32_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t n);

/// A rotation, uniform over all, from items 4 `item` .. 4 `item` + 3 of a stream.
Mat3 random_rotation(std::uint64_t seed, std::uint64_t stream, std::uint64_t item);
Vec3 operator*(const Mat3&, const Vec3&);
Mat3 operator*(const Mat3&, const Mat3&);
Mat3 transposed(const Mat3&);

/// Write a body into the arrays x, v, mass and springs, rest or X, tets of a problem of matching sizes.
void store(const SpringBody&, Problem&);
void store(const TetBody&, Problem&);

/// Largest error of a coordinate of x_new, less what an error of `v_tolerance` times the rms of v_new makes
/// of it in dt, over a unit in the last place of x_new or of its change, whichever is larger: 1 between
/// neighbours.
Check position_units_check(double v_tolerance);
/// Largest |x_new - (x + dt v_new)| of the outputs alone, in units in the last place of x_new or of its
/// change: within one of v_new as it was before it was rounded.
Check positions_follow_check();
/// |sum of mass (v_new - v)| over sum of mass (|v_new| + |v_new - v|).
Check momentum_check(double tolerance, const std::string& why);
/// Largest |v_new - v| of the particles that appear in no element (the int32 input array `elements`): zero.
Check free_particles_check(const std::string& elements);
/// Largest |v_new - v| of all.
Check velocity_kept_check(double tolerance, const std::string& why);

}  // namespace gpuphys::elastic
