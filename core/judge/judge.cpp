#include "core/judge/judge.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <sstream>

#include "core/base/files.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys {
namespace {

bool starts_with(const std::string& text, const std::string& prefix) {
  return text.rfind(prefix, 0) == 0;
}

std::string header_value(const std::string& patch, const std::string& key) {
  std::istringstream in(patch);
  for (std::string line; std::getline(in, line) && !starts_with(line, "--- ");) {
    if (!starts_with(line, key + ":")) continue;
    const std::size_t begin = line.find_first_not_of(' ', key.size() + 1);
    return begin == std::string::npos ? "" : line.substr(begin);
  }
  return "";
}

}  // namespace

ModuleIdentity identify(const std::string& label, const std::string& task, const std::string& mutants_root) {
  ModuleIdentity id;
  id.label = label;
  id.role = role_of(label);
  id.lane = lane_of(label);
  if (id.role != "mutant") return id;
  const std::string fault = label.substr(label.find('.') + 1);
  const std::string path = fmt::format("{}/{}/{}.patch", mutants_root, task, fault);
  const std::string patch = read_file(path);
  id.mutant_class = header_value(patch, "class");
  id.expected_check = header_value(patch, "check");
  id.sparse = header_value(patch, "sparse") == "yes";
  if (header_value(patch, "what").empty() || id.mutant_class.empty() || id.expected_check.empty()) {
    throw Error(ExitCode::bad_input,
                fmt::format("{}: the header needs the lines 'what:', 'class:' and 'check:'", path));
  }
  return id;
}

bool is_module_path(const std::string& module) {
  return module.find('/') != std::string::npos || module.ends_with(".so");
}

ModuleIdentity identify_module(const std::string& module, const std::string& label, const std::string& task,
                               const std::string& mutants_root) {
  if (!is_module_path(module)) {
    const ModuleIdentity own = identify(module, task, mutants_root);
    if (label.empty()) return own;
    // Under another name it is the suite's still if the name says so ("reference.permuted"), and a user's
    // otherwise.
    return identify(label, task, mutants_root);
  }
  const std::string name = label.empty() ? std::filesystem::path(module).stem().string() : label;
  const bool suite_mutant = starts_with(name, "mutant.") || starts_with(name, "serial_mutant.");
  if (suite_mutant || identify(name, task, mutants_root).role != "user") {
    throw Error(
        ExitCode::usage,
        fmt::format("'{}' would be kept as '{}', which is a module of the suite: choose another --label",
                    module, name));
  }
  return identify(name, task, mutants_root);
}

std::vector<std::string> planted_faults(const std::string& mutants_root, const std::string& task) {
  std::vector<std::string> faults;
  const std::filesystem::path folder = std::filesystem::path(mutants_root) / task;
  if (!std::filesystem::is_directory(folder)) return faults;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.path().extension() == ".patch") faults.push_back(entry.path().stem().string());
  }
  std::sort(faults.begin(), faults.end());
  return faults;
}

std::vector<CheckResult> apply_checks(const Task& task, const InputSet& set, const Judged& judged) {
  std::vector<CheckResult> results;
  for (const Check& check : checks_of(task, set)) {
    if (check.needs_truth && judged.truth == nullptr) {
      throw Error(ExitCode::internal,
                  fmt::format("{}: check '{}' needs the truth of set '{}'", task.name, check.name, set.name));
    }
    const Measured m = check.measure(judged);
    CheckResult r;
    r.name = check.name;
    r.kind = to_string(check.kind);
    r.quantity = check.quantity;
    r.norm = check.norm;
    r.error = m.error;
    r.tolerance = check.tolerance;
    r.ratio = ratio_of(m.error, check.tolerance);
    r.pass = passes(m.error, check.tolerance);
    r.detail = m.detail;
    results.push_back(std::move(r));
  }
  if (results.empty()) {
    throw Error(ExitCode::internal,
                fmt::format("{}: set '{}' has no checks: it could not fail", task.name, set.name));
  }
  return results;
}

bool wants_truth(const Task& task, const InputSet& set) {
  const std::vector<Check> checks = checks_of(task, set);
  const bool needed = std::any_of(checks.begin(), checks.end(), [](const Check& c) { return c.needs_truth; });
  return needed || set.known_solution != nullptr || (set.kind != SetKind::hard && set.size == Size::smoke);
}

void judge_call(const Task& task, const InputSet& set, const Problem& problem, const Arrays* truth,
                const CallReport& report, const Arrays* earlier, RunResult& result) {
  result.milliseconds = report.milliseconds;
  for (const FaultReport& f : report.faults) result.faults.push_back({to_string(f.fault), f.detail});
  if (!report.outputs.empty()) {
    result.checks = apply_checks(task, set, {problem, report.outputs, truth});
    if (truth != nullptr) {
      for (const HostArray& a : report.outputs)
        result.truth_gap[a.name()] = truth_gap(a, find(*truth, a.name(), "truth"));
      result.truth_source = set.truth_source;
    }
  }
  // NaN and infinity fail before any check, which might look elsewhere.
  const auto not_finite = [](const FaultReport& f) { return f.fault == Fault::non_finite_output; };
  const bool finite = std::none_of(report.faults.begin(), report.faults.end(), not_finite);
  const bool checks_pass =
      finite && !result.checks.empty() &&
      std::all_of(result.checks.begin(), result.checks.end(), [](const CheckResult& c) { return c.pass; });
  if (!checks_pass && !report.outputs.empty()) {
    for (const FaultReport& f : diagnose(problem, report.outputs, truth, earlier)) {
      result.faults.push_back({to_string(f.fault), f.detail});
    }
  }
  // Values that are merely wrong are for the checks to judge; a broken rule is a fault even when the values
  // are right.
  const bool rule_broken = !std::all_of(report.faults.begin(), report.faults.end(), not_finite);
  if (rule_broken || report.outputs.empty()) {
    result.state = RunState::fault;
    result.state_detail = result.faults.empty() ? "no outputs"
                                                : fmt::format("{}: {}", result.faults.front().fault,
                                                              result.faults.front().detail);
  } else if (checks_pass) {
    result.state = RunState::pass;
  } else {
    result.state = RunState::fail;
    const CheckResult* worst = result.worst_check();
    result.state_detail = fmt::format("{} is {:.3g} times its tolerance", worst->name, worst->ratio);
    if (!worst->detail.empty()) result.state_detail += fmt::format(" ({})", worst->detail);
    if (!result.faults.empty())
      result.state_detail +=
          fmt::format("; {}: {}", result.faults.front().fault, result.faults.front().detail);
  }
}

std::vector<FaultReport> diagnose(const Problem& problem, const Arrays& outputs, const Arrays* truth,
                                  const Arrays* earlier) {
  const auto all_zero = [](const HostArray& a) {
    for (std::int64_t i = 0; i < a.size(); ++i) {
      if (a.value(i) != 0) return false;
    }
    return true;
  };
  const auto same_bytes = [](const HostArray& a, const HostArray& b) {
    return a.dtype() == b.dtype() && a.bytes() == b.bytes() &&
           std::memcmp(a.data(), b.data(), a.bytes()) == 0;
  };
  std::vector<FaultReport> found;
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const HostArray& out = outputs[i];
    const bool truth_is_zero = truth != nullptr && i < truth->size() && all_zero((*truth)[i]);
    if (all_zero(out)) {
      if (!truth_is_zero)
        found.push_back({Fault::zero_output, fmt::format("output '{}' is zero everywhere", out.name())});
      continue;
    }
    if (earlier != nullptr && i < earlier->size() && same_bytes(out, (*earlier)[i])) {
      found.push_back({Fault::stale_output,
                       fmt::format("output '{}' is bitwise that of the previous call, which had other inputs",
                                   out.name())});
    }
    for (const HostArray& in : problem.inputs) {
      if (same_bytes(out, in)) {
        found.push_back(
            {Fault::copied_input, fmt::format("output '{}' is bitwise input '{}'", out.name(), in.name())});
      }
    }
  }
  return found;
}

void conclude_mutant(RunResult& r) {
  if (r.state == RunState::fault) r.state = RunState::crashed;
  if (r.state == RunState::pass) r.state = RunState::survived;
  if (r.state != RunState::fail) return;
  // `check:` of a patch names one check or several, separated by commas.
  const CheckResult* killer = r.expected_check.empty() ? r.worst_check() : nullptr;
  std::istringstream names(r.expected_check);
  for (std::string name; std::getline(names, name, ',');) {
    name.erase(0, name.find_first_not_of(' '));
    for (const CheckResult& c : r.checks) {
      if (c.name == name && !c.pass && (killer == nullptr || !(c.ratio <= killer->ratio))) killer = &c;
    }
  }
  if (killer == nullptr) {
    const CheckResult* worst = r.worst_check();
    r.state = RunState::survived;
    r.state_detail =
        fmt::format("{} does not see it, which its patch names; {} does, at {:.3g} times its tolerance",
                    r.expected_check, worst->name, worst->ratio);
    return;
  }
  r.state = RunState::killed;
  r.state_detail = fmt::format("{} at {:.3g} times its tolerance", killer->name, killer->ratio);
}

std::string check_table(const RunResult& result) {
  std::vector<const CheckResult*> order;
  for (const CheckResult& c : result.checks) order.push_back(&c);
  const auto key = [](const CheckResult* c) { return std::isnan(c->ratio) ? INFINITY : c->ratio; };
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return key(a) > key(b); });
  std::string text;
  for (const CheckResult* c : order) {
    text += fmt::format("    {:<4}  {:<26} error {:<10.3e} tolerance {:<9.2e} ratio {:<9.3g} {}\n",
                        c->pass ? "ok" : "FAIL", c->name, c->error, c->tolerance, c->ratio, c->detail);
  }
  return text;
}

}  // namespace gpuphys
