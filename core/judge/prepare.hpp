// Inputs and truth of an input set, made once for a build and mapped afterwards.
#pragma once

#include <string>

#include "core/contract/task.hpp"
#include "core/judge/runner.hpp"
#include "core/judge/store.hpp"

namespace gpuphys {

/// What is needed to make them.
struct Workplace {
  std::string store_root;    ///< on disk; see core/judge/store.hpp
  RunnerOptions runner;      ///< that the FP64 baseline runs in
  std::string modules_root;  ///< <modules_root>/<task>/baseline_f64.so
  std::string baseline_of(const Task&) const;
};

struct Prepared {
  Problem problem;  ///< read-only arrays
  Arrays truth;     ///< FP64, read-only; empty if it was not asked for
  std::string inputs_digest, truth_digest;
  const Arrays* truth_or_null() const { return truth.empty() ? nullptr : &truth; }
};

/// The set's inputs, and its truth if `with_truth`: the set's known solution where it has one, else what the
/// FP64 baseline computes in a runner. Inputs are kept under a name made of this program's digest; truth
/// under one of the inputs' digest and of the baseline's file. Throws Error(module_fault) when the baseline
/// breaks a rule or returns values that are not finite, Error(unknown_name) when its module does not exist,
/// Error(crashed) when it dies.
Prepared prepare(const Workplace&, const Task&, const InputSet&, bool with_truth);

/// The same for inputs of one's own.
Prepared prepare_own(const Workplace&, const Task&, const InputSet&, Problem);

}  // namespace gpuphys
