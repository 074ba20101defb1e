// Input sets and invariants shared by the lattice Boltzmann tasks.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/contract/task.hpp"

namespace gpuphys::lattice {

struct Grid {
  std::int64_t nx, ny, nz;
};

/// Velocities and weights in the order of the specification.
struct VelocitySet {
  std::vector<std::array<int, 3>> c;
  std::vector<double> w;
};
const VelocitySet& velocity_set(int q);  ///< q = 19 or 27

/// Density and velocity of a cell, in lattice units.
struct Macroscopic {
  double density;
  std::array<double, 3> u;
};

/// The second-order equilibrium population of velocity q.
double equilibrium(const VelocitySet&, std::size_t q, const Macroscopic&);

/// What kind of step a task does: where the population of velocity q of cell x ends up, and which scalars the
/// contract has.
struct Step {
  int q;          ///< 19 or 27
  bool collides;  ///< the contract has tau_plus and magic
  bool streams;   ///< populations end up at x + c_q, else at x
  Contract contract;
};

/// The generator's constants: ABC flow of `periods` periods along each axis and rms Mach number `mach`,
/// density 1 + density_amplitude sin sin sin with the same periods, populations f_eq (1 + non_equilibrium U)
/// with U uniform in [-1,1): stream q, item = flat cell index.
struct FlowState {
  std::uint64_t seed;
  int periods;
  double mach, density_amplitude, non_equilibrium;
};

/// Relaxation of the colliding tasks.
inline constexpr double kTauPlus = 0.6, kMagic = 0.1875;

Problem flow_problem(const Step&, Grid, const FlowState&);

/// Populations (1 + non_equilibrium U) times the equilibrium of state(i, j, k).
Problem problem_from(const Step&, Grid,
                     const std::function<Macroscopic(std::int64_t, std::int64_t, std::int64_t)>& state,
                     double non_equilibrium = 0, std::uint64_t seed = 1);

/// public, hidden (of `paper` size), public_smoke and hidden_smoke.
std::vector<InputSet> flow_sets(const Step&, Grid paper, double public_non_equilibrium,
                                double hidden_non_equilibrium);

/// The hard cases of the tasks that collide, and of those that only stream, with their invariants.
std::vector<InputSet> collision_hard_cases(const Step&);
std::vector<InputSet> streaming_hard_cases(const Step&);

/// A task of this family, but for its speed target: the sets above and the checks that its step calls for.
Task step_task(const Step&, std::string name, int paper_number, std::string title, Grid paper,
               double public_non_equilibrium, double hidden_non_equilibrium);

// ---- invariants ----

/// Mass and momentum of every single cell are the same before and after, wherever the populations went.
std::vector<Check> conservation(const Step&);

/// A uniform equilibrium does not change.
Check unchanged();

/// Every population is bitwise where its velocity leads.
Check moved_bitwise(const Step&);

/// Largest error of a population over the density of the cell that it comes from: bounds thin cells beside
/// dense ones.
Check error_over_density(const Step&);

}  // namespace gpuphys::lattice
