#include "core/driver/inventory.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <iterator>
#include <map>
#include <set>
#include <sstream>
#include <utility>

#include "core/base/files.hpp"
#include "core/base/text.hpp"
#include "core/generators/random.hpp"
#include "core/judge/judge.hpp"
#include "core/records/labels.hpp"
#include "core/records/source_digest.hpp"

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
    e.gpu_ensemble[kFastMath].push_back(set.name);
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

void annotate(ResultSet& results, const std::string& mutants_root) {
  std::map<std::string, const Task*> tasks;
  for (const Task& t : all_tasks()) tasks[t.name] = &t;
  for (RunResult& r : results.runs) {
    const auto found = tasks.find(r.task);
    if (found == tasks.end()) continue;
    const Task& task = *found->second;
    for (const InputSet& set : task.sets) {
      if (set.name != r.set) continue;
      r.set_kind = to_string(set.kind);
      r.size = to_string(set.size);
      for (const Check& check : checks_of(task, set)) {
        for (CheckResult& c : r.checks) {
          if (c.name != check.name) continue;
          c.kind = to_string(check.kind);
          c.quantity = check.quantity;
          c.norm = check.norm;
        }
      }
    }
    if (!r.is_mutant()) continue;
    try {
      const ModuleIdentity id = identify(r.label, r.task, mutants_root);
      r.mutant_class = id.mutant_class;
      r.expected_check = id.expected_check;
      r.sparse = id.sparse;
    } catch (const Error&) {
      // The patch is gone: issues() says so.
    }
  }
}

namespace {

// Digests of sources, each computed once in a process.
const std::string& digest_total(const Roots& where, const std::vector<std::string>& roots) {
  static std::map<std::string, std::string> known;
  std::string& digest =
      known[fmt::format("{}|{}|{}|{}", where.source, where.overlay, where.of_module, fmt::join(roots, "|"))];
  if (digest.empty()) digest = digest_sources(where, roots).total;
  return digest;
}

// Outputs that are the truth plus a perturbation of a thousandth of its rms that depends on nothing but the
// index.
Arrays perturbed(const Task& task, const Problem& problem, const Arrays& truth) {
  Arrays outputs = make_outputs(task.contract, problem);
  std::uint64_t stream = 0;
  for (HostArray& a : outputs) {
    const HostArray& t = find(truth, a.name(), "truth");
    ++stream;
    if (a.dtype() != DType::f32) {
      std::memcpy(a.data(), std::as_const(t).data(), std::min(a.bytes(), t.bytes()));
      continue;
    }
    double square = 0;
    for (std::int64_t i = 0; i < t.size(); ++i) square += t.value(i) * t.value(i);
    const double rms = std::sqrt(square / static_cast<double>(std::max<std::int64_t>(t.size(), 1)));
    const auto values = a.as<float>();
    for (std::int64_t i = 0; i < t.size(); ++i) {
      values[static_cast<std::size_t>(i)] =
          static_cast<float>(t.value(i) + 1e-3 * rms * uniform11(77, stream, static_cast<std::uint64_t>(i)));
    }
  }
  return outputs;
}

// Figures that other compilers and mathematical libraries may give with other last digits.
bool same_figure(double a, double b) {
  if (std::isnan(a) || std::isnan(b)) return std::isnan(a) && std::isnan(b);
  if (std::isinf(a) || std::isinf(b)) return a == b;
  return std::abs(a - b) <= 1e-4 * std::max(std::abs(a), std::abs(b));
}

}  // namespace

std::map<std::string, ModuleStamp> expected_stamps(const Context& ctx, const Task& task) {
  std::map<std::string, ModuleStamp> stamps;
  const std::string path = ctx.modules_root + "/expected.tsv";
  if (!std::filesystem::exists(path)) return stamps;
  std::istringstream lines(read_file(path));
  for (std::string line; std::getline(lines, line);) {
    std::vector<std::string> cells(1);
    for (const char c : line) {
      if (c == '\t')
        cells.emplace_back();
      else
        cells.back() += c;
    }
    if (cells.size() != 5 || cells[0] != task.name) continue;
    stamps[cells[1]] = {digest_total({ctx.source_root, cells[3], true}, {cells[2]}), cells[4], ""};
  }
  return stamps;
}

std::string case_sources(const Context& ctx, const Task& task) {
  return digest_total({ctx.source_root, "", false}, {fmt::format("cases/{}/{}.cpp", task.family, task.name)});
}

std::string baseline_sources(const Context& ctx, const Task& task) {
  return digest_total({ctx.source_root, "", false},
                      {fmt::format("serial_baselines/{}/{}.cpp", task.family, task.name)});
}

std::string harness_sources(const Context& ctx) {
  std::vector<std::string> roots{"core/driver/main.cpp", "core/driver/command_run.cpp",
                                 "core/driver/command_time.cpp"};
  for (const char* folder : {"core/run", "core/run/gpu", "core/judge", "core/measure", "tests/exploits",
                             "tests/slowdown_modules"}) {
    for (const auto& entry : std::filesystem::directory_iterator(ctx.source_root + "/" + folder)) {
      const std::string extension = entry.path().extension().string();
      if (extension == ".cpp" || extension == ".cu")
        roots.push_back(fmt::format("{}/{}", folder, entry.path().filename().string()));
    }
  }
  std::sort(roots.begin(), roots.end());
  return digest_total({ctx.source_root, "", false}, roots);
}

SetEvidence evidence_of(const Context& ctx, const Task& task, const InputSet& set, bool with_truth) {
  const bool wanted = with_truth && wants_truth(task, set);
  const Prepared p = prepare(ctx.workplace(), task, set, wanted);
  SetEvidence e;
  e.inputs = p.inputs_digest;
  e.truth = p.truth_digest;
  for (const Arrays* arrays : {&p.problem.inputs, &p.truth}) {
    for (const HostArray& a : *arrays) e.bytes += static_cast<double>(a.bytes());
  }
  for (const ArraySpec& spec : task.contract.outputs) {
    const auto symbols = resolve_symbols(task.contract, p.problem, "inputs");
    e.bytes += static_cast<double>(element_count(evaluate_shape(spec, symbols))) *
               static_cast<double>(size_of(spec.dtype));
  }
  if (set.size != Size::smoke || !wanted) return e;
  const Arrays outputs = perturbed(task, p.problem, p.truth);
  for (const CheckResult& c : apply_checks(task, set, {p.problem, outputs, &p.truth}))
    e.checks[c.name] = c.error;
  return e;
}

std::vector<Issue> record_issues(const Context& ctx, const TaskRecord& record, const Task& task) {
  std::vector<Issue> found;
  const auto stale = [&](const std::string& label, const std::string& set, const std::string& why) {
    found.push_back({IssueKind::stale, task.name, "gpu", label, set,
                     fmt::format("the record of {}: {}", record.device, why)});
  };
  const std::map<std::string, ModuleStamp> expected = expected_stamps(ctx, task);
  for (const auto& [label, stamp] : record.modules) {
    const auto now = expected.find(label);
    if (expected.empty()) break;  // a build without CUDA notes no device modules
    if (now == expected.end()) {
      stale(label, "", "there is no such module any more");
    } else if (now->second.sources != stamp.sources) {
      stale(label, "", "its sources have changed since");
    } else if (now->second.flags != stamp.flags) {
      stale(label, "", fmt::format("it was built with '{}', now '{}'", stamp.flags, now->second.flags));
    }
  }
  const bool other_case = record.case_sources != case_sources(ctx, task);
  const bool other_baseline = record.baseline_sources != baseline_sources(ctx, task);
  for (const InputSet& set : task.sets) {
    const auto evidence = record.sets.find(set.name);
    if (evidence == record.sets.end()) {
      const bool needed = set.kind == SetKind::hard || set.size == Size::paper;
      if (needed) stale("", set.name, "it does not know this set");
      continue;
    }
    // A baseline at paper size takes a minute: done again only when it is another one.
    if (!other_case && !other_baseline) continue;
    const SetEvidence now = evidence_of(ctx, task, set);
    if (now.inputs != evidence->second.inputs) stale("", set.name, "its inputs are other ones now");
    if (!evidence->second.truth.empty() && now.truth != evidence->second.truth) {
      const bool same_inputs = now.inputs == evidence->second.inputs;
      // Truth that another compiler computed differs in its last digits; what the checks find of it must not.
      bool same = same_inputs && !now.checks.empty() && now.checks.size() == evidence->second.checks.size();
      for (const auto& [name, error] : now.checks) {
        const auto then = evidence->second.checks.find(name);
        same = same && then != evidence->second.checks.end() && same_figure(then->second, error);
      }
      if (same_inputs && !same) stale("", set.name, "its truth is another one now");
      continue;
    }
    for (const auto& [name, error] : now.checks) {
      const auto then = evidence->second.checks.find(name);
      if (then == evidence->second.checks.end())
        stale("", set.name, fmt::format("check '{}' is new", name));
      else if (!same_figure(then->second, error))
        stale("", set.name,
              fmt::format("check '{}' finds {:.6g} on the same outputs, then {:.6g}", name, error,
                          then->second));
    }
  }
  ResultSet results;
  results.runs = record.results;
  results.timings = record.timing;
  for (TimingResult& t : results.timings) t.origin = "record";
  annotate(results, ctx.mutants_root());
  const std::vector<Issue> rest =
      issues(results, expectation_of(task, ctx.source_root), {.cpu = false, .gpu = true});
  found.insert(found.end(), rest.begin(), rest.end());
  return found;
}

ResultSet gather_results(const Context& ctx, const std::string& slug) {
  const std::vector<std::string> gpus = recorded_gpus(ctx.records_root());
  if (!slug.empty() && std::find(gpus.begin(), gpus.end(), slug) == gpus.end()) {
    throw Error(
        ExitCode::unknown_name,
        fmt::format("no records of GPU '{}' under '{}'; there are: {}", printable(slug), ctx.records_root(),
                    gpus.empty() ? "none" : fmt::format("{}", fmt::join(gpus, ", "))));
  }
  ResultSet live = load_results(ctx.results_root);
  std::set<std::string> here;
  for (const RunResult& r : live.runs) {
    if (is_recorded(r) && !r.device.empty()) here.insert(gpu_slug(r.device));
  }
  std::vector<std::string> wanted = gpus;
  if (!slug.empty()) wanted = {slug};
  if (slug.empty() && here.size() == 1) wanted = {*here.begin()};
  ResultSet recorded;
  for (const std::string& gpu : wanted) {
    ResultSet of_gpu = load_records(ctx.records_root(), gpu);
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
  ResultSet all = merge_results(std::move(live), std::move(recorded));
  annotate(all, ctx.mutants_root());
  return all;
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

Verdict full_verdict(const Context& ctx, const ResultSet& results, const Task& task, Lanes lanes) {
  Verdict v = verdict(results, expectation_of(task, ctx.source_root), lanes);
  const std::string slug = record_slug(results, task.name);
  if (!lanes.gpu || slug.empty()) return v;
  const std::optional<TaskRecord> record = load_record(ctx.records_root(), slug, task.name);
  for (const Issue& issue : record ? record_issues(ctx, *record, task) : std::vector<Issue>{}) {
    // Its results are among those already judged; what only the record knows is that something changed since.
    if (issue.kind != IssueKind::stale) continue;
    v.issues.push_back(issue);
    if (v.state == "OK") v.state = to_string(issue.kind);
  }
  return v;
}

TaskRecord compose_record(const Context& ctx, const Task& task, const ResultSet& live,
                          const std::optional<TaskRecord>& previous, std::vector<std::string>& refused) {
  const std::map<std::string, ModuleStamp> expected = expected_stamps(ctx, task);
  // Whether a result is of the module as it should be built now.
  const auto is_current = [&](const std::string& label, const ModuleStamp& stamp) {
    const auto now = expected.find(module_of(label));
    return now != expected.end() && now->second.sources == stamp.sources && now->second.flags == stamp.flags;
  };
  ResultSet fresh;
  std::set<std::string> devices;
  TaskRecord record;
  for (const RunResult& r : live.runs) {
    if (r.task != task.name || !is_recorded(r)) continue;
    if (!is_current(r.label, r.module)) {
      refused.push_back(fmt::format("{} {} {}: it is of other sources or flags", r.task, r.label, r.set));
      continue;
    }
    fresh.runs.push_back(r);
    record.modules[module_of(r.label)] = r.module;
    if (!r.device.empty()) devices.insert(r.device);
  }
  for (const TimingResult& t : live.timings) {
    // The timing of a user's module is no record; its label is not that of a module of the suite.
    if (t.task != task.name || lane_of(t.label) != "gpu" || role_of(t.label) == "mutant") continue;
    if (!is_current(t.label, t.module)) {
      refused.push_back(
          fmt::format("{} {} {}: its timing is of other sources or flags", t.task, t.label, t.set));
      continue;
    }
    fresh.timings.push_back(t);
    record.modules[module_of(t.label)] = t.module;
    devices.insert(t.device);
    record.driver = t.driver;
    record.toolkit = t.toolkit;
  }
  if (fresh.runs.empty() && fresh.timings.empty())
    throw Error(ExitCode::bad_input,
                fmt::format("there are no GPU results of task '{}' to record", task.name));
  if (devices.size() != 1) {
    throw Error(ExitCode::bad_input,
                fmt::format("GPU results of task '{}' come from {} devices ({}): record them apart",
                            task.name, devices.size(), fmt::join(devices, ", ")));
  }
  record.task = task.name;
  record.device = *devices.begin();
  record.date = utc_now();
  record.case_sources = case_sources(ctx, task);
  record.baseline_sources = baseline_sources(ctx, task);
  for (const InputSet& set : task.sets) {
    // Truth of paper size takes a minute to make: its digest is that of the runs that were judged on it.
    SetEvidence& e = record.sets[set.name] = evidence_of(ctx, task, set, set.size == Size::smoke);
    for (const RunResult& r : fresh.runs) {
      if (r.set == set.name && set.size == Size::paper && !r.truth.empty()) e.truth = r.truth;
      if (r.set == set.name) e.bytes = std::max(e.bytes, r.bytes);
    }
  }
  // Each run must have been judged on the sets as they are now.
  std::erase_if(fresh.runs, [&](const RunResult& r) {
    const auto set = record.sets.find(r.set);
    const bool same = set != record.sets.end() && set->second.inputs == r.inputs &&
                      (r.truth.empty() || set->second.truth == r.truth);
    if (!same)
      refused.push_back(fmt::format("{} {} {}: it is of other inputs or truth", r.task, r.label, r.set));
    return !same;
  });
  if (previous && previous->device == record.device) {
    ResultSet old;
    for (const RunResult& r : previous->results) {
      const auto then = previous->sets.find(r.set);
      const auto now = record.sets.find(r.set);
      const bool same_set = then != previous->sets.end() && now != record.sets.end() &&
                            then->second.inputs == now->second.inputs &&
                            then->second.truth == now->second.truth;
      if (same_set && is_current(r.label, r.module)) old.runs.push_back(r);
    }
    for (const TimingResult& t : previous->timing) {
      if (is_current(t.label, t.module)) old.timings.push_back(t);
    }
    for (const RunResult& r : old.runs) record.modules.emplace(module_of(r.label), r.module);
    for (const TimingResult& t : old.timings) record.modules.emplace(module_of(t.label), t.module);
    fresh = merge_results(std::move(fresh), std::move(old));
    if (record.driver.empty()) record.driver = previous->driver;
    if (record.toolkit.empty()) record.toolkit = previous->toolkit;
  }
  record.results = std::move(fresh.runs);
  record.timing = std::move(fresh.timings);
  return record;
}

}  // namespace gpuphys
