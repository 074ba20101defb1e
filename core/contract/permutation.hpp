// The same problem with its items in another order: what carries no meaning must not change the answer.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"
#include "core/contract/task.hpp"

namespace gpuphys {

/// order[symbol][position now] = position before.
using Permutation = std::map<std::string, std::vector<std::int64_t>>;

struct PermutedProblem {
  Problem problem;
  Permutation permutation;
};

/// A random order for every unordered symbol of the task. Arrays whose first extent is the symbol (or, for an
/// array of a single index, the symbol itself) move along; the entries of its index arrays are renumbered
/// (entries outside of the range stay). Throws Error(usage) for a task whose order means something.
PermutedProblem permuted(const Task&, const Problem&, std::uint64_t seed);

/// Outputs of the permuted problem in the order of the original one.
Arrays restore_order(const Task&, const Permutation&, const Arrays& outputs);

}  // namespace gpuphys
