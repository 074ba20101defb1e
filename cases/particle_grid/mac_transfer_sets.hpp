// The hard cases that p2g_pic_flip and p2g_apic share: particles placed where such transfers go wrong. Each
// task adds what its particles carry besides, and the checks.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cases/particle_grid/mac_particles.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::mac_particles {

struct Placement {
  std::string stress;  ///< the set is called hard_<stress>
  std::string about;
  Cells cells;  ///< of the box
  double dx = kDx;
  std::int64_t n = 0;
  std::function<Vec3(std::uint64_t)> at;  ///< particle to its place, in cells
  std::function<Vec3(std::uint64_t)> v;
  bool use_task_checks = true;
};
/// In the order of the specification.
const std::vector<Placement>& placements();

/// Fills x, v and the scalars of a problem of a contract that begins with x and v.
Problem placed_problem(const Contract&, const Placement&);

/// Faces that are exactly 0 in one of truth and result only.
Check same_support(int component);
/// Every face that is not 0 moves with the one velocity of all particles.
Check moves_with(int component, double velocity, double tolerance, const std::string& why);
/// The largest error of a component over the largest value of the truth.
Check error_over_largest(int component, double tolerance, const std::string& why);

extern const std::array<std::string, 3> kNames;  ///< ux, uy, uz
inline constexpr Vec3 kDrift{1.5, -0.75,
                             0.375};  ///< the velocity of all particles of "one_particle" and "drift"

}  // namespace gpuphys::mac_particles
