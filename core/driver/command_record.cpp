// gpuphys record and check-records: what a GPU run leaves in the repository, and whether it still holds.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <regex>

#include "core/base/files.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/measure/timing.hpp"
#include "core/records/labels.hpp"

namespace gpuphys {
namespace {

struct RecordOptions {
  std::vector<std::string> tasks;
  std::string output, accept_slower, harness;
  bool incomplete = false;
};

// New timings of the record as lines of the history. What the gate calls SLOW becomes a baseline only with a
// reason.
void keep_history(const Context& ctx, const std::string& slug, TaskRecord& record,
                  const std::string& accept_slower) {
  const std::vector<HistoryEntry> known = load_history(ctx.history_root(), slug, record.task);
  std::vector<HistoryEntry> fresh;
  for (TimingResult& t : record.timing) {
    if (!t.scalar_overrides.empty()) continue;
    const bool slow = t.gate.state == "ACCEPTED";
    const bool there = std::any_of(known.begin(), known.end(), [&](const HistoryEntry& e) {
      return e.label == t.label && e.set == t.set && e.sources == t.module.sources.substr(0, 12) &&
             fmt::format("{:.5g}", e.median_ms) == fmt::format("{:.5g}", t.median_ms);
    });
    if (there) continue;
    const bool usable = t.gate.state == "OK" || t.gate.state == "UNBASELINED" || t.gate.state == "ACCEPTED";
    fresh.push_back({utc_now(), t.label, t.set, t.module.sources.substr(0, 12), t.median_ms, t.min_ms,
                     t.floor_ms, t.multiple, noise_spread(t.times_ms), usable, slow ? accept_slower : ""});
  }
  if (!fresh.empty()) append_history(ctx.history_root(), slug, record.task, fresh);
}

// States of the harness's own tests from CTest's JUnit file.
void record_harness(Context& ctx, const RecordOptions& o, const std::string& root) {
  const std::string xml = read_file(o.harness);
  HarnessRecord record;
  const std::regex test("<testcase name=\"([^\"]+)\"[^>]*status=\"([a-z]+)\"");
  for (std::sregex_iterator it(xml.begin(), xml.end(), test), end; it != end; ++it)
    record.tests[(*it)[1]] = (*it)[2] == "run" ? "passed" : (*it)[2].str();
  if (record.tests.empty()) throw Error(ExitCode::bad_input, fmt::format("'{}' holds no tests", o.harness));
  Runner runner(ctx.runner_options(60), "/dev/null");
  const GpuIdentity gpu = runner.identify();
  record.device = gpu.device;
  record.driver = gpu.driver;
  record.toolkit = gpu.toolkit;
  record.date = utc_now();
  record.sources = harness_sources(ctx);
  std::size_t bad = 0;
  for (const auto& [name, state] : record.tests) {
    if (state == "passed") continue;
    fmt::print("  {}: {}\n", name, state);
    ++bad;
  }
  if (bad > 0 && !o.incomplete) {
    fmt::print("harness: not recorded, {} tests did not pass\n", bad);
    ctx.exit_code = ExitCode::check_failed;
    return;
  }
  write_harness_record(root, gpu_slug(gpu.device), record);
  fmt::print("{}: {} tests recorded\n", record_path(root, gpu_slug(gpu.device), "harness"),
             record.tests.size());
}

void record(Context& ctx, const RecordOptions& o) {
  const std::string root = o.output.empty() ? ctx.records_root() : o.output;
  if (!o.harness.empty()) return record_harness(ctx, o, root);
  ResultSet live = load_results(ctx.results_root);
  annotate(live, ctx.mutants_root());
  for (const std::string& line : live.unreadable) fmt::print("  UNREADABLE {}\n", line);
  std::vector<const Task*> tasks = select_tasks(o.tasks);
  if (o.tasks.empty()) {
    std::erase_if(tasks, [&](const Task* t) {
      for (const RunResult& r : live.runs) {
        if (r.task == t->name && r.lane == "gpu" && r.state != RunState::skipped) return false;
      }
      return true;
    });
    if (tasks.empty())
      throw Error(ExitCode::bad_input, fmt::format("no GPU results under '{}'", ctx.results_root));
  }
  for (const Task* task : tasks) {
    try {
      std::vector<std::string> refused;
      TaskRecord fresh = compose_record(ctx, *task, live, std::nullopt, refused);
      const std::string slug = gpu_slug(fresh.device);
      refused.clear();
      fresh = compose_record(ctx, *task, live, load_record(root, slug, task->name), refused);
      for (const std::string& line : refused) fmt::print("  refused: {}\n", line);
      if (!o.accept_slower.empty()) {
        for (TimingResult& t : fresh.timing) {
          if (t.gate.state == "SLOW") t.gate.state = "ACCEPTED";
        }
      }
      const std::vector<Issue> issues = record_issues(ctx, fresh, *task);
      for (const std::string& line : issue_lines(issues)) fmt::print("  {}\n", line);
      if (!issues.empty() && !o.incomplete) {
        fmt::print("{}: not recorded, {} things are not as they should be\n", task->name, issues.size());
        ctx.exit_code = ExitCode::check_failed;
        continue;
      }
      if (o.output.empty()) keep_history(ctx, slug, fresh, o.accept_slower);
      write_record(root, slug, fresh);
      fmt::print("{}: {} runs and {} timings of {} modules recorded\n", record_path(root, slug, task->name),
                 fresh.results.size(), fresh.timing.size(), fresh.modules.size());
    } catch (const Error& e) {  // one task's trouble keeps no other from being recorded
      fmt::print("{}: not recorded: {}\n", task->name, e.what());
      ctx.exit_code = std::max(ctx.exit_code, e.code());
    }
  }
}

struct CheckOptions {
  std::vector<std::string> tasks;
  std::string gpu;
  bool harness = false, skip_missing = false;
};

std::size_t check_harness(const Context& ctx, const std::vector<std::string>& gpus) {
  std::size_t good = 0;
  for (const std::string& gpu : gpus) {
    const std::optional<HarnessRecord> record = load_harness_record(ctx.records_root(), gpu);
    if (!record) continue;
    const bool fresh = record->sources == harness_sources(ctx);
    bool passed = !record->tests.empty();
    for (const auto& [name, state] : record->tests) {
      if (state == "passed") continue;
      fmt::print("FAIL harness {}: {} {}\n", gpu, name, state);
      passed = false;
    }
    fmt::print("harness: record of {} ({}): {} tests, {}\n", gpu, record->date, record->tests.size(),
               fresh ? "matches its sources" : "its sources have changed since");
    good += fresh && passed;
  }
  if (good == 0) fmt::print("STALE harness: no GPU has a record of its own tests with the present sources\n");
  return good > 0 ? 0 : 1;
}

void check_records(Context& ctx, const CheckOptions& o) {
  std::vector<std::string> gpus = recorded_gpus(ctx.records_root());
  if (!o.gpu.empty()) gpus = {o.gpu};
  if (gpus.empty()) {
    throw Error(ExitCode::stale_record,
                fmt::format("there are no GPU records under '{}'", ctx.records_root()));
  }
  std::size_t stale = o.harness ? check_harness(ctx, gpus) : 0;
  if (o.harness && o.tasks.empty() && stale == 0) return;
  if (!(o.harness && o.tasks.empty())) {
    for (const Task* task : select_tasks(o.tasks)) {
      bool found = false, good = false;
      for (const std::string& gpu : gpus) {
        try {
          const std::optional<TaskRecord> record = load_record(ctx.records_root(), gpu, task->name);
          if (!record) continue;
          found = true;
          const std::vector<Issue> issues = record_issues(ctx, *record, *task);
          for (const std::string& line : issue_lines(issues)) fmt::print("{}\n", line);
          if (!issues.empty()) continue;
          good = true;
          fmt::print("{}: record of {} ({}) is complete and matches its sources\n", task->name, gpu,
                     record->date);
        } catch (const Error& e) {
          found = true;
          fmt::print("UNREADABLE {}: {}\n", task->name, e.what());
        }
      }
      if (!found) fmt::print("MISSING {}: no GPU record\n", task->name);
      if (!found && o.skip_missing)
        throw Error(ExitCode::skipped, fmt::format("{}: no GPU has a record of it yet", task->name));
      // One good record is enough: which GPU is at hand is chance.
      if (!good) ++stale;
    }
  }
  if (stale > 0) {
    throw Error(
        ExitCode::stale_record,
        fmt::format(
            "{} GPU records are missing, incomplete or older than their sources (run the GPU lane, then "
            "`gpuphys record`)",
            stale));
  }
}

}  // namespace

void add_record_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<RecordOptions>();
  CLI::App* command =
      app.add_subcommand("record", "Compose the GPU records of tasks from this machine's results");
  command->add_option("--task", o->tasks, "Task (repeatable; default: every task with GPU results)");
  command->add_option("--output", o->output, "Folder of records (default: ci/records of the repository)");
  command->add_option(
      "--accept-slower", o->accept_slower,
      "Take times that the gate calls SLOW as the new baseline, for this reason, which the history keeps");
  command->add_option("--harness", o->harness,
                      "Record the harness's own tests instead, from a JUnit file that ctest wrote");
  command->add_flag("--incomplete", o->incomplete,
                    "Write a record although something is missing or wrong; it will not pass "
                    "check-records");
  command->footer(
      "A record holds every GPU run and timing of a task with digests of the modules, inputs and truth that "
      "they are of.\n"
      "Results of other sources are refused; runs that were not repeated are kept from the existing record "
      "where all of that\n"
      "is the same. New timings are appended to ci/history. Exit code 3 when a record was refused.\n\n"
      "Examples:\n"
      "  gpuphys record\n"
      "  gpuphys record --task advect_rk2 --output /tmp/records\n"
      "  gpuphys record --task advect_rk2 --accept-slower \"safer bounds cost 6 %\"\n");
  command->callback([o, &ctx] { record(ctx, *o); });
}

void add_check_records_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<CheckOptions>();
  CLI::App* command = app.add_subcommand("check-records",
                                         "Check that GPU records are complete, within bounds and no older "
                                         "than their sources");
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--gpu", o->gpu, "Only records of this GPU, e.g. nvidia-h200");
  command->add_flag("--skip-missing", o->skip_missing,
                    "End with 77 for a task that no GPU has a record of yet (CTest: skipped, not passed)");
  command->add_flag("--harness", o->harness,
                    "The record of the harness's own tests (alone, or besides --task)");
  command->footer(
      "Needs no GPU. Comments and white space do not make a record old; inputs, truth and checks are "
      "computed "
      "again where\n"
      "the sources that make them have changed. Exit code 13 when a record is not good.\n\n"
      "Examples:\n"
      "  gpuphys check-records\n"
      "  gpuphys check-records --task poisson_neumann\n"
      "  gpuphys check-records --harness\n");
  command->callback([o, &ctx] { check_records(ctx, *o); });
}

}  // namespace gpuphys
