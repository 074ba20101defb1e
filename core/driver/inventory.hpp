// What should exist for each task, and whether its GPU record holds it.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "core/analysis.hpp"
#include "core/results.hpp"
#include "core/task.hpp"

namespace gpuphys {

/// Whether the reference of a task can be built with other blocks (it mentions GPUPHYS_OTHER_BLOCKS).
bool offers_other_blocks(const Task&, const std::string& source_root);

/// Sets, tolerances and planted faults of a task as its case file and mutants folder state them now. A patch
/// that does not touch the reference (or the serial baseline) plants no fault there.
Expectation expectation_of(const Task&, const std::string& source_root);

/// The tasks called `names`, all of them when empty. Throws Error(unknown_name).
std::vector<const Task*> select_tasks(const std::vector<std::string>& names);

/// What is wrong with a record: sources that changed since, results that are missing or not as they should
/// be.
std::vector<Issue> record_issues(const TaskRecord&, const Task&, const std::string& source_root);

/// verdict() with what only the repository knows: whether the records that results were taken from are older
/// than their sources.
Verdict full_verdict(const ResultSet&, const Task&, Lanes, const std::string& source_root);

/// What the reporting commands show: gather_results(), but where several GPUs have records, none is named and
/// no result is of one here, of each task the record whose runs are newest, on whatever GPU. Apart from
/// gather_results() only because core/results is part of every record's digest; join them with its next
/// change.
ResultSet gather_newest_results(const std::string& results_root, const std::string& records_root,
                                const std::string& slug);

/// Help of the option that names the GPU for gather_newest_results().
inline constexpr const char* kGpuHelp =
    "GPU whose records to use, e.g. nvidia-h200 (default: the one here, or of each task the newest)";

/// The GPU whose record supplied results of a task, "" when none did.
std::string record_slug(const ResultSet&, const std::string& task);

/// The record that the results of one task make: every GPU run and timing that is not a user's own. What the
/// results lack is taken over from `previous` if that was measured from the same sources on the same GPU.
/// Throws Error(bad_input) when there is nothing to record or results of several GPUs are mixed.
TaskRecord compose_record(const Task&, const ResultSet& live, const SourceDigest& digest,
                          const std::optional<TaskRecord>& previous);

}  // namespace gpuphys
