// Holds values to what a contract says is valid.
#pragma once

#include <string>

#include "core/contract/arrays.hpp"

namespace gpuphys {

/// Throws Error(bad_input) naming the array, the index and the value (or the scalar) that the contract does
/// not allow: a value that is not finite, out of bounds, an index beyond what it counts along, a bool that is
/// neither 0 nor 1.
void require_valid(const Contract&, const Problem&, const std::string& where);

/// "finite", "> 0", "in [0, 1]", "index along n": for people.
std::string to_string(const Valid&);

}  // namespace gpuphys
