// gpuphys record and check-records: what a GPU run leaves in the repository, and whether it still holds.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/results.hpp"
#include "core/source_digest.hpp"

namespace gpuphys {
namespace {

struct RecordOptions {
  std::vector<std::string> tasks;
  std::string output;
  bool incomplete = false, accept_slower = false;
};

void record(Context& ctx, const RecordOptions& o) {
  const std::string root = o.output.empty() ? ctx.records_root() : o.output;
  const ResultSet live = load_results(ctx.results_root);
  if (!live.unreadable.empty()) throw Error(ExitCode::bad_input, live.unreadable.front());
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
    const SourceDigest digest =
        digest_sources(ctx.source_root, record_roots(ctx.source_root, task->family, task->name));
    TaskRecord fresh = compose_record(*task, live, digest, std::nullopt);
    const std::string slug = gpu_slug(fresh.device);
    fresh = compose_record(*task, live, digest, load_record(root, slug, task->name));
    for (TimingResult& t : fresh.timing) {
      if (o.accept_slower && t.gate.state == "SLOW") t.gate.state = "ACCEPTED";
    }
    const std::vector<Issue> issues = record_issues(fresh, *task, ctx.source_root);
    for (const std::string& line : issue_lines(issues)) fmt::print("  {}\n", line);
    if (!issues.empty() && !o.incomplete) {
      fmt::print("{}: not recorded, {} things are not as they should be\n", task->name, issues.size());
      ctx.exit_code = ExitCode::check_failed;
      continue;
    }
    write_record(root, slug, fresh);
    fmt::print("{}: {} runs and {} timings recorded, sources {:.12}\n", record_path(root, slug, task->name),
               fresh.results.size(), fresh.timing.size(), fresh.digest.total);
  }
}

struct CheckOptions {
  std::vector<std::string> tasks;
  std::string gpu;
};

void check_records(Context& ctx, const CheckOptions& o) {
  std::vector<std::string> gpus = recorded_gpus(ctx.records_root());
  if (!o.gpu.empty()) gpus = {o.gpu};
  if (gpus.empty()) {
    throw Error(ExitCode::stale_record,
                fmt::format("there are no GPU records under '{}'", ctx.records_root()));
  }
  std::size_t stale = 0;
  for (const Task* task : select_tasks(o.tasks)) {
    bool found = false;
    for (const std::string& gpu : gpus) {
      const std::optional<TaskRecord> record = load_record(ctx.records_root(), gpu, task->name);
      if (!record) continue;
      found = true;
      const std::vector<Issue> issues = record_issues(*record, *task, ctx.source_root);
      for (const std::string& line : issue_lines(issues)) fmt::print("{}\n", line);
      if (!issues.empty()) ++stale;
      if (issues.empty()) {
        fmt::print("{}: record of {} ({}) is complete and matches its sources\n", task->name, gpu,
                   record->date);
      }
    }
    if (!found) {
      fmt::print("MISSING {}: no GPU record\n", task->name);
      ++stale;
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
  command->add_flag("--accept-slower", o->accept_slower,
                    "Take times that the gate calls SLOW as the new baseline; the record says so");
  command->add_flag("--incomplete", o->incomplete,
                    "Write a record although something is missing or wrong; it will not pass "
                    "check-records");
  command->footer(
      "A record holds every GPU run and timing of a task with a digest of all sources that they depend on. "
      "Runs that were\n"
      "not repeated are kept from the existing record if its sources and GPU are the same. Exit code 3 when "
      "a record was\n"
      "refused.\n\n"
      "Examples:\n"
      "  gpuphys record\n"
      "  gpuphys record --task advect_rk2 --output /tmp/records\n"
      "  gpuphys record --task advect_rk2 --accept-slower\n");
  command->callback([o, &ctx] { record(ctx, *o); });
}

void add_check_records_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<CheckOptions>();
  CLI::App* command = app.add_subcommand("check-records",
                                         "Check that GPU records are complete, within bounds and no older "
                                         "than their sources");
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--gpu", o->gpu, "Only records of this GPU, e.g. nvidia-h200");
  command->footer(
      "Needs no GPU. Comments and white space do not make a record old. Exit code 13 when a record is not "
      "good.\n\n"
      "Examples:\n"
      "  gpuphys check-records\n"
      "  gpuphys check-records --task poisson_neumann\n");
  command->callback([o, &ctx] { check_records(ctx, *o); });
}

}  // namespace gpuphys
