// What should exist for each task, and whether its GPU record holds it.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/records/record.hpp"
#include "core/records/results.hpp"
#include "core/report/analysis.hpp"

namespace gpuphys {

/// Whether the reference of a task can be built with other blocks (it mentions GPUPHYS_OTHER_BLOCKS).
bool offers_other_blocks(const Task&, const std::string& source_root);

/// Sets, tolerances and planted faults of a task as its case file and mutants folder state them now. A patch
/// that does not touch the reference (or the serial baseline) plants no fault there.
Expectation expectation_of(const Task&, const std::string& source_root);

/// The tasks called `names`, all of them when empty. Throws Error(unknown_name).
std::vector<const Task*> select_tasks(const std::vector<std::string>& names);

/// Fills what the label and the task say of each run (a mutant's class, what a check looks at) and no file is
/// asked for.
void annotate(ResultSet&, const std::string& mutants_root);

/// Sources and flags that each module of a task should be built from now, by label; from what the build noted
/// about all modules, whether or not it made them, and the sources as they are. Throws Error(bad_input) when
/// a source is missing.
std::map<std::string, ModuleStamp> expected_stamps(const Context&, const Task&);

/// The evidence of a set (core/records/record.hpp), from what is generated and computed here and now
/// (`with_truth` false: without truth, and so without what the checks find).
SetEvidence evidence_of(const Context&, const Task&, const InputSet&, bool with_truth = true);

/// Digest of the sources that make a task's inputs and checks, and of those that make its truth.
std::string case_sources(const Context&, const Task&);
std::string baseline_sources(const Context&, const Task&);
/// Digest of what belongs to the harness: the judge, the runner, the exploits and the gate's own test.
std::string harness_sources(const Context&);

/// What is wrong with a record: modules whose sources or flags changed since, sets that are no longer what
/// they were, results that are missing or not as they should be. Inputs, truth and checks are computed again
/// only where the sources that make them have changed.
std::vector<Issue> record_issues(const Context&, const TaskRecord&, const Task&);

/// verdict() with what only the repository knows: whether the records that results were taken from are older
/// than their sources.
Verdict full_verdict(const Context&, const ResultSet&, const Task&, Lanes);

/// What the reporting commands show: live results merged with committed records. `slug` names the GPU whose
/// records to use; without it, the GPU of the live results, else of each task the record whose runs are
/// newest. Throws Error(unknown_name) when a named GPU has none.
ResultSet gather_results(const Context&, const std::string& slug);

/// Help of the option that names the GPU for gather_results().
inline constexpr const char* kGpuHelp =
    "GPU whose records to use, e.g. nvidia-h200 (default: the one here, or of each task the newest)";

/// The GPU whose record supplied results of a task, "" when none did.
std::string record_slug(const ResultSet&, const std::string& task);

/// The record that the results of one task make: every GPU run and timing that is not a user's own, of the
/// modules as they should be built now; results of other sources are refused, named in `refused`. What the
/// results lack is taken over from `previous` where that was of the same GPU, module sources, inputs and
/// truth. Throws Error(bad_input) when there is nothing to record or results of several GPUs are mixed.
TaskRecord compose_record(const Context&, const Task&, const ResultSet& live,
                          const std::optional<TaskRecord>& previous, std::vector<std::string>& refused);

}  // namespace gpuphys
