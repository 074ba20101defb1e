// Velocities on the nodes of a collocated grid, and particles that read them: what g2p_mpm and
// velocity_gradient_mpm share (specification: cases/particle_grid/node_gather.md).
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"

namespace gpuphys::node_velocity {

using Vec3 = std::array<double, 3>;
using Nodes = std::array<std::int64_t, 3>;

inline constexpr double kDx = 0x1p-8;  ///< spacing of the paper's sets, m

/// Writes component c on the nodes (i, j, k) kDx: 16 random Fourier modes (seed; wave numbers up to k_max,
/// rms 1 m/s, `period` metres) plus 0.1 m/s of uniform noise.
void fill_nodes(std::uint64_t seed, int k_max, double period, int c, HostArray& u);

/// Writes positions given in cells times `dx` as float32 holds it, rounded to float32.
void fill_positions(double dx, const std::function<Vec3(std::uint64_t particle)>& in_cells, HostArray& x);

/// Where a transfer from nodes goes wrong: particles, spacing and node values of a hard case.
struct Stress {
  std::string name;  ///< the set is called hard_<name>
  std::string about;
  Nodes nodes;
  double dx = kDx;
  std::int64_t n = 0;
  std::function<Vec3(std::uint64_t particle)> at;                   ///< in cells
  std::function<Vec3(std::int64_t, std::int64_t, std::int64_t)> u;  ///< of node (i, j, k)
};
const std::vector<Stress>& stresses();

/// A linear field on dyadic numbers, u = rate g + at_origin with g the place in cells. All products are
/// exact.
inline constexpr std::array<Vec3, 3> kRate{{{0.25, -0.5, 1.0}, {2.0, 0.125, -0.25}, {-1.0, 0.75, 0.5}}};
inline constexpr Vec3 kAtOrigin{1.0, -2.0, 0.5};
/// Particles in multiples of a quarter of a cell, well inside of that field.
Vec3 quarter_point(std::uint64_t seed, std::uint64_t particle, const Nodes&);
Vec3 linear_field(const Vec3& g);
inline constexpr Vec3 kConstant{1000.0, -3.0, 0.1};  ///< of "constant"

/// Fills u from a function of the node, x from a function of the particle.
void fill(const Stress&, HostArray& x, HostArray& ux, HostArray& uy, HostArray& uz);

}  // namespace gpuphys::node_velocity
