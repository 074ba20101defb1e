// What runs leave behind: one JSON file for each (task, lane, module label, input set), one for each timing.
// Everything that is later counted, tabulated or plotted is read from here and from the records (record.hpp).
//
//     <results>/<task>/<lane>/<label>/<set>.json        one RunResult; lane: cpu, gpu or user
//     <results>/<task>/gpu/<label>/time.<set>.json      one TimingResult
//
// A file says what was measured. What follows from the label (role, lane, a mutant's class) or from the task
// (what a check looks at) is not read from it.
#pragma once

#include <limits>
#include <map>
#include <string>
#include <vector>

#include "core/base/error.hpp"

namespace gpuphys {

inline constexpr int kResultSchema = 2;

/// How a run ended. KILLED and SURVIVED are for mutants only; the first three for everything else. RUNNING is
/// written before a module starts: a run that says so later never came to its end.
enum class RunState { pass, fail, fault, killed, survived, crashed, timeout, error, skipped, running };
std::string to_string(RunState);                   ///< "PASS", "FAIL", ...
RunState run_state_from(const std::string& text);  ///< throws Error(bad_input) for an unknown state

struct CheckResult {
  std::string name, kind, quantity,
      norm;  ///< as in core/contract/task.hpp; kind is "paper", "local" or "invariant"
  double error = std::numeric_limits<double>::quiet_NaN();
  double tolerance = 0;
  double ratio = std::numeric_limits<double>::quiet_NaN();  ///< error / tolerance, see ratio_of()
  bool pass = false;
  std::string detail;
};

/// error / tolerance; for tolerance 0: 0 when the error is 0, else infinity. NaN stays NaN.
double ratio_of(double error, double tolerance);

struct FaultResult {
  std::string fault, detail;
};

/// What a module of the suite was built from (gpuphys-stamp writes it beside the module).
struct ModuleStamp {
  std::string sources;   ///< SHA-256 over its sources without comments and white space
  std::string flags;     ///< of the compiler
  std::string compiler;  ///< name and version
  bool known() const { return !sources.empty(); }
};

/// One module on one input set.
struct RunResult {
  std::string task;
  std::string label;  ///< "reference", "fmad", "baseline_f32", "mutant.<fault>", ..., "reference@tol=1e-4"
  std::string set;    ///< input set
  std::string run;    ///< id of the run that wrote this
  RunState state = RunState::error;
  std::string state_detail;
  std::vector<CheckResult> checks;
  std::vector<FaultResult> faults;
  std::map<std::string, double>
      truth_gap;  ///< output array -> relative L2 distance to the unrounded FP64 truth
  std::string truth_source = "none";
  double milliseconds = std::numeric_limits<double>::quiet_NaN();  ///< of the judged call
  std::map<std::string, double> scalar_overrides;                  ///< knob sweeps only
  std::string device, started;
  std::string confinement;  ///< "" or "unconfined: <why>"
  ModuleStamp module;
  std::string inputs, truth;  ///< digests of what it was run and judged on
  double bytes = 0;           ///< that the run holds: inputs, truth, outputs

  // From the label and the task, not from the file.
  std::string lane;                          ///< "cpu", "gpu" or "user"
  std::string role;                          ///< see role_of()
  std::string set_kind;                      ///< "public", "hidden" or "hard"
  std::string size;                          ///< "smoke" or "paper"
  std::string mutant_class, expected_check;  ///< mutants only
  bool sparse = false;                       ///< mutants only

  std::string origin = "live";  ///< not written: "live", or "record <slug>" when it was read from a record

  bool is_mutant() const { return role == "mutant"; }
  bool is_knob_sweep() const { return !scalar_overrides.empty(); }
  /// The state that this role should end in: KILLED for a mutant, either verdict for a build with fast math
  /// (which is reported only), PASS for everything else.
  bool as_it_should_be() const {
    if (role == "fast_math" && state == RunState::fail) return true;
    return state == (is_mutant() ? RunState::killed : RunState::pass);
  }
  const CheckResult* worst_check() const;  ///< largest ratio (NaN counts as largest), null without checks
  double worst_truth_gap() const;          ///< NaN when there is none
};

/// The timing gate's verdict; see core/gpu's timing code.
struct GateResult {
  /// "OK", "SLOW", "NOISY", "UNBASELINED", "BELOW_FLOOR"; in records also "ACCEPTED": slower than the best
  /// before it, and taken as the new baseline on purpose (`gpuphys record --accept-slower REASON`).
  std::string state;
  double baseline_multiple = std::numeric_limits<double>::quiet_NaN();
  double limit = std::numeric_limits<double>::quiet_NaN();  ///< largest multiple that the gate accepts
};

struct TimingResult {
  std::string task, label, set;
  std::string run;
  ModuleStamp module;
  std::vector<double> times_ms;
  double min_ms = std::numeric_limits<double>::quiet_NaN();
  double median_ms = std::numeric_limits<double>::quiet_NaN();
  double spread = std::numeric_limits<double>::quiet_NaN();  ///< (max - min) / min
  bool fresh_processes = false;  ///< a process for each timed call, as the paper measures
  double compulsory_bytes = 0;
  double floor_ms = std::numeric_limits<double>::quiet_NaN();
  double multiple = std::numeric_limits<double>::quiet_NaN();  ///< median_ms / floor_ms
  double target_multiple = 0;
  std::map<std::string, double> ceilings;          ///< "copy_GBps", "fp32_TFLOPs", "launch_us"
  std::map<std::string, double> scalar_overrides;  ///< knob sweeps only
  std::string device, driver, toolkit;
  GateResult gate;

  std::string origin = "live";  ///< not written
};

/// Where a result lies under `results_root`. Throws Error(usage) when a label cannot be a folder's name.
std::string result_path(const std::string& results_root, const RunResult&);
std::string result_path(const std::string& results_root, const TimingResult&);

/// Writes atomically (a reader sees the old file or the new one, never half of one). Creates folders.
void write_result(const std::string& results_root, const RunResult&);
void write_result(const std::string& results_root, const TimingResult&);

/// Runs and timings, with what could not be read named rather than left out silently.
struct ResultSet {
  std::vector<RunResult> runs;
  std::vector<TimingResult> timings;
  std::vector<std::string> unreadable;  ///< one line a file
  std::vector<std::string> notes;       ///< one line each: what was taken from where instead of measured here

  const RunResult* find_run(const std::string& task, const std::string& lane, const std::string& label,
                            const std::string& set) const;
  const TimingResult* find_timing(const std::string& task, const std::string& label,
                                  const std::string& set) const;
};

/// Everything below a results folder (or below one task's folder of it), sorted by task, lane, label and set.
/// A folder that does not exist is an empty result set.
ResultSet load_results(const std::string& results_root, const std::string& task = "");

/// "NVIDIA H200" -> "nvidia-h200".
std::string gpu_slug(const std::string& device);
/// One entry for each (task, lane, label, set): the live one where there is one, the recorded one otherwise.
/// A live run that was skipped measured nothing: a recorded one takes its place, and a note says how often
/// that happened.
ResultSet merge_results(ResultSet live, ResultSet recorded);

/// ISO 8601 UTC time, "2026-11-22T05:30:00Z".
std::string utc_now();
/// A random id for a run, 16 hexadecimal digits.
std::string new_run_id();

}  // namespace gpuphys
