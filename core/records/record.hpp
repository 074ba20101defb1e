// The committed GPU records: what a GPU run leaves in the repository, and what it was measured from.
//
//     ci/records/<gpu>/<task>.json     one TaskRecord, a line for each run
//     ci/records/<gpu>/harness.json    what belongs to the harness: exploits, gate, blocks
//     ci/history/<gpu>/<task>.csv      every timing that was ever accepted, appended to
//
// A record certifies what it was measured from: every run names the digest of its module's sources and flags,
// and those of the inputs and truth that it was judged on. One changed patch makes one mutant's runs stale,
// one changed reference those of its builds, a changed text nothing.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/records/results.hpp"

namespace gpuphys {

/// What an input set was when it was recorded.
struct SetEvidence {
  std::string inputs, truth;  ///< digests
  double bytes = 0;           ///< that a run on it holds
  /// Smoke and hard sets: what every check finds on outputs that are the truth plus a fixed perturbation.
  std::map<std::string, double> checks;
};

struct TaskRecord {
  std::string task;
  std::string device, driver, toolkit, date;
  std::map<std::string, ModuleStamp> modules;  ///< by label of the module
  std::map<std::string, SetEvidence> sets;
  /// Digests of the sources that make inputs and checks (the case file and what it includes) and truth (the
  /// baseline). While they are the same nothing has to be computed again to know that the evidence holds.
  std::string case_sources, baseline_sources;
  std::vector<RunResult> results;
  std::vector<TimingResult> timing;
};

/// The state of one of the harness's own tests on a GPU.
struct HarnessRecord {
  std::string device, driver, toolkit, date;
  std::string sources;                       ///< digest of the judge, the runner and the exploits
  std::map<std::string, std::string> tests;  ///< CTest name -> "passed", "failed", ...
};

std::vector<std::string> recorded_gpus(const std::string& records_root);
std::string record_path(const std::string& records_root, const std::string& slug, const std::string& task);
/// Empty when there is no such record; throws Error(bad_input) when it cannot be read.
std::optional<TaskRecord> load_record(const std::string& records_root, const std::string& slug,
                                      const std::string& task);
void write_record(const std::string& records_root, const std::string& slug, const TaskRecord&);
std::optional<HarnessRecord> load_harness_record(const std::string& records_root, const std::string& slug);
void write_harness_record(const std::string& records_root, const std::string& slug, const HarnessRecord&);

/// All records of one GPU as a result set whose entries carry origin "record <slug>". One that cannot be read
/// is named in `unreadable`.
ResultSet load_records(const std::string& records_root, const std::string& slug);

// ---- history of timings ----

/// One line of a history.
struct HistoryEntry {
  std::string date, label, set, sources;  ///< sources: the first 12 digits of the module's digest
  double median_ms = 0, min_ms = 0, floor_ms = 0, multiple = 0, spread = 0;
  bool accepted = true;  ///< counts as a baseline from here on
  std::string reason;    ///< why something slower was accepted; a new best starts here
};

std::vector<HistoryEntry> load_history(const std::string& history_root, const std::string& slug,
                                       const std::string& task);
void append_history(const std::string& history_root, const std::string& slug, const std::string& task,
                    const std::vector<HistoryEntry>&);
/// The entry with the smallest multiple of this label and set, counted from the last one that was accepted
/// with a reason; null when there is none.
const HistoryEntry* best_accepted(const std::vector<HistoryEntry>&, const std::string& label,
                                  const std::string& set);

}  // namespace gpuphys
