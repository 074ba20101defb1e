#include "core/contract/task.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

namespace gpuphys {
namespace {

// Levenshtein distance, for "did you mean".
std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t substitute = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({substitute, row[j] + 1, row[j - 1] + 1});
    }
  }
  return row[b.size()];
}

}  // namespace

InputSet hard_case(const std::string& stress, const std::string& about, std::function<Problem()> make,
                   std::vector<Check> invariants, bool use_task_checks) {
  InputSet set;
  set.name = "hard_" + stress;
  set.kind = SetKind::hard;
  set.size = Size::smoke;
  set.about = about;
  set.make = std::move(make);
  set.invariants = std::move(invariants);
  set.use_task_checks = use_task_checks;
  return set;
}

std::string to_string(SetKind kind) {
  switch (kind) {
    case SetKind::open:
      return "public";
    case SetKind::hidden:
      return "hidden";
    case SetKind::hard:
      return "hard";
  }
  return "unknown";
}

std::string to_string(Size size) {
  return size == Size::smoke ? "smoke" : "paper";
}

std::string to_string(CheckKind kind) {
  switch (kind) {
    case CheckKind::paper:
      return "paper";
    case CheckKind::local:
      return "local";
    case CheckKind::invariant:
      return "invariant";
  }
  return "unknown";
}

const InputSet& Task::set(const std::string& wanted) const {
  std::vector<std::string> names;
  for (const InputSet& s : sets) {
    if (s.name == wanted) return s;
    names.push_back(s.name);
  }
  throw Error(ExitCode::unknown_name, fmt::format("task '{}' has no input set '{}'; it has: {}", name, wanted,
                                                  fmt::join(names, ", ")));
}

double compulsory_bytes(const Task& task, const Problem& problem) {
  double bytes = 0;
  for (const HostArray& a : problem.inputs) bytes += static_cast<double>(a.bytes());
  for (const HostArray& a : make_outputs(task.contract, problem)) bytes += static_cast<double>(a.bytes());
  return bytes;
}

std::vector<Check> checks_of(const Task& task, const InputSet& set) {
  std::vector<Check> checks;
  if (set.use_task_checks) checks = task.checks;
  checks.insert(checks.end(), set.invariants.begin(), set.invariants.end());
  return checks;
}

const Task& find_task(const std::string& name) {
  const std::vector<Task>& tasks = all_tasks();
  for (const Task& t : tasks) {
    if (t.name == name) return t;
  }
  std::vector<std::string> names;
  for (const Task& t : tasks) names.push_back(t.name);
  std::sort(names.begin(), names.end(), [&](const std::string& a, const std::string& b) {
    return edit_distance(a, name) < edit_distance(b, name);
  });
  names.resize(std::min<std::size_t>(names.size(), 3));
  throw Error(ExitCode::unknown_name, fmt::format("unknown task '{}'; nearest: {} (`gpuphys list` shows all)",
                                                  name, fmt::join(names, ", ")));
}

}  // namespace gpuphys
