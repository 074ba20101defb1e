#include "core/records/record.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <sstream>

#include "core/base/files.hpp"
#include "core/base/text.hpp"
#include "core/records/labels.hpp"
#include "core/records/results_json.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr const char* kHarness = "harness";
constexpr const char* kHistoryHead =
    "date,label,set,median_ms,min_ms,floor_ms,multiple,spread,sources,accepted,reason";

void require_plain_name(const std::string& name, const char* what) {
  if (name.empty() || name.find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789_-") != std::string::npos)
    throw Error(ExitCode::usage, fmt::format("{} '{}' cannot be the name of a file", what, printable(name)));
}

// What the record says once for all its runs, or what follows from the label, is left out of each run.
json run_line(RunResult r, const TaskRecord& record) {
  json j = to_json(r);
  for (const char* key : {"schema", "task", "truth_source", "inputs", "truth", "module", "bytes"})
    j.erase(key);
  if (r.device == record.device) j.erase("device");
  json checks = json::object();
  for (const CheckResult& c : r.checks) checks[c.name] = {json_number(c.error), json_number(c.tolerance)};
  j["checks"] = checks;
  if (r.faults.empty()) j.erase("faults");
  if (r.truth_gap.empty()) j.erase("truth_gap");
  if (r.state_detail.empty()) j.erase("state_detail");
  return j;
}

RunResult run_from_line(json j, const TaskRecord& record, const std::string& where) {
  j["schema"] = kResultSchema;
  j["task"] = record.task;
  if (!j.contains("device")) j["device"] = record.device;
  if (!j.contains("faults")) j["faults"] = json::array();
  if (!j.contains("truth_gap")) j["truth_gap"] = json::object();
  json checks = json::array();
  for (const auto& [name, pair] : json_member(j, "checks", where).items()) {
    if (!pair.is_array() || pair.size() != 2)
      throw Error(ExitCode::bad_input, fmt::format("{}: check '{}' is not [error, tolerance]", where, name));
    checks.push_back({{"name", name}, {"error", pair[0]}, {"tolerance", pair[1]}});
  }
  j["checks"] = checks;
  RunResult r = run_result_from(j, where);
  if (const auto m = record.modules.find(module_of(r.label)); m != record.modules.end()) r.module = m->second;
  if (const auto s = record.sets.find(r.set); s != record.sets.end()) {
    r.inputs = s->second.inputs;
    r.truth = s->second.truth;
    r.bytes = s->second.bytes;
    if (!s->second.truth.empty()) r.truth_source = "serial FP64 baseline";
  }
  return r;
}

// A JSON object whose lists and objects of objects have one line per entry, so that a renewal reads as a
// diff.
std::string with_lines(const json& j) {
  std::string text = "{\n";
  for (auto it = j.begin(); it != j.end(); ++it) {
    text += json(it.key()).dump() + ": ";
    if (it->is_array() && !it->empty()) {
      text += "[\n";
      for (std::size_t i = 0; i < it->size(); ++i)
        text += (*it)[i].dump() + (i + 1 < it->size() ? ",\n" : "\n");
      text += "]";
    } else if (it->is_object() && !it->empty()) {
      text += "{\n";
      for (auto e = it->begin(); e != it->end();) {
        text += json(e.key()).dump() + ": " + e->dump();
        text += ++e != it->end() ? ",\n" : "\n";
      }
      text += "}";
    } else {
      text += it->dump();
    }
    text += std::next(it) != j.end() ? ",\n" : "\n";
  }
  return text + "}\n";
}

std::vector<std::string> split_csv(const std::string& line) {
  std::vector<std::string> cells(1);
  bool quoted = false;
  for (std::size_t i = 0; i < line.size(); ++i) {
    if (line[i] == '"' && quoted && i + 1 < line.size() && line[i + 1] == '"') {
      cells.back() += line[i++];
    } else if (line[i] == '"') {
      quoted = !quoted;
    } else if (line[i] == ',' && !quoted) {
      cells.emplace_back();
    } else {
      cells.back() += line[i];
    }
  }
  return cells;
}

std::string csv_cell(const std::string& text) {
  if (text.find_first_of(",\"") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? "\"\"" : std::string(1, c);
  return quoted + "\"";
}

}  // namespace

std::vector<std::string> recorded_gpus(const std::string& records_root) {
  std::vector<std::string> slugs;
  std::error_code ec;
  if (!fs::is_directory(records_root, ec)) return slugs;
  for (const fs::directory_entry& entry : fs::directory_iterator(records_root)) {
    if (!entry.is_directory()) continue;
    for (const fs::directory_entry& file : fs::directory_iterator(entry.path())) {
      if (file.path().extension() != ".json" || file.path().stem() == kHarness) continue;
      slugs.push_back(entry.path().filename().string());
      break;
    }
  }
  std::sort(slugs.begin(), slugs.end());
  return slugs;
}

std::string record_path(const std::string& records_root, const std::string& slug, const std::string& task) {
  require_plain_name(slug, "GPU");
  require_plain_name(task, "task");
  return (fs::path(records_root) / slug / (task + ".json")).string();
}

std::optional<TaskRecord> load_record(const std::string& records_root, const std::string& slug,
                                      const std::string& task) {
  const std::string path = record_path(records_root, slug, task);
  if (!fs::exists(path)) return std::nullopt;
  const std::string where = fmt::format("record '{}'", path);
  const json j = parse_json_file(path);
  require_schema(j, where);
  TaskRecord record;
  record.task = json_text(j, "task", where);
  if (record.task != task)
    throw Error(ExitCode::bad_input, fmt::format("{}: it is of task '{}'", where, record.task));
  record.device = json_text(j, "device", where);
  record.driver = json_text_or_empty(j, "driver", where);
  record.toolkit = json_text_or_empty(j, "toolkit", where);
  record.date = json_text_or_empty(j, "date", where);
  record.case_sources = json_text_or_empty(j, "case_sources", where);
  record.baseline_sources = json_text_or_empty(j, "baseline_sources", where);
  for (const auto& [label, stamp] : json_member(j, "modules", where).items())
    record.modules[label] = stamp_from(stamp, where);
  for (const auto& [set, e] : json_member(j, "sets", where).items()) {
    SetEvidence& evidence = record.sets[set];
    evidence.inputs = json_text(e, "inputs", where);
    evidence.truth = json_text_or_empty(e, "truth", where);
    evidence.bytes = number_from(json_member(e, "bytes", where), where);
    if (!e.contains("checks")) continue;
    for (const auto& [name, error] : json_member(e, "checks", where).items())
      evidence.checks[name] = number_from(error, where);
  }
  for (const json& r : json_list(j, "runs", where)) record.results.push_back(run_from_line(r, record, where));
  for (json t : json_list(j, "timings", where)) {
    t["schema"] = kResultSchema;
    t["task"] = task;
    record.timing.push_back(timing_result_from(t, where));
    if (const auto m = record.modules.find(module_of(record.timing.back().label)); m != record.modules.end())
      record.timing.back().module = m->second;
  }
  return record;
}

void write_record(const std::string& records_root, const std::string& slug, const TaskRecord& record) {
  json modules = json::object(), sets = json::object(), runs = json::array(), timings = json::array();
  for (const auto& [label, stamp] : record.modules) modules[label] = to_json(stamp);
  for (const auto& [set, e] : record.sets) {
    sets[set] = {{"inputs", e.inputs}, {"truth", e.truth}, {"bytes", json_number(e.bytes)}};
    if (e.checks.empty()) continue;
    json checks = json::object();
    for (const auto& [name, error] : e.checks) checks[name] = json_number(error);
    sets[set]["checks"] = checks;
  }
  for (const RunResult& r : record.results) runs.push_back(run_line(r, record));
  for (const TimingResult& t : record.timing) {
    json line = to_json(t);
    for (const char* key : {"schema", "task", "module"}) line.erase(key);
    timings.push_back(line);
  }
  const json j = {{"schema", kResultSchema},
                  {"task", record.task},
                  {"device", record.device},
                  {"driver", record.driver},
                  {"toolkit", record.toolkit},
                  {"date", record.date},
                  {"case_sources", record.case_sources},
                  {"baseline_sources", record.baseline_sources},
                  {"modules", modules},
                  {"sets", sets},
                  {"runs", runs},
                  {"timings", timings}};
  write_file(record_path(records_root, slug, record.task), with_lines(j));
}

std::optional<HarnessRecord> load_harness_record(const std::string& records_root, const std::string& slug) {
  const std::string path = record_path(records_root, slug, kHarness);
  if (!fs::exists(path)) return std::nullopt;
  const std::string where = fmt::format("record '{}'", path);
  const json j = parse_json_file(path);
  require_schema(j, where);
  HarnessRecord record{json_text(j, "device", where),  json_text(j, "driver", where),
                       json_text(j, "toolkit", where), json_text(j, "date", where),
                       json_text(j, "sources", where), {}};
  for (const auto& [test, state] : json_member(j, "tests", where).items()) {
    if (!state.is_string())
      throw Error(ExitCode::bad_input, fmt::format("{}: state of '{}' is not a string", where, test));
    record.tests[test] = state.get<std::string>();
  }
  return record;
}

void write_harness_record(const std::string& records_root, const std::string& slug, const HarnessRecord& r) {
  const json j = {{"schema", kResultSchema}, {"device", r.device}, {"driver", r.driver},
                  {"toolkit", r.toolkit},    {"date", r.date},     {"sources", r.sources},
                  {"tests", r.tests}};
  write_file(record_path(records_root, slug, kHarness), with_lines(j));
}

ResultSet load_records(const std::string& records_root, const std::string& slug) {
  ResultSet found;
  const fs::path folder = fs::path(records_root) / slug;
  std::error_code ec;
  if (slug.empty() || !fs::is_directory(folder, ec)) return found;
  std::vector<std::string> tasks;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() == ".json" && entry.path().stem() != kHarness)
      tasks.push_back(entry.path().stem().string());
  }
  std::sort(tasks.begin(), tasks.end());
  for (const std::string& task : tasks) {
    try {
      std::optional<TaskRecord> record = load_record(records_root, slug, task);
      for (RunResult& r : record->results) {
        r.origin = "record " + slug;
        found.runs.push_back(std::move(r));
      }
      for (TimingResult& t : record->timing) {
        t.origin = "record " + slug;
        found.timings.push_back(std::move(t));
      }
    } catch (const std::exception& e) {
      found.unreadable.push_back(printable(e.what()));
    }
  }
  return found;
}

std::vector<HistoryEntry> load_history(const std::string& history_root, const std::string& slug,
                                       const std::string& task) {
  require_plain_name(slug, "GPU");
  const std::string path = fmt::format("{}/{}/{}.csv", history_root, slug, task);
  std::vector<HistoryEntry> entries;
  if (!fs::exists(path)) return entries;
  std::istringstream in(read_file(path));
  std::string line;
  std::getline(in, line);
  if (line != kHistoryHead)
    throw Error(ExitCode::bad_input, fmt::format("'{}': its first line is not '{}'", path, kHistoryHead));
  for (int n = 2; std::getline(in, line); ++n) {
    if (line.empty()) continue;
    const std::vector<std::string> c = split_csv(line);
    const auto number = [&](std::size_t i) {
      char* end = nullptr;
      const double v = std::strtod(c[i].c_str(), &end);
      if (c[i].empty() || *end != '\0' || !(std::isfinite(v) && v >= 0))
        throw Error(ExitCode::bad_input,
                    fmt::format("'{}' line {}: '{}' is not a number", path, n, printable(c[i])));
      return v;
    };
    if (c.size() != 11 || (c[9] != "yes" && c[9] != "no"))
      throw Error(ExitCode::bad_input,
                  fmt::format("'{}' line {}: not eleven columns with yes or no in the tenth", path, n));
    entries.push_back({c[0], c[1], c[2], c[8], number(3), number(4), number(5), number(6), number(7),
                       c[9] == "yes", c[10]});
  }
  return entries;
}

void append_history(const std::string& history_root, const std::string& slug, const std::string& task,
                    const std::vector<HistoryEntry>& entries) {
  require_plain_name(slug, "GPU");
  require_plain_name(task, "task");
  const std::string path = fmt::format("{}/{}/{}.csv", history_root, slug, task);
  std::string text = fs::exists(path) ? read_file(path) : std::string(kHistoryHead) + "\n";
  for (const HistoryEntry& e : entries) {
    text += fmt::format("{},{},{},{:.5g},{:.5g},{:.5g},{:.5g},{:.3g},{},{},{}\n", e.date, e.label, e.set,
                        e.median_ms, e.min_ms, e.floor_ms, e.multiple, e.spread, e.sources,
                        e.accepted ? "yes" : "no", csv_cell(printable(e.reason)));
  }
  write_file(path, text);
}

const HistoryEntry* best_accepted(const std::vector<HistoryEntry>& entries, const std::string& label,
                                  const std::string& set) {
  const HistoryEntry* best = nullptr;
  for (const HistoryEntry& e : entries) {
    if (e.label != label || e.set != set || !e.accepted) continue;
    if (best == nullptr || !e.reason.empty() || e.multiple < best->multiple) best = &e;
  }
  return best;
}

}  // namespace gpuphys
