// Judges what a call of a module delivered: the one place where outputs meet checks.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "core/contract/task.hpp"
#include "core/judge/runner.hpp"
#include "core/records/labels.hpp"
#include "core/records/results.hpp"

namespace gpuphys {

/// What is known about a module besides its code.
struct ModuleIdentity {
  std::string label;  ///< "reference", "mutant.<fault>", ...
  std::string role;   ///< "reference", "fmad", "baseline", "mutant", "user"
  std::string lane;   ///< "gpu", "cpu", or "user" for a module that is not the suite's
  std::string mutant_class, expected_check;
  bool sparse = false;
};

/// The identity that a label implies; a mutant's class and expected check are read from
/// <mutants_root>/<task>/<fault>.patch. Throws Error(bad_input) for a patch without its header.
ModuleIdentity identify(const std::string& label, const std::string& task, const std::string& mutants_root);

/// Whether `module` on the command line names a file rather than a module built with the suite.
bool is_module_path(const std::string& module);

/// The identity of `module` as given on the command line, under `label` if that is not empty. A user's file
/// cannot go by the label of one of the suite's own modules: its results would be taken for theirs
/// (Error(usage)).
ModuleIdentity identify_module(const std::string& module, const std::string& label, const std::string& task,
                               const std::string& mutants_root);

/// The planted faults of a task: the stems of mutants/<task>/*.patch, sorted.
std::vector<std::string> planted_faults(const std::string& mutants_root, const std::string& task);

/// Applies every check that `set` asks for. `truth` may be null when no check needs it.
std::vector<CheckResult> apply_checks(const Task&, const InputSet&, const Judged&);

/// Whether judging this set needs the FP64 truth, or has it for free, so that the truth gap can be told.
bool wants_truth(const Task&, const InputSet&);

/// Fills checks, faults, truth gap and state of a result from what a call did. `earlier` (may be null) is the
/// output of the previous call, which had other inputs.
void judge_call(const Task&, const InputSet&, const Problem&, const Arrays* truth, const CallReport&,
                const Arrays* earlier, RunResult& result);

/// Guesses why outputs are wrong, to be called when a check failed: zeros, a copied input, or the output of
/// an earlier call. `earlier` may be null.
std::vector<FaultReport> diagnose(const Problem&, const Arrays& outputs, const Arrays* truth,
                                  const Arrays* earlier);

/// Turns the judgement of a mutant into its state: KILLED only if it ran to its end without breaking a rule
/// and a check that its patch names exceeded its tolerance.
void conclude_mutant(RunResult& judged);

/// The checks as an aligned table, one a line, worst first.
std::string check_table(const RunResult&);

}  // namespace gpuphys
