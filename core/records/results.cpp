#include "core/records/results.hpp"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <random>
#include <set>
#include <tuple>

#include "core/base/files.hpp"
#include "core/base/text.hpp"
#include "core/records/labels.hpp"
#include "core/records/results_json.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::pair<RunState, const char*> kStates[] = {
    {RunState::pass, "PASS"},       {RunState::fail, "FAIL"},         {RunState::fault, "FAULT"},
    {RunState::killed, "KILLED"},   {RunState::survived, "SURVIVED"}, {RunState::crashed, "CRASHED"},
    {RunState::timeout, "TIMEOUT"}, {RunState::error, "ERROR"},       {RunState::skipped, "SKIPPED"},
    {RunState::running, "RUNNING"},
};

[[noreturn]] void bad(const std::string& where, const std::string& what) {
  throw Error(ExitCode::bad_input, fmt::format("{}: {}", where, what));
}

const json& member(const json& j, const char* key, const std::string& where) {
  if (!j.is_object()) bad(where, "expected a JSON object");
  const auto it = j.find(key);
  if (it == j.end()) bad(where, fmt::format("key '{}' is missing", key));
  return *it;
}

std::string text(const json& j, const char* key, const std::string& where) {
  const json& v = member(j, key, where);
  if (!v.is_string()) bad(where, fmt::format("key '{}' is not a string", key));
  return v.get<std::string>();
}

std::string text_or_empty(const json& j, const char* key, const std::string& where) {
  return j.contains(key) ? text(j, key, where) : "";
}

double number(const json& j, const char* key, const std::string& where) {
  return number_from(member(j, key, where), fmt::format("{}: key '{}'", where, key));
}

bool boolean(const json& j, const char* key, const std::string& where) {
  const json& v = member(j, key, where);
  if (!v.is_boolean()) bad(where, fmt::format("key '{}' is not true or false", key));
  return v.get<bool>();
}

const json& list(const json& j, const char* key, const std::string& where) {
  const json& v = member(j, key, where);
  if (!v.is_array()) bad(where, fmt::format("key '{}' is not a list", key));
  return v;
}

json numbers(const std::map<std::string, double>& map) {
  json j = json::object();
  for (const auto& [key, value] : map) j[key] = json_number(value);
  return j;
}

std::map<std::string, double> numbers_from(const json& j, const char* key, const std::string& where) {
  std::map<std::string, double> map;
  if (!j.contains(key)) return map;
  const json& v = member(j, key, where);
  if (!v.is_object()) bad(where, fmt::format("key '{}' is not a JSON object", key));
  for (const auto& [name, value] : v.items())
    map[name] = number_from(value, fmt::format("{}: '{}'", where, name));
  return map;
}

json parse(const std::string& path) {
  const std::string content = read_file(path);
  try {
    return json::parse(content);
  } catch (const json::parse_error& e) {
    bad(fmt::format("'{}'", printable(path)), fmt::format("not valid JSON (byte {})", e.byte));
  } catch (const json::exception& e) {  // a number that no double holds
    bad(fmt::format("'{}'", printable(path)), fmt::format("not usable JSON ({})", printable(e.what())));
  }
}

void require_folder_name(const std::string& name, const char* what) {
  if (name.empty() || name == "." || name == ".." || name.find('/') != std::string::npos ||
      name.find('\0') != std::string::npos || name.size() > 200 || printable(name, 300) != name) {
    throw Error(ExitCode::usage,
                fmt::format("{} '{}' cannot be the name of a folder", what, printable(name)));
  }
}

void sort_results(ResultSet& set) {
  std::stable_sort(set.runs.begin(), set.runs.end(), [](const RunResult& a, const RunResult& b) {
    return std::tie(a.task, a.lane, a.label, a.set) < std::tie(b.task, b.lane, b.label, b.set);
  });
  std::stable_sort(set.timings.begin(), set.timings.end(), [](const TimingResult& a, const TimingResult& b) {
    return std::tie(a.task, a.label, a.set) < std::tie(b.task, b.label, b.set);
  });
}

}  // namespace

void require_schema(const json& j, const std::string& where) {
  const json& v = member(j, "schema", where);
  if (!v.is_number_integer() || v.get<int>() != kResultSchema) {
    bad(where,
        fmt::format("schema {} is not supported (this suite reads schema {})", v.dump(), kResultSchema));
  }
}

std::string to_string(RunState state) {
  for (const auto& [value, name] : kStates) {
    if (value == state) return name;
  }
  return "UNKNOWN";
}

RunState run_state_from(const std::string& text) {
  for (const auto& [value, name] : kStates) {
    if (name == text) return value;
  }
  throw Error(ExitCode::bad_input, fmt::format("unknown state '{}'", text));
}

double ratio_of(double error, double tolerance) {
  if (std::isnan(error) || std::isnan(tolerance)) return std::numeric_limits<double>::quiet_NaN();
  if (tolerance == 0) return error == 0 ? 0.0 : std::numeric_limits<double>::infinity();
  return error / tolerance;
}

const CheckResult* RunResult::worst_check() const {
  const CheckResult* worst = nullptr;
  for (const CheckResult& c : checks) {
    if (std::isnan(c.ratio)) return &c;
    if (worst == nullptr || c.ratio > worst->ratio) worst = &c;
  }
  return worst;
}

double RunResult::worst_truth_gap() const {
  double worst = std::numeric_limits<double>::quiet_NaN();
  for (const auto& [array, gap] : truth_gap) {
    if (std::isnan(gap)) return std::numeric_limits<double>::infinity();
    if (!(worst >= gap)) worst = gap;
  }
  return worst;
}

json json_number(double value) {
  if (std::isnan(value)) return "nan";
  if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
  return value;
}

double number_from(const json& j, const std::string& where) {
  if (j.is_number()) return j.get<double>();
  if (j.is_string()) {
    const std::string s = j.get<std::string>();
    if (s == "nan") return std::numeric_limits<double>::quiet_NaN();
    if (s == "inf") return std::numeric_limits<double>::infinity();
    if (s == "-inf") return -std::numeric_limits<double>::infinity();
  }
  bad(where, fmt::format("{} is not a number", j.dump()));
}

json to_json(const ModuleStamp& m) {
  return {{"sources", m.sources}, {"flags", m.flags}, {"compiler", m.compiler}};
}

ModuleStamp stamp_from(const json& j, const std::string& where) {
  return {text(j, "sources", where), text(j, "flags", where), text(j, "compiler", where)};
}

json to_json(const RunResult& r) {
  json checks = json::array();
  for (const CheckResult& c : r.checks) {
    checks.push_back({{"name", c.name},
                      {"error", json_number(c.error)},
                      {"tolerance", json_number(c.tolerance)},
                      {"detail", printable(c.detail)}});
  }
  json faults = json::array();
  for (const FaultResult& f : r.faults)
    faults.push_back({{"fault", f.fault}, {"detail", printable(f.detail)}});
  json j = {{"schema", kResultSchema},
            {"task", r.task},
            {"label", r.label},
            {"set", r.set},
            {"run", r.run},
            {"state", to_string(r.state)},
            {"state_detail", printable(r.state_detail)},
            {"checks", checks},
            {"faults", faults},
            {"truth_gap", numbers(r.truth_gap)},
            {"truth_source", r.truth_source},
            {"milliseconds", json_number(r.milliseconds)},
            {"device", r.device},
            {"started", r.started},
            {"inputs", r.inputs},
            {"truth", r.truth},
            {"bytes", json_number(r.bytes)}};
  if (r.module.known()) j["module"] = to_json(r.module);
  if (!r.confinement.empty()) j["confinement"] = r.confinement;
  if (r.is_knob_sweep()) j["scalar_overrides"] = numbers(r.scalar_overrides);
  return j;
}

RunResult run_result_from(const json& j, const std::string& where) {
  require_schema(j, where);
  RunResult r;
  r.task = text(j, "task", where);
  r.label = text(j, "label", where);
  r.lane = lane_of(r.label);
  r.role = role_of(r.label);
  r.set = text(j, "set", where);
  r.run = text_or_empty(j, "run", where);
  try {
    r.state = run_state_from(text(j, "state", where));
  } catch (const Error& e) {
    bad(where, e.what());
  }
  r.state_detail = text_or_empty(j, "state_detail", where);
  for (const json& c : list(j, "checks", where)) {
    CheckResult check;
    check.name = text(c, "name", where);
    const std::string here = fmt::format("{}: check '{}'", where, check.name);
    check.error = number(c, "error", here);
    check.tolerance = number(c, "tolerance", here);
    check.ratio = ratio_of(check.error, check.tolerance);
    check.pass = std::isfinite(check.error) && check.error <= check.tolerance;
    check.detail = text_or_empty(c, "detail", here);
    r.checks.push_back(std::move(check));
  }
  for (const json& f : list(j, "faults", where)) {
    r.faults.push_back({text(f, "fault", where), text_or_empty(f, "detail", where)});
  }
  r.truth_gap = numbers_from(j, "truth_gap", where);
  r.truth_source = text_or_empty(j, "truth_source", where);
  r.milliseconds = number(j, "milliseconds", where);
  r.scalar_overrides = numbers_from(j, "scalar_overrides", where);
  r.device = text_or_empty(j, "device", where);
  r.started = text_or_empty(j, "started", where);
  r.confinement = text_or_empty(j, "confinement", where);
  if (j.contains("module")) r.module = stamp_from(member(j, "module", where), where);
  r.inputs = text_or_empty(j, "inputs", where);
  r.truth = text_or_empty(j, "truth", where);
  r.bytes = j.contains("bytes") ? number(j, "bytes", where) : 0;
  return r;
}

json to_json(const TimingResult& t) {
  json times = json::array();
  for (const double ms : t.times_ms) times.push_back(json_number(ms));
  json j = {{"schema", kResultSchema},
            {"task", t.task},
            {"label", t.label},
            {"set", t.set},
            {"run", t.run},
            {"fresh_processes", t.fresh_processes},
            {"times_ms", times},
            {"min_ms", json_number(t.min_ms)},
            {"median_ms", json_number(t.median_ms)},
            {"spread", json_number(t.spread)},
            {"compulsory_bytes", json_number(t.compulsory_bytes)},
            {"floor_ms", json_number(t.floor_ms)},
            {"multiple", json_number(t.multiple)},
            {"target_multiple", json_number(t.target_multiple)},
            {"ceilings", numbers(t.ceilings)},
            {"device", t.device},
            {"driver", t.driver},
            {"toolkit", t.toolkit},
            {"gate",
             {{"state", t.gate.state},
              {"baseline_multiple", json_number(t.gate.baseline_multiple)},
              {"limit", json_number(t.gate.limit)}}}};
  if (t.module.known()) j["module"] = to_json(t.module);
  if (!t.scalar_overrides.empty()) j["scalar_overrides"] = numbers(t.scalar_overrides);
  return j;
}

TimingResult timing_result_from(const json& j, const std::string& where) {
  require_schema(j, where);
  TimingResult t;
  t.task = text(j, "task", where);
  t.label = text(j, "label", where);
  t.set = text(j, "set", where);
  t.run = text_or_empty(j, "run", where);
  t.fresh_processes = j.contains("fresh_processes") && boolean(j, "fresh_processes", where);
  if (j.contains("module")) t.module = stamp_from(member(j, "module", where), where);
  for (const json& ms : list(j, "times_ms", where)) t.times_ms.push_back(number_from(ms, where));
  t.min_ms = number(j, "min_ms", where);
  t.median_ms = number(j, "median_ms", where);
  t.spread = number(j, "spread", where);
  t.compulsory_bytes = number(j, "compulsory_bytes", where);
  t.floor_ms = number(j, "floor_ms", where);
  t.multiple = number(j, "multiple", where);
  t.target_multiple = number(j, "target_multiple", where);
  t.ceilings = numbers_from(j, "ceilings", where);
  t.scalar_overrides = numbers_from(j, "scalar_overrides", where);
  t.device = text_or_empty(j, "device", where);
  t.driver = text_or_empty(j, "driver", where);
  t.toolkit = text_or_empty(j, "toolkit", where);
  const json& gate = member(j, "gate", where);
  t.gate.state = text(gate, "state", where);
  t.gate.baseline_multiple = number(gate, "baseline_multiple", where);
  t.gate.limit = number(gate, "limit", where);
  return t;
}

std::string result_path(const std::string& root, const RunResult& r) {
  require_folder_name(r.task, "task");
  require_folder_name(r.label, "label");
  require_folder_name(r.set, "input set");
  return (fs::path(root) / r.task / lane_of(r.label) / r.label / (r.set + ".json")).string();
}

std::string result_path(const std::string& root, const TimingResult& t) {
  require_folder_name(t.task, "task");
  require_folder_name(t.label, "label");
  require_folder_name(t.set, "input set");
  return (fs::path(root) / t.task / "gpu" / t.label / ("time." + t.set + ".json")).string();
}

void write_result(const std::string& root, const RunResult& r) {
  write_file(result_path(root, r), to_json(r).dump() + "\n");
}

void write_result(const std::string& root, const TimingResult& t) {
  write_file(result_path(root, t), to_json(t).dump() + "\n");
}

const RunResult* ResultSet::find_run(const std::string& task, const std::string& lane,
                                     const std::string& label, const std::string& set) const {
  for (const RunResult& r : runs) {
    if (r.task == task && r.lane == lane && r.label == label && r.set == set) return &r;
  }
  return nullptr;
}

const TimingResult* ResultSet::find_timing(const std::string& task, const std::string& label,
                                           const std::string& set) const {
  for (const TimingResult& t : timings) {
    if (t.task == task && t.label == label && t.set == set) return &t;
  }
  return nullptr;
}

ResultSet load_results(const std::string& root, const std::string& task) {
  ResultSet found;
  const fs::path top = task.empty() ? fs::path(root) : fs::path(root) / task;
  std::error_code ec;
  if (!fs::is_directory(top, ec)) return found;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(top)) {
    if (!entry.is_regular_file() || entry.path().extension() != ".json") continue;
    const std::string path = entry.path().string();
    try {
      const json j = parse(path);
      const std::string where = fmt::format("'{}'", path);
      // The path is what the tests address, the content is what is counted: they must name the same run.
      if (entry.path().filename().string().starts_with("time.")) {
        TimingResult t = timing_result_from(j, where);
        if (!fs::equivalent(result_path(root, t), entry.path(), ec))
          bad(where, "its content names another run");
        found.timings.push_back(std::move(t));
      } else {
        RunResult r = run_result_from(j, where);
        if (!fs::equivalent(result_path(root, r), entry.path(), ec))
          bad(where, "its content names another run");
        found.runs.push_back(std::move(r));
      }
    } catch (const std::exception& e) {  // one bad file stops nothing else
      found.unreadable.push_back(printable(e.what()));
    }
  }
  std::sort(found.unreadable.begin(), found.unreadable.end());
  sort_results(found);
  return found;
}

std::string gpu_slug(const std::string& device) {
  std::string slug;
  for (const char c : device) {
    if (std::isalnum(static_cast<unsigned char>(c))) {
      slug += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    } else if (!slug.empty() && slug.back() != '-') {
      slug += '-';
    }
  }
  while (!slug.empty() && slug.back() == '-') slug.pop_back();
  return slug;
}

ResultSet merge_results(ResultSet live, ResultSet recorded) {
  std::set<std::tuple<std::string, std::string, std::string, std::string>> runs;
  std::set<std::tuple<std::string, std::string, std::string>> timings;
  for (const RunResult& r : live.runs) runs.emplace(r.task, r.lane, r.label, r.set);
  for (const TimingResult& t : live.timings) timings.emplace(t.task, t.label, t.set);
  const std::size_t skipped = std::erase_if(live.runs, [&](const RunResult& r) {
    return r.state == RunState::skipped && recorded.find_run(r.task, r.lane, r.label, r.set) != nullptr &&
           runs.erase({r.task, r.lane, r.label, r.set}) > 0;
  });
  if (skipped > 0)
    live.notes.push_back(fmt::format("{} runs were skipped here; their records are shown instead", skipped));
  for (RunResult& r : recorded.runs) {
    if (!runs.contains({r.task, r.lane, r.label, r.set})) live.runs.push_back(std::move(r));
  }
  for (TimingResult& t : recorded.timings) {
    if (!timings.contains({t.task, t.label, t.set})) live.timings.push_back(std::move(t));
  }
  live.notes.insert(live.notes.end(), recorded.notes.begin(), recorded.notes.end());
  live.unreadable.insert(live.unreadable.end(), recorded.unreadable.begin(), recorded.unreadable.end());
  sort_results(live);
  return live;
}

std::string utc_now() {
  const std::time_t now = std::chrono::system_clock::to_time_t(std::chrono::system_clock::now());
  return fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(now));
}

std::string new_run_id() {
  std::random_device random;
  return fmt::format("{:08x}{:08x}", random(), random());
}

json parse_json_file(const std::string& path) {
  return parse(path);
}
const json& json_member(const json& j, const char* key, const std::string& where) {
  return member(j, key, where);
}
std::string json_text(const json& j, const char* key, const std::string& where) {
  return text(j, key, where);
}
std::string json_text_or_empty(const json& j, const char* key, const std::string& where) {
  return text_or_empty(j, key, where);
}
const json& json_list(const json& j, const char* key, const std::string& where) {
  return list(j, key, where);
}

}  // namespace gpuphys
