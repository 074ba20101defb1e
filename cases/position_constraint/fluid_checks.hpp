// Checks and scalars that the position-based fluid tasks share.
#pragma once

#include <functional>
#include <initializer_list>
#include <string>
#include <utility>

#include "cases/position_constraint/fluid_inputs.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::fluid {

using Scalars = std::initializer_list<std::pair<const char*, double>>;

/// A set of paper or smoke size, and a hard case, of particles with the given scalars.
InputSet block_set(const Contract&, const std::string& name, SetKind, Size, const Block&, Scalars);
InputSet hard_set(const Contract&, const std::string& stress, const std::string& about,
                  std::function<Particles()> make, Scalars, std::vector<Check> invariants = {});

/// The sum of (output - input) over all particles is zero, up to rounding of the output.
Check momentum_kept(const std::string& output, const std::string& input);

/// Every component of the output is the input's.
Check unchanged(const std::string& output, const std::string& input, const std::string& why);

/// Every component of the output is the truth's float32 or its neighbour, or within 2^-21 h of it.
Check equal_or_next(const std::string& output);

/// Tighter bounds on the change than those for the paper's size: relative L2 and local.
std::vector<Check> tight(const std::string& output, const std::string& input, double rel_l2, double local);

}  // namespace gpuphys::fluid
