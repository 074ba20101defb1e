// FP64 truth, computed once for given inputs and kept.
#pragma once

#include <string>

#include "core/arrays.hpp"
#include "core/task.hpp"

namespace gpuphys {

/// The FP64 truth of `problem`: the set's known solution where it has one, else what the baseline module
/// computes on the host. Kept as an HDF5 file in <cache_dir>/<task>/ under a name made of the set, a digest
/// of the inputs' bytes and scalars and a digest of whatever computes it (the module file, or this program
/// for known solutions); a change of any of them is another file. Processes that need the same truth at the
/// same time compute it once (file lock). A cache file that cannot be read is computed again, with one line
/// on stderr. Throws Error(module_fault) when the baseline breaks a rule or returns non-finite values,
/// Error(unknown_name) when the module does not exist, Error(bad_input) when the folder cannot be written.
Arrays obtain_truth(const Task&, const InputSet&, const Problem&, const std::string& baseline_module_path,
                    const std::string& cache_dir);

/// SHA-256 (hex) over names, types, shapes and bytes of all inputs and scalars.
std::string digest_of(const Problem&);

}  // namespace gpuphys
