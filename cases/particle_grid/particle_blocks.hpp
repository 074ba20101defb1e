// Particle sets shared by the particle-grid tasks: filled shapes, in random order, moving with a smooth
// random field.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys::particle_blocks {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<Vec3, 3>;

/// The numbers 0 .. n-1 sorted by (random_bits(seed, 99, i), i).
std::vector<std::uint32_t> random_order(std::int64_t n, std::uint64_t seed);

/// A ball of lattice particles: every cell of `cells` whose centre lies within `radius` cells of the centre
/// of the box holds eight, at a quarter and three quarters along each axis. Positions in cells, multiples of
/// 1/4, ordered by cell and within it.
std::vector<std::array<float, 3>> ball(const std::array<std::int64_t, 3>& cells, double radius);

/// Writes v (n,3) = a Fourier field (seed; modes, k_max, rms 1, period; core/generators) at the positions
/// x (n,3) plus `noise` times uniform noise in [-1, 1) from stream 10.
void fill_velocity(const HostArray& x, std::uint64_t seed, int modes, int k_max, double period, double noise,
                   HostArray& v);

/// Writes F (n,3,3) = I + jitter U, U uniform in [-1, 1) from stream 11.
void fill_deformation(std::uint64_t seed, double jitter, HostArray& f);

/// Rotation number `item` of a seed: uniform over all rotations (Shoemake 1992), stream 12.
Mat3 random_rotation(std::uint64_t seed, std::uint64_t item);

Mat3 product(const Mat3& a, const Mat3& b);
Mat3 transposed(const Mat3& a);
Mat3 diagonal(double a, double b, double c);

}  // namespace gpuphys::particle_blocks
