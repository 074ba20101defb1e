// What runs leave behind: one JSON file for each (task, lane, module label, input set), one for each timing,
// and the committed GPU records composed of them. Everything that is later counted, tabulated or plotted is
// read from here.
//
//     <results>/<task>/<lane>/<label>/<set>.json        one RunResult
//     <results>/<task>/gpu/<label>/time.<set>.json      one TimingResult
//     <records>/<gpu slug>/<task>.json                  one TaskRecord
#pragma once

#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"

namespace gpuphys {

inline constexpr int kResultSchema = 1;

/// How a run ended. KILLED and SURVIVED are for mutants only; the first three for everything else.
enum class RunState { pass, fail, fault, killed, survived, crashed, timeout, error, skipped };
std::string to_string(RunState);                   ///< "PASS", "FAIL", ...
RunState run_state_from(const std::string& text);  ///< throws Error(bad_input) for an unknown state

struct CheckResult {
  std::string name, kind, quantity, norm;  ///< as in core/task.hpp; kind is "paper", "local" or "invariant"
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

/// One module on one input set.
struct RunResult {
  std::string task;
  std::string lane;      ///< "cpu" or "gpu"
  std::string label;     ///< "reference", "fmad", "baseline_f32", "mutant.<fault>", ..., "reference@tol=1e-4"
  std::string role;      ///< "reference", "fmad", "baseline", "mutant" or "user"
  std::string set;       ///< input set
  std::string set_kind;  ///< "public", "hidden" or "hard"
  std::string size;      ///< "smoke" or "paper"
  RunState state = RunState::error;
  std::string state_detail;
  std::vector<CheckResult> checks;
  std::vector<FaultResult> faults;
  std::map<std::string, double>
      truth_gap;  ///< output array -> relative L2 distance to the unrounded FP64 truth
  std::string truth_source = "none";
  double milliseconds = std::numeric_limits<double>::quiet_NaN();  ///< of the judged call
  std::map<std::string, double> scalar_overrides;                  ///< knob sweeps only
  std::string mutant_class, expected_check;                        ///< mutants only
  bool sparse = false;                                             ///< mutants only
  std::string device, started;

  std::string origin = "live";  ///< not written: "live", or "record <slug>" when it was read from a record

  bool is_mutant() const { return role == "mutant"; }
  bool is_knob_sweep() const { return !scalar_overrides.empty(); }
  /// The state that this role should end in: KILLED for a mutant, PASS for everything else.
  bool as_it_should_be() const { return state == (is_mutant() ? RunState::killed : RunState::pass); }
  const CheckResult* worst_check() const;  ///< largest ratio (NaN counts as largest), null without checks
  double worst_truth_gap() const;          ///< NaN when there is none
};

/// The timing gate's verdict; see core/gpu's timing code.
struct GateResult {
  /// "OK", "SLOW", "UNBASELINED", "BELOW_FLOOR"; in records also "ACCEPTED": slower than the record before
  /// it, and recorded as the new baseline on purpose (`gpuphys record --accept-slower`).
  std::string state;
  double baseline_multiple = std::numeric_limits<double>::quiet_NaN();
  double limit = std::numeric_limits<double>::quiet_NaN();  ///< largest multiple that the gate accepts
};

struct TimingResult {
  std::string task, label, set;
  std::vector<double> times_ms;
  double min_ms = std::numeric_limits<double>::quiet_NaN();
  double median_ms = std::numeric_limits<double>::quiet_NaN();
  double spread = std::numeric_limits<double>::quiet_NaN();  ///< (max - min) / min
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

nlohmann::json to_json(const RunResult&);
nlohmann::json to_json(const TimingResult&);
/// Throw Error(bad_input) naming `where` and the offending key.
RunResult run_result_from(const nlohmann::json&, const std::string& where);
TimingResult timing_result_from(const nlohmann::json&, const std::string& where);

/// A number as JSON: non-finite ones become the strings "nan", "inf", "-inf", which JSON itself cannot hold.
nlohmann::json json_number(double);
double number_from(const nlohmann::json&, const std::string& where);

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

/// The digest part of a record: root-relative source -> SHA-256 of its stripped text, and the SHA-256 over
/// all of them.
struct SourceDigest {
  std::map<std::string, std::string> files;
  std::string total;
};

struct TaskRecord {
  std::string task;
  SourceDigest digest;
  std::string device, driver, toolkit, date;
  std::vector<RunResult> results;
  std::vector<TimingResult> timing;
};

nlohmann::json to_json(const TaskRecord&);
TaskRecord task_record_from(const nlohmann::json&, const std::string& where);

/// "NVIDIA H200" -> "nvidia-h200".
std::string gpu_slug(const std::string& device);
/// The GPUs that have records, sorted.
std::vector<std::string> recorded_gpus(const std::string& records_root);
std::string record_path(const std::string& records_root, const std::string& slug, const std::string& task);
/// Empty when there is no such record; throws Error(bad_input) when it cannot be read.
std::optional<TaskRecord> load_record(const std::string& records_root, const std::string& slug,
                                      const std::string& task);
void write_record(const std::string& records_root, const std::string& slug, const TaskRecord&);

/// All records of one GPU as a result set whose entries carry origin "record <slug>".
ResultSet load_records(const std::string& records_root, const std::string& slug);

/// One entry for each (task, lane, label, set): the live one where there is one, the recorded one otherwise.
/// A live run that was skipped measured nothing: a recorded one takes its place, and a note says how often
/// that happened.
ResultSet merge_results(ResultSet live, ResultSet recorded);

/// What the reporting commands show: live results merged with the records of one GPU. `slug` empty chooses
/// the GPU of the live results, else the only GPU that has records; throws Error(usage) when several have and
/// none was named.
ResultSet gather_results(const std::string& results_root, const std::string& records_root,
                         const std::string& slug);

/// ISO 8601 UTC time, "2026-11-22T05:30:00Z".
std::string utc_now();

}  // namespace gpuphys
