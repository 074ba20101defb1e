// gpuphys verdict: one line a task, and by name everything that is not as it should be.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/driver/table.hpp"
#include "core/report/analysis.hpp"

namespace gpuphys {
namespace {

struct VerdictOptions {
  std::vector<std::string> tasks;
  std::string gpu, lane = "all";
  bool csv = false;
};

std::string mutant_name(const Extreme& e) {
  return e.exists() ? fmt::format("{} {}", e.label, e.set) : "-";
}

Table text_table(const std::vector<Verdict>& verdicts) {
  Table table({"task", ">serial FP32", ">reference", ">fmad", ">truth gap", "weakest mutant", ">ratio",
               ">separation", ">killed", ">ms", ">x floor", ">target", ">hard", "state"});
  for (const Verdict& v : verdicts) {
    table.add({v.task, short_number(v.serial_fp32.ratio), short_number(v.reference.ratio),
               short_number(v.fmad.ratio), std::isnan(v.truth_gap) ? "-" : fmt::format("{:.1e}", v.truth_gap),
               mutant_name(v.weakest_mutant), short_number(v.weakest_mutant.ratio),
               short_number(v.separation), fmt::format("{}/{}", v.mutants_killed, v.mutants_total),
               short_number(v.milliseconds), short_number(v.multiple),
               v.target_multiple > 0 ? short_number(v.target_multiple) : "-",
               fmt::format("{}/{}", v.hard_passed, v.hard_total), v.state});
  }
  return table;
}

Table csv_table(const std::vector<Verdict>& verdicts) {
  Table table({"task",
               "state",
               "serial_fp32_ratio",
               "reference_ratio",
               "fmad_ratio",
               "truth_gap",
               "truth_gap_of",
               "weakest_mutant",
               "weakest_mutant_set",
               "weakest_mutant_check",
               "weakest_mutant_ratio",
               "separation",
               "mutants_killed",
               "mutants_total",
               "median_ms",
               "floor_multiple",
               "target_multiple",
               "hard_passed",
               "hard_total",
               "issues"});
  for (const Verdict& v : verdicts) {
    table.add({v.task,
               v.state,
               exact_number(v.serial_fp32.ratio),
               exact_number(v.reference.ratio),
               exact_number(v.fmad.ratio),
               exact_number(v.truth_gap),
               v.truth_gap_of,
               v.weakest_mutant.label,
               v.weakest_mutant.set,
               v.weakest_mutant.check,
               exact_number(v.weakest_mutant.ratio),
               exact_number(v.separation),
               std::to_string(v.mutants_killed),
               std::to_string(v.mutants_total),
               exact_number(v.milliseconds),
               exact_number(v.multiple),
               exact_number(v.target_multiple),
               std::to_string(v.hard_passed),
               std::to_string(v.hard_total),
               std::to_string(v.issues.size())});
  }
  return table;
}

void verdicts(Context& ctx, const VerdictOptions& o) {
  const Lanes lanes{.cpu = o.lane != "gpu", .gpu = o.lane != "cpu"};
  const ResultSet results = gather_results(ctx, o.gpu);
  std::vector<Verdict> all;
  std::map<std::string, int> states;
  std::map<std::string, std::vector<std::string>> recorded;  // tasks by GPU
  for (const Task* task : select_tasks(o.tasks)) {
    Verdict v = full_verdict(ctx, results, *task, lanes);
    if (const std::string slug = record_slug(results, task->name); lanes.gpu && !slug.empty())
      recorded[slug].push_back(task->name);
    ++states[v.state];
    all.push_back(std::move(v));
  }
  if (o.csv) {
    fmt::print("{}", csv_table(all).csv());
  } else {
    fmt::print("{}\n", text_table(all).text());
    fmt::print(
        "Ratios are the largest error over tolerance of any check and input set; a mutant's is that of the "
        "check that\n"
        "sees it best. Separation: smallest of a check's mutants over its largest correct variant. Hard: "
        "runs of hard\n"
        "cases passed. Times are medians of the reference on the public set.\n");
  }
  std::FILE* out = o.csv ? stderr : stdout;
  bool trouble = !results.unreadable.empty();
  for (const std::string& note : results.notes) fmt::print(out, "note: {}\n", note);
  for (const auto& [slug, tasks] : recorded) {
    fmt::print(out, "note: GPU numbers of {} tasks come from the records of {}{}\n", tasks.size(), slug,
               recorded.size() > 1 ? fmt::format(": {}", fmt::join(tasks, ", ")) : "");
  }
  for (const RunResult& r : results.runs) {
    if (r.role != "user") continue;
    fmt::print(out, "user module: {} {} {} {}: {}{}\n", r.task, r.lane, r.label, r.set, to_string(r.state),
               r.state_detail.empty() ? "" : " - " + r.state_detail);
  }
  std::vector<std::string> lines;
  for (const std::string& line : results.unreadable) lines.push_back("UNREADABLE " + line);
  for (const Verdict& v : all) {
    for (const std::string& line : issue_lines(v.issues)) lines.push_back(line);
    trouble = trouble || !v.issues.empty();
  }
  if (!lines.empty()) fmt::print(out, "\nNot as it should be:\n");
  for (const std::string& line : lines) fmt::print(out, "  {}\n", line);
  std::string total;
  for (const auto& [state, n] : states) total += fmt::format("{}{} {}", total.empty() ? "" : ", ", n, state);
  fmt::print(out, "\n{} tasks: {}\n", all.size(), total);
  if (trouble || all.empty()) ctx.exit_code = ExitCode::check_failed;
}

}  // namespace

void add_verdict_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<VerdictOptions>();
  CLI::App* command = app.add_subcommand(
      "verdict", "The verdict table: correctness, mutants, time and hard cases of each task");
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--lane", o->lane, "Which results are demanded")
      ->check(CLI::IsMember({"all", "cpu", "gpu"}))
      ->capture_default_str();
  command->add_option("--gpu", o->gpu, kGpuHelp);
  command->add_flag("--csv", o->csv, "Write the table as CSV (everything else goes to stderr)");
  command->footer(
      "Shows the results of this machine, with the committed GPU records where a run was not repeated here. "
      "Below the table,\n"
      "every survivor, failure, crash, skip, stale record and missing result is listed by name; exit code 3 "
      "if there is any.\n\n"
      "Examples:\n"
      "  gpuphys verdict\n"
      "  gpuphys verdict --lane cpu --task advect_rk2\n"
      "  gpuphys verdict --csv > verdict.csv\n");
  command->callback([o, &ctx] { verdicts(ctx, *o); });
}

}  // namespace gpuphys
