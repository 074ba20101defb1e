// Problems of springs from explicit lists, and the checks of displacement that the XPBD tasks share.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/contract/task.hpp"

namespace gpuphys::position_constraint {

/// A system of springs, in FP64; rounded to float32 once by the task that takes it over.
struct SpringSystem {
  std::vector<std::array<double, 3>> position;       ///< m
  std::vector<double> inv_mass;                      ///< 1/kg; empty means 1 everywhere
  std::vector<std::array<std::int32_t, 2>> springs;  ///< particles of each spring
  std::vector<double> rest;                          ///< m
};

/// Writes a system into the arrays x, inv_mass, springs and rest of a problem of matching sizes.
void store(const SpringSystem&, Problem&);

/// Relative L2 error of the displacement x_new - x, formed in FP64 from float32 arrays (truth rounded to
/// float32 first). When the true displacement is zero, the L2 norm of the displacement itself.
Check displacement_check(double tolerance, const std::string& why);
/// Largest error of a coordinate over the rms displacement of a coordinate (over 1 m when that is zero).
Check local_displacement_check(double tolerance, const std::string& why);
/// Largest |x_new - x| along an axis, m, over the particles that no spring holds.
Check free_particles_check(double tolerance, const std::string& why);
/// sum (x_new - x) / w over all particles, over what rounding the outputs to float32 explains.
Check momentum_check();
/// Largest |x_new - x| along an axis over particles of zero inverse mass must be exactly zero.
Check pinned_check();
/// Largest |x_new - x| along an axis, m, over all particles.
Check unmoved_check(double tolerance, const std::string& why);

}  // namespace gpuphys::position_constraint
