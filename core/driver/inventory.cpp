#include "core/driver/inventory.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <filesystem>
#include <iterator>
#include <map>
#include <set>
#include <sstream>
#include <utility>

#include "core/files.hpp"
#include "core/judge.hpp"
#include "core/source_digest.hpp"

namespace gpuphys {
namespace {

// Does a patch change files below `folder`?
bool touches(const std::string& patch, const std::string& folder) {
  std::istringstream in(patch);
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with("+++ ") && line.find(folder) != std::string::npos) return true;
  }
  return false;
}

bool is_recorded(const RunResult& r) {
  return r.lane == "gpu" && r.role != "user" && r.state != RunState::skipped;
}

}  // namespace

bool offers_other_blocks(const Task& task, const std::string& source_root) {
  return read_file(fmt::format("{}/references/{}/{}.cu", source_root, task.family, task.name))
             .find("GPUPHYS_OTHER_BLOCKS") != std::string::npos;
}

Expectation expectation_of(const Task& task, const std::string& source_root) {
  const std::string mutants_root = source_root + "/mutants";
  Expectation e;
  e.task = task.name;
  e.family = task.family;
  e.target_multiple = task.target_floor_multiple;
  for (const InputSet& set : task.sets) {
    const bool hard = set.kind == SetKind::hard, smoke = set.size == Size::smoke;
    if (smoke) e.cpu_sets.push_back(set.name);
    if (!smoke || hard) e.gpu_sets.push_back(set.name);
    if (!hard) (smoke ? e.cpu_mutant_sets : e.gpu_mutant_sets).push_back(set.name);
    for (const Check& check : checks_of(task, set)) e.tolerances[set.name][check.name] = check.tolerance;
  }
  for (const InputSet& set : task.sets) {
    if (set.size != Size::paper) continue;
    if (!task.unordered.empty() && set.kind == SetKind::open) {
      e.gpu_ensemble[kRunAgain].push_back(set.name);
      e.gpu_ensemble[kPermuted].push_back(set.name);
    }
    if (offers_other_blocks(task, source_root)) e.gpu_ensemble[kOtherBlocks].push_back(set.name);
  }
  for (const std::string& fault : planted_faults(mutants_root, task.name)) {
    const std::string patch = read_file(fmt::format("{}/{}/{}.patch", mutants_root, task.name, fault));
    if (touches(patch, "references/")) e.mutants.push_back(fault);
    if (touches(patch, "serial_baselines/")) e.serial_mutants.push_back(fault);
  }
  return e;
}

std::vector<const Task*> select_tasks(const std::vector<std::string>& names) {
  std::vector<const Task*> tasks;
  if (names.empty()) {
    for (const Task& t : all_tasks()) tasks.push_back(&t);
  }
  for (const std::string& name : names) tasks.push_back(&find_task(name));
  return tasks;
}

std::vector<Issue> record_issues(const TaskRecord& record, const Task& task, const std::string& source_root) {
  std::vector<Issue> found;
  const SourceDigest now = digest_sources(source_root, record_roots(source_root, task.family, task.name));
  const std::vector<std::string> differences = digest_differences(record.digest, now);
  if (!differences.empty()) {
    found.push_back({IssueKind::stale, task.name, "gpu", "", "",
                     fmt::format("the record of {} is older than its sources ({})", record.device,
                                 fmt::join(differences, "; "))});
  }
  ResultSet results;
  results.runs = record.results;
  results.timings = record.timing;
  for (TimingResult& t : results.timings) t.origin = "record";
  const std::vector<Issue> rest =
      issues(results, expectation_of(task, source_root), {.cpu = false, .gpu = true});
  found.insert(found.end(), rest.begin(), rest.end());
  return found;
}

ResultSet gather_newest_results(const std::string& results_root, const std::string& records_root,
                                const std::string& slug) {
  const std::vector<std::string> gpus = recorded_gpus(records_root);
  ResultSet live = load_results(results_root);
  const bool measured_here = std::any_of(live.runs.begin(), live.runs.end(), is_recorded);
  if (!slug.empty() || gpus.size() < 2 || measured_here)
    return gather_results(results_root, records_root, slug);
  ResultSet recorded;
  for (const std::string& gpu : gpus) {
    ResultSet of_gpu = load_records(records_root, gpu);
    std::move(of_gpu.runs.begin(), of_gpu.runs.end(), std::back_inserter(recorded.runs));
    std::move(of_gpu.timings.begin(), of_gpu.timings.end(), std::back_inserter(recorded.timings));
    std::move(of_gpu.unreadable.begin(), of_gpu.unreadable.end(), std::back_inserter(recorded.unreadable));
  }
  std::map<std::string, std::pair<std::string, std::string>> newest;  // by task: when started, and origin
  for (const RunResult& r : recorded.runs)
    newest[r.task] = std::max(newest[r.task], std::pair{r.started, r.origin});
  const auto older = [&](const auto& r) { return newest[r.task].second != r.origin; };
  std::erase_if(recorded.runs, older);
  std::erase_if(recorded.timings, older);
  return merge_results(std::move(live), std::move(recorded));
}

std::string record_slug(const ResultSet& results, const std::string& task) {
  const std::string prefix = "record ";
  for (const RunResult& r : results.runs) {
    if (r.task == task && r.origin.starts_with(prefix)) return r.origin.substr(prefix.size());
  }
  for (const TimingResult& t : results.timings) {
    if (t.task == task && t.origin.starts_with(prefix)) return t.origin.substr(prefix.size());
  }
  return "";
}

Verdict full_verdict(const ResultSet& results, const Task& task, Lanes lanes,
                     const std::string& source_root) {
  Verdict v = verdict(results, expectation_of(task, source_root), lanes);
  const std::string slug = record_slug(results, task.name);
  if (!lanes.gpu || slug.empty()) return v;
  const std::optional<TaskRecord> record = load_record(source_root + "/ci/records", slug, task.name);
  for (const Issue& issue : record ? record_issues(*record, task, source_root) : std::vector<Issue>{}) {
    // Its results are among those already judged; what only the record knows is that its sources changed.
    if (issue.kind != IssueKind::stale || !issue.label.empty()) continue;
    v.issues.push_back(issue);
    if (v.state == "OK") v.state = to_string(issue.kind);
  }
  return v;
}

TaskRecord compose_record(const Task& task, const ResultSet& live, const SourceDigest& digest,
                          const std::optional<TaskRecord>& previous) {
  ResultSet fresh;
  std::set<std::string> devices;
  for (const RunResult& r : live.runs) {
    if (r.task != task.name || !is_recorded(r)) continue;
    fresh.runs.push_back(r);
    if (!r.device.empty()) devices.insert(r.device);
  }
  std::string latest;
  TaskRecord record;
  for (const TimingResult& t : live.timings) {
    if (t.task != task.name) continue;
    // The timing of a user's module is no record either; its label is not that of a module of the suite.
    const std::string base = t.label.substr(0, t.label.find('@'));
    if (base != "reference" && base != "fmad") continue;
    fresh.timings.push_back(t);
    devices.insert(t.device);
    record.driver = t.driver;
    record.toolkit = t.toolkit;
  }
  if (fresh.runs.empty() && fresh.timings.empty()) {
    throw Error(ExitCode::bad_input,
                fmt::format("there are no GPU results of task '{}' to record", task.name));
  }
  if (devices.size() != 1) {
    throw Error(ExitCode::bad_input,
                fmt::format("GPU results of task '{}' come from {} devices ({}): record them apart",
                            task.name, devices.size(), fmt::join(devices, ", ")));
  }
  record.task = task.name;
  record.digest = digest;
  record.device = *devices.begin();
  record.date = utc_now();
  if (previous && previous->digest.files == digest.files && previous->device == record.device) {
    ResultSet old;
    old.runs = previous->results;
    old.timings = previous->timing;
    fresh = merge_results(std::move(fresh), std::move(old));
    if (record.driver.empty()) record.driver = previous->driver;
    if (record.toolkit.empty()) record.toolkit = previous->toolkit;
  }
  record.results = std::move(fresh.runs);
  record.timing = std::move(fresh.timings);
  return record;
}

}  // namespace gpuphys
