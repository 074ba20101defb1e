// gpuphys mutants: the kill matrix.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>

#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/driver/table.hpp"
#include "core/report/analysis.hpp"

namespace gpuphys {

void add_mutants_command(CLI::App& app, Context& ctx) {
  struct Options {
    std::vector<std::string> tasks;
    std::string gpu;
    bool csv = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("mutants", "Kill matrix: which check sees which planted fault, and by how much");
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--gpu", o->gpu, kGpuHelp);
  command->add_flag("--csv", o->csv, "Write CSV: one line for each mutant and check");
  command->footer(
      "Cells are error over tolerance, the largest over the input sets; above 1 the check saw the fault. "
      "`weakest` is the\n"
      "smallest over the input sets of a run's largest ratio. Exit code 3 when a mutant survived or was not "
      "run.\n\n"
      "Examples:\n"
      "  gpuphys mutants --task advect_rk2\n"
      "  gpuphys mutants --csv > kills.csv\n");
  command->callback([o, &ctx] {
    const ResultSet results = gather_results(ctx, o->gpu);
    Table csv({"task", "lane", "mutant", "class", "expected_check", "sparse", "check", "ratio",
               "killed_everywhere"});
    std::vector<std::string> trouble;
    for (const Task* task : select_tasks(o->tasks)) {
      const std::vector<MutantRow> rows = kill_matrix(results, task->name);
      std::vector<std::string> checks;
      for (const MutantRow& row : rows) {
        for (const auto& [check, ratio] : row.ratios) {
          if (std::find(checks.begin(), checks.end(), check) == checks.end()) checks.push_back(check);
        }
      }
      std::vector<std::string> titles = {"mutant", "lane", "class", "state"};
      for (const std::string& c : checks) titles.push_back(">" + c);
      titles.insert(titles.end(), {">weakest", "on", "expected check"});
      Table table(titles);
      for (const MutantRow& row : rows) {
        std::string state;
        for (const auto& [set, s] : row.states) {
          if (s == "KILLED") continue;
          state += (state.empty() ? "" : ", ") + s + " on " + set;
          trouble.push_back(fmt::format("{} {} {} {} {}", s, row.task, row.lane, row.label, set));
        }
        std::vector<std::string> cells = {row.label + (row.sparse ? " (sparse)" : ""), row.lane,
                                          row.mutant_class, state.empty() ? "KILLED" : state};
        for (const std::string& c : checks) {
          const auto it = row.ratios.find(c);
          cells.push_back(it == row.ratios.end() ? "-" : short_number(it->second));
          if (it != row.ratios.end()) {
            csv.add({row.task, row.lane, row.label, row.mutant_class, row.expected_check,
                     row.sparse ? "yes" : "no", c, exact_number(it->second),
                     row.killed_everywhere ? "yes" : "no"});
          }
        }
        cells.push_back(short_number(row.weakest.ratio));
        cells.push_back(row.weakest.exists() ? row.weakest.set : "-");
        cells.push_back(row.expected_check + (row.expected_check_saw_it ? "" : " (did not see it)"));
        table.add(cells);
      }
      std::vector<Issue> missing =
          missing_results(results, expectation_of(*task, ctx.source_root), {.cpu = true, .gpu = true});
      std::erase_if(missing, [](const Issue& i) { return i.label.find("mutant.") == std::string::npos; });
      for (const std::string& line : issue_lines(missing)) trouble.push_back(line);
      if (!o->csv)
        fmt::print("{}\n{}\n", task->name, table.empty() ? "  no mutant has been run\n" : table.text());
    }
    if (o->csv) fmt::print("{}", csv.csv());
    for (const std::string& line : results.unreadable) trouble.push_back("UNREADABLE " + line);
    for (const std::string& line : trouble) fmt::print(o->csv ? stderr : stdout, "{}\n", line);
    if (!trouble.empty()) ctx.exit_code = ExitCode::check_failed;
  });
}

}  // namespace gpuphys
