// gpuphys tolerance: what another tolerance would let through, and what it would refuse.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>

#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/driver/table.hpp"
#include "core/report/analysis.hpp"

namespace gpuphys {
namespace {

void print_runs(const std::string& title, const std::vector<WhatIf::Run>& runs, const char* change) {
  fmt::print("{}: {}\n", title, runs.empty() ? "none" : std::to_string(runs.size()));
  for (const WhatIf::Run& r : runs) {
    fmt::print("    {} {} {}: error {}{}\n", r.lane, r.label, r.set, short_number(r.error),
               r.changes ? change : "");
  }
}

void print_windows(const ResultSet& results, const std::vector<const Task*>& tasks) {
  Table table(
      {"task", "check", ">tolerance", ">largest correct", "of", ">smallest mutant", "of", ">separation"});
  for (const Task* task : tasks) {
    for (const CheckWindow& w : windows(results, task->name)) {
      const auto who = [](const Extreme& e) {
        return e.exists() ? fmt::format("{} {} ({})", e.label, e.set, e.lane) : "-";
      };
      table.add({w.task, w.check, short_number(w.tolerance), short_number(w.correct.ratio), who(w.correct),
                 short_number(w.mutant.ratio), who(w.mutant), short_number(w.separation())});
    }
  }
  if (table.empty())
    throw Error(ExitCode::bad_input, "there are no results and no records: run something first");
  fmt::print("{}\nRatios are error over tolerance. A mutant counts for the check that sees it best.\n",
             table.text());
}

}  // namespace

void add_tolerance_command(CLI::App& app, Context& ctx) {
  struct Options {
    std::string task, check, gpu;
    double value = std::nan("");
  };
  auto o = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("tolerance",
                                         "Tolerance windows; or for a proposed tolerance: which correct "
                                         "variants would fail, which mutants escape");
  command->add_option("--task", o->task, "Task (default: all)");
  command->add_option("--check", o->check, "Check, as `gpuphys list --task T` names it");
  command->add_option("--value", o->value, "Proposed tolerance")->check(CLI::NonNegativeNumber);
  command->add_option("--gpu", o->gpu, kGpuHelp);
  command->footer(
      "Works on the results of this machine, with the committed records where a run was not repeated here. "
      "Nothing is run.\n"
      "Exit code 3 when the proposed tolerance would fail a correct variant or let a mutant escape.\n\n"
      "Examples:\n"
      "  gpuphys tolerance\n"
      "  gpuphys tolerance --task advect_rk2 --check ux_rel_l2 --value 1e-5\n");
  command->callback([o, &ctx] {
    const std::vector<const Task*> all = [&] {
      std::vector<const Task*> tasks;
      if (!o->task.empty()) return std::vector<const Task*>{&find_task(o->task)};
      for (const Task& t : all_tasks()) tasks.push_back(&t);
      return tasks;
    }();
    if (o->check.empty() != std::isnan(o->value))
      throw Error(ExitCode::usage, "--check and --value belong together");
    if (!o->check.empty() && o->task.empty()) throw Error(ExitCode::usage, "--check needs --task");
    const ResultSet results = gather_results(ctx, o->gpu);
    if (o->check.empty()) return print_windows(results, all);

    const WhatIf w = what_if(results, o->task, o->check, o->value);
    fmt::print("{} {}: tolerance {:g} today, {:g} proposed\n", w.task, w.check, w.current, w.proposed);
    print_runs(fmt::format("correct variants that would fail (of {} runs)", w.correct_total), w.failing,
               "  <- passes today");
    print_runs(fmt::format("mutants that would escape (of {} runs)", w.mutants_total), w.escaping,
               "  <- caught today");
    if (!w.unjudged.empty()) print_runs("runs that ended before they could be judged", w.unjudged, "");
    fmt::print("suggested: {} - {}\n", std::isnan(w.suggested) ? "none" : fmt::format("{:.2g}", w.suggested),
               w.reason);
    if (!w.failing.empty() || !w.escaping.empty()) ctx.exit_code = ExitCode::check_failed;
  });
}

}  // namespace gpuphys
