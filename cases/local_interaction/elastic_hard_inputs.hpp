// Bodies for the hard cases of the elastic tasks: what such codes break on.
#pragma once

#include "cases/local_interaction/elastic_inputs.hpp"

namespace gpuphys::elastic {

/// Adds repeated springs, springs from a particle to itself and springs of rest length 0, and puts some ends
/// of springs at one place.
void make_degenerate(SpringBody&);

/// `arms` springs of rest length 1 from one particle to others on a half sphere about it, 1.15 to 1.35 m
/// away.
SpringBody hub_of_springs(std::int32_t arms, std::uint64_t seed);

/// n particles at random in a cube of 4 m, masses over four decades, m springs of rest lengths up to 2 m
/// between random ones (or from one to itself).
SpringBody random_graph(std::uint64_t seed, std::uint64_t n, std::uint64_t m);

Mat3 diagonal(double a, double b, double c);
inline constexpr Mat3 kIdentity{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};

/// Stretches 10^[low, high) along three directions, between two random rotations.
Mat3 random_stretch(std::uint64_t seed, std::uint64_t i, double low, double high);

/// Adds a tetrahedron of its own at `place`: a regular corner of edges `size` times `shape`, turned at
/// random, deformed by f. The masses are such that forces of the size `force_scale` Pa size^2 change
/// velocities by 1 m/s in a second.
void add_tet(TetBody&, const Vec3& place, double size, const Mat3& shape, const Mat3& f, double force_scale,
             std::uint64_t seed, std::uint64_t item);

/// `count` tetrahedra of their own with random stretches.
TetBody separate_tets(std::uint64_t seed, std::uint64_t count, double low, double high);

/// `count` tetrahedra of their own, a sixtieth as high as wide: dihedral angles of about one degree.
TetBody slivers(std::uint64_t seed, std::uint64_t count);

}  // namespace gpuphys::elastic
