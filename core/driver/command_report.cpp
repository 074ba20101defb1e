// gpuphys report: everything the results say as one JSON file, and the static page made of it.
#include <fmt/format.h>
#include <spawn.h>
#include <sys/wait.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "core/base/files.hpp"
#include "core/base/progress.hpp"
#include "core/base/version.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/records/results_json.hpp"
#include "core/report/analysis.hpp"

extern char** environ;

namespace gpuphys {
namespace {

using nlohmann::json;

struct ReportOptions {
  std::vector<std::string> tasks;
  std::string output = "report", gpu, python = "/usr/bin/python3";
  bool data_only = false;
};

json extreme_json(const Extreme& e) {
  return {{"ratio", json_number(e.ratio)},
          {"error", json_number(e.error)},
          {"label", e.label},
          {"lane", e.lane},
          {"set", e.set},
          {"check", e.check}};
}

// Time against distance to the FP64 truth, for whatever was timed alone on the GPU. The time of a judged call
// does not do: judging shares the GPU with other tests.
json speed_error(const ResultSet& results, const std::string& task) {
  json points = json::array();
  for (const RunResult& r : results.runs) {
    if (r.task != task || r.lane != "gpu" || r.is_mutant() || r.size != "paper" || r.set_kind == "hard")
      continue;
    const TimingResult* t = results.find_timing(task, r.label, r.set);
    if (t == nullptr) continue;
    points.push_back({{"label", r.label},
                      {"set", r.set},
                      {"role", r.role},
                      {"milliseconds", json_number(t->median_ms)},
                      {"truth_gap", json_number(r.worst_truth_gap())},
                      {"truth_source", r.truth_source},
                      {"state", to_string(r.state)},
                      {"overrides", r.scalar_overrides}});
  }
  return points;
}

// What goes in and out, as text: tasks of a family for which it is the same are variants of one computation.
std::string interface_text(const Contract& contract) {
  std::string text;
  for (const ArraySpec& a : contract.inputs) text += fmt::format("{} ({}), ", a.name, a.shape);
  for (const ScalarSpec& s : contract.scalars) text += fmt::format("{}, ", s.name);
  text += "->";
  for (const ArraySpec& a : contract.outputs) text += fmt::format(" {} ({}),", a.name, a.shape);
  return text;
}

json task_json(const Context& ctx, const ResultSet& results, const Task& task) {
  const Verdict v = full_verdict(ctx, results, task, {});
  json window_list = json::array(), kills = json::array(), hard = json::array(), timing = json::array(),
       issue_list = json::array();
  for (const CheckWindow& w : windows(results, task.name)) {
    json correct = json::array();  // every correct variant apart: the picture shows where each lies
    for (const RunResult& r : results.runs) {
      if (r.task != task.name || r.is_mutant() || r.role == "user" || r.is_knob_sweep()) continue;
      for (const CheckResult& c : r.checks) {
        if (c.name == w.check) {
          correct.push_back(
              {{"label", r.label}, {"lane", r.lane}, {"set", r.set}, {"ratio", json_number(c.ratio)}});
        }
      }
    }
    json mutants = json::array();
    for (const RunResult& r : results.runs) {
      if (r.task != task.name || !r.is_mutant()) continue;
      for (const CheckResult& c : r.checks) {
        if (c.name != w.check) continue;
        mutants.push_back({{"label", r.label},
                           {"lane", r.lane},
                           {"set", r.set},
                           {"ratio", json_number(c.ratio)},
                           {"state", to_string(r.state)}});
      }
    }
    window_list.push_back({{"check", w.check},
                           {"kind", w.kind},
                           {"quantity", w.quantity},
                           {"norm", w.norm},
                           {"tolerance", w.tolerance},
                           {"correct", extreme_json(w.correct)},
                           {"mutant", extreme_json(w.mutant)},
                           {"mutants_best", w.mutants_best},
                           {"mutants_killed", w.mutants_killed},
                           {"separation", json_number(w.separation())},
                           {"correct_runs", correct},
                           {"mutant_runs", mutants}});
  }
  for (const MutantRow& row : kill_matrix(results, task.name)) {
    json ratios = json::object();
    for (const auto& [check, ratio] : row.ratios) ratios[check] = json_number(ratio);
    kills.push_back({{"label", row.label},
                     {"lane", row.lane},
                     {"class", row.mutant_class},
                     {"expected_check", row.expected_check},
                     {"expected_check_saw_it", row.expected_check_saw_it},
                     {"sparse", row.sparse},
                     {"ratios", ratios},
                     {"states", row.states},
                     {"killed_everywhere", row.killed_everywhere},
                     {"weakest", extreme_json(row.weakest)}});
  }
  for (const HardCase& h : hard_cases(results, task.name)) {
    hard.push_back({{"set", h.set},
                    {"about", ""},
                    {"lane", h.lane},
                    {"label", h.label},
                    {"state", h.state},
                    {"detail", h.detail},
                    {"worst_ratio", json_number(h.worst_ratio)}});
    for (const InputSet& s : task.sets) {
      if (s.name == h.set) hard.back()["about"] = s.about;
    }
  }
  for (const TimingResult& t : results.timings) {
    if (t.task != task.name) continue;
    json j = to_json(t);
    j.erase("module");
    j["origin"] = t.origin;
    timing.push_back(j);
  }
  for (const std::string& line : issue_lines(v.issues)) issue_list.push_back(line);
  json knob = nullptr;
  if (task.knob) knob = task.knob->scalar;
  return {{"name", task.name},
          {"family", task.family},
          {"title", task.title},
          {"interface", interface_text(task.contract)},
          {"paper_number", task.paper_number},
          {"target_multiple", task.target_floor_multiple},
          {"knob", knob},
          {"verdict",
           {{"state", v.state},
            {"serial_fp32", extreme_json(v.serial_fp32)},
            {"reference", extreme_json(v.reference)},
            {"fmad", extreme_json(v.fmad)},
            {"truth_gap", json_number(v.truth_gap)},
            {"truth_gap_of", v.truth_gap_of},
            {"weakest_mutant", extreme_json(v.weakest_mutant)},
            {"mutants_killed", v.mutants_killed},
            {"mutants_total", v.mutants_total},
            {"separation", json_number(v.separation)},
            {"milliseconds", json_number(v.milliseconds)},
            {"multiple", json_number(v.multiple)},
            {"hard_passed", v.hard_passed},
            {"hard_total", v.hard_total}}},
          {"windows", window_list},
          {"kills", kills},
          {"hard", hard},
          {"timing", timing},
          {"speed_error", speed_error(results, task.name)},
          {"issues", issue_list}};
}

// Runs a program and waits for it. Throws Error(internal) when it cannot be started, Error(bad_input) when it
// fails.
void execute(std::vector<std::string> words) {
  std::vector<char*> argv;
  for (std::string& w : words) argv.push_back(w.data());
  argv.push_back(nullptr);
  pid_t child = 0;
  if (const int error = posix_spawnp(&child, argv[0], nullptr, nullptr, argv.data(), environ); error != 0) {
    throw Error(ExitCode::bad_input, fmt::format("cannot start '{}': {}", words[0], std::strerror(error)));
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    throw Error(ExitCode::bad_input,
                fmt::format("'{} {}' failed (the report needs python3-matplotlib and python3-jinja2)",
                            words[0], words[1]));
  }
}

void report(Context& ctx, const ReportOptions& o) {
  const ResultSet results = gather_results(ctx, o.gpu);
  const std::vector<const Task*> tasks = select_tasks(o.tasks);
  Progress progress("report", static_cast<std::int64_t>(tasks.size()));
  json data = {{"schema", kResultSchema}, {"suite_version", kSuiteVersion},   {"created", utc_now()},
               {"tasks", json::array()},  {"unreadable", results.unreadable}, {"notes", results.notes}};
  for (const Task* task : tasks) {
    data["tasks"].push_back(task_json(ctx, results, *task));
    progress.step(task->name);
  }
  const std::string file = (std::filesystem::path(o.output) / "report.json").string();
  write_file(file, data.dump(1) + "\n");
  if (!o.data_only)
    execute({o.python, ctx.source_root + "/core/report/report.py", file, "--output", o.output});
  fmt::print("{}\n", o.data_only ? file : (std::filesystem::path(o.output) / "index.html").string());
}

}  // namespace

void add_report_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<ReportOptions>();
  CLI::App* command =
      app.add_subcommand("report", "One static HTML page with figures, and the CSV behind them");
  command->add_option("--output", o->output, "Folder to write to")->capture_default_str();
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--gpu", o->gpu, kGpuHelp);
  command->add_option("--python", o->python, "Python with matplotlib and jinja2")->capture_default_str();
  command->add_flag("--data-only", o->data_only, "Write report.json only");
  command->footer(
      "Speed against error, tolerance windows, kill matrix, timing against floor, target and record, hard "
      "cases. Needs no\n"
      "GPU: the committed records supply what this machine cannot measure.\n\n"
      "Examples:\n"
      "  gpuphys report --output report\n"
      "  gpuphys report --task poisson_neumann --output /tmp/report\n");
  command->callback([o, &ctx] { report(ctx, *o); });
}

}  // namespace gpuphys
