// Problems and outputs as HDF5 files, so that any language can read an input set and hand back outputs to be
// judged.
//
// Layout of a file (schema 1): every array is a dataset of its contract name at the root, C order, with the
// attributes `unit` and `shape` (symbolic, "nx+1,ny,nz"); every scalar is a scalar dataset of its name.
// Attributes of the root: `schema`, `kind` ("inputs", "outputs" or "truth"), `task`, `set`, `suite_version`,
// `created`, `provenance`. Bool arrays are written as the two-member enum over int8 that h5py uses for
// numpy.bool_.
#pragma once

#include <string>
#include <vector>

#include "core/contract/arrays.hpp"
#include "core/contract/task.hpp"

namespace gpuphys {

inline constexpr int kHdf5Schema = 1;

enum class FileKind { inputs, outputs, truth };
std::string to_string(FileKind);

/// What a file says about itself.
struct FileInfo {
  int schema = 0;
  std::string kind, task, set, suite_version, created, provenance;
};

/// Writes the inputs and scalars of a problem. The file appears under `path` only when it is complete.
/// Throws Error(bad_input) when it cannot be written.
void write_problem(const std::string& path, const Task&, const std::string& set, const Problem&,
                   const std::string& provenance = "");

/// Writes outputs or truth.
void write_arrays(const std::string& path, FileKind, const Task&, const std::string& set, const Arrays&,
                  const std::string& provenance = "");

/// The root attributes. Attributes that are absent leave their field empty (files by other writers need not
/// have them).
FileInfo read_info(const std::string& path);

/// Reads a problem and checks it against the contract: every array and scalar present, of its type and rank,
/// shapes that agree with each other, values that are valid. The file is parsed by a child process, because
/// HDF5 1.10 can crash on a damaged one. Throws Error(bad_input), one line naming the file, the array, what
/// it has and what was expected.
Problem read_problem(const std::string& path, const Task&);

/// Reads the contract's outputs with the shapes that `problem` implies. `real` is the type that
/// floating-point outputs must have (f32 for outputs to be judged, f64 for truth). No value is ever converted
/// from one type to another; byte order and storage layout may be anything.
Arrays read_arrays(const std::string& path, const Task&, const Problem& problem, DType real = DType::f32);

}  // namespace gpuphys
