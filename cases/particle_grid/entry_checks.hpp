// Checks of single entries of an output that holds a vector or a matrix for each item: the paper judges a
// component or an entry of a matrix over all particles.
#pragma once

#include <cstdint>
#include <string>

#include "core/contract/task.hpp"

namespace gpuphys::entry_checks {

/// Entry `entry` (flat within an item) of an (n, ...) output, as in relative_l2_check() and
/// local_error_check(). The checks are called <label>_rel_l2 and <label>_local.
Check relative_l2_of_entry(const std::string& array, std::int64_t entry, const std::string& label,
                           double tolerance, const std::string& why);
Check local_error_of_entry(const std::string& array, std::int64_t entry, const std::string& label,
                           double tolerance, const std::string& why);

}  // namespace gpuphys::entry_checks
