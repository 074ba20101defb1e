// What the results mean: tolerance windows, kill matrix, what a proposed tolerance would do, and a verdict
// for each task. Everything that is not as it should be ends up in a list of issues by name; no total hides
// one.
//
// Words used throughout. A *correct variant* is a run of role reference, fmad or baseline (knob sweeps
// excluded: a looser solver is expected to fail). A *ratio* is error over tolerance; non-finite errors count
// as infinite ratios. A mutant run's *best check* is the one with its largest ratio. A *window* of a check
// lies between the largest ratio of a correct variant and the smallest ratio of those mutant runs whose best
// check it is.
#pragma once

#include <limits>
#include <map>
#include <string>
#include <vector>

#include "core/records/results.hpp"

namespace gpuphys {

/// A value with the run it comes from; `label` is empty when there is none.
struct Extreme {
  double ratio = std::numeric_limits<double>::quiet_NaN();
  double error = std::numeric_limits<double>::quiet_NaN();
  std::string label, lane, set, check;
  bool exists() const { return !label.empty(); }
};

struct CheckWindow {
  std::string task, check, kind, quantity, norm;
  double tolerance = 0;
  Extreme correct;         ///< largest ratio of any correct variant
  Extreme mutant;          ///< smallest ratio among the mutant runs whose best check this is
  int mutants_best = 0;    ///< number of those runs
  int mutants_killed = 0;  ///< mutant runs in which this check exceeds its tolerance
  /// mutant.ratio / correct.ratio; infinity when the correct ratio is 0; NaN when either is missing.
  double separation() const;
};

/// A row of the kill matrix: one mutant in one lane.
struct MutantRow {
  std::string task, lane, label, mutant_class, expected_check;
  bool sparse = false;
  std::map<std::string, double> ratios;       ///< check -> largest ratio over the input sets
  std::map<std::string, std::string> states;  ///< input set -> state
  Extreme weakest;                            ///< the run whose best check has the smallest ratio
  bool killed_everywhere = false;
  bool expected_check_saw_it =
      false;  ///< the check named in the patch header exceeded its tolerance on every set
};

struct HardCase {
  std::string task, set, lane, label, state, detail;
  double worst_ratio = std::numeric_limits<double>::quiet_NaN();
};

enum class IssueKind {
  survivor,    ///< a mutant that no check saw
  failure,     ///< a correct variant over a tolerance
  fault,       ///< a rule of the harness broken
  crash,       ///< crashed or timed out
  error,       ///< anything else that ended a run
  skip,        ///< not run because something is missing on this machine
  missing,     ///< expected, but there is no result
  timing,      ///< SLOW, UNBASELINED or BELOW_FLOOR
  stale,       ///< a record older than its sources
  unreadable,  ///< a result or record that cannot be read
};
std::string to_string(IssueKind);

/// Something that is not as it should be.
struct Issue {
  IssueKind kind;
  std::string task, lane, label, set, detail;
};
/// "SURVIVED advect_rk2 gpu mutant.dt_sign public: ..."
std::string to_string(const Issue&);

/// What should exist for a task. Made from the task and the mutants folder by expectation_of() in
/// core/driver/inventory.hpp.
struct Expectation {
  std::string task, family;
  std::vector<std::string> cpu_sets;         ///< sets that the FP32 builds of the baseline must have run
  std::vector<std::string> gpu_sets;         ///< sets that the reference and its fmad variant must have run
  std::vector<std::string> cpu_mutant_sets;  ///< sets on which every serial mutant must have run
  std::vector<std::string> gpu_mutant_sets;  ///< sets on which every mutant of the reference must have run
  /// What else the ensemble of correct variants must hold in the GPU lane: label -> sets.
  std::map<std::string, std::vector<std::string>> gpu_ensemble;
  std::vector<std::string> mutants;         ///< faults with a hunk for the reference
  std::vector<std::string> serial_mutants;  ///< faults with a hunk for the serial baseline
  /// Input set -> check -> tolerance, as the case file states them now.
  std::map<std::string, std::map<std::string, double>> tolerances;
  double target_multiple = 0;
};

/// Which lanes a verdict demands results of.
struct Lanes {
  bool cpu = true, gpu = true;
};

std::vector<CheckWindow> windows(const ResultSet&, const std::string& task);
std::vector<MutantRow> kill_matrix(const ResultSet&, const std::string& task);
std::vector<HardCase> hard_cases(const ResultSet&, const std::string& task);

/// Runs that should exist and do not, by name. In the CPU lane: baseline_f32 and baseline_f32_fma on every
/// set of smoke size, every serial mutant on the public and hidden ones. In the GPU lane: reference and fmad
/// on every set of paper size and every hard set, every mutant on the public and hidden ones of paper size,
/// and a timing of the reference.
std::vector<Issue> missing_results(const ResultSet&, const Expectation&, Lanes);

/// Everything about a task's results that is not as it should be, missing ones included: wrong states, states
/// that their own checks contradict, checks left out or judged with another tolerance than the case file
/// states now, results of mutants that are gone, timing gates. A recorded timing may be UNBASELINED (it is
/// the baseline), a live one may not.
std::vector<Issue> issues(const ResultSet&, const Expectation&, Lanes);

/// Issues as lines for people. Missing results are brought together, one line for each task and lane.
std::vector<std::string> issue_lines(const std::vector<Issue>&);

/// One row of the verdict table.
struct Verdict {
  std::string task;
  Extreme serial_fp32;  ///< largest ratio of baseline_f32 and baseline_f32_fma
  Extreme reference, fmad;
  double truth_gap = std::numeric_limits<double>::quiet_NaN();  ///< largest of the reference (of the FP32
                                                                ///< baselines without a GPU)
  std::string truth_gap_of;                                     ///< label it belongs to
  Extreme weakest_mutant;
  int mutants_killed = 0, mutants_total = 0;  ///< mutants (not runs), over both lanes by fault name
  double separation = std::numeric_limits<double>::quiet_NaN();  ///< smallest over the checks
  double milliseconds = std::numeric_limits<double>::quiet_NaN();
  double multiple = std::numeric_limits<double>::quiet_NaN();
  double target_multiple = 0;
  int hard_passed = 0, hard_total = 0;  ///< runs of hard sets by correct variants
  std::string state;                    ///< "OK" or the gravest issue: "SURVIVED", "FAIL", ...
  std::vector<Issue> issues;
};
Verdict verdict(const ResultSet&, const Expectation&, Lanes);

/// A proposed tolerance for one check.
struct WhatIf {
  struct Run {
    std::string label, lane, set;
    double error = 0;
    bool changes = false;  ///< passes today and would fail, or is killed today and would escape
  };
  std::string task, check;
  double current = 0, proposed = 0;
  int correct_total = 0, mutants_total = 0;
  std::vector<Run> failing;    ///< correct variants that would fail
  std::vector<Run> escaping;   ///< mutant runs that no check would see
  std::vector<Run> unjudged;   ///< runs that ended without this check's error: they say nothing about it
  Extreme largest_correct;     ///< by error
  Extreme smallest_dependent;  ///< by error, among mutant runs that only this check sees
  double suggested = std::numeric_limits<double>::quiet_NaN();  ///< geometric mean of both errors
  std::string reason;  ///< how `suggested` comes about, or why there is none
};
/// Throws Error(unknown_name) when no result of this task has the check; lists the checks that do.
WhatIf what_if(const ResultSet&, const std::string& task, const std::string& check, double proposed);

}  // namespace gpuphys
