// What the driver's commands share: where things lie, and the exit code to end with.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "core/base/error.hpp"
#include "core/judge/prepare.hpp"
#include "core/records/results.hpp"

namespace CLI {
class App;
}

namespace gpuphys {

struct Context {
  std::string source_root;            ///< the repository (mutants, records, report script)
  std::string modules_root;           ///< <build>/modules: one folder a task
  std::string results_root;           ///< where runs leave their results
  std::string store_root;             ///< inputs and truths that memory has no room for
  std::string build_root;             ///< the build folder
  std::string runner;                 ///< path of gpuphys-runner
  ExitCode exit_code = ExitCode::ok;  ///< set by the command that ran

  std::string records_root() const { return source_root + "/ci/records"; }
  std::string history_root() const { return source_root + "/ci/history"; }
  std::string mutants_root() const { return source_root + "/mutants"; }
  /// Where inputs and truth are made; `baseline_timeout_s` is what the FP64 baseline may take.
  Workplace workplace(double baseline_timeout_s = 240) const;
  RunnerOptions runner_options(double timeout_s) const;
  /// What a module of the suite was built from; unknown for a user's, and where the file is not the one that
  /// was stamped.
  ModuleStamp stamp_of(const std::string& module_path) const;
  /// `name` is a path to a shared object, or the label of a module built with the suite ("reference", "fmad",
  /// "mutant.<fault>", "serial_mutant.<fault>", "baseline_f64", ...). Throws Error(unknown_name) listing what
  /// is built.
  std::string module_path(const std::string& task, const std::string& name) const;
};

/// NAME=NUMBER, repeatable. Throws Error(usage) for anything but a finite number with a decimal point.
std::map<std::string, double> parse_scalars(const std::vector<std::string>& assignments);

// Each command adds one subcommand to the application; its callback does the work and sets ctx.exit_code.
void add_list_command(CLI::App&, Context&);
void add_run_command(CLI::App&, Context&);
void add_check_command(CLI::App&, Context&);
void add_export_command(CLI::App&, Context&);
void add_tolerance_command(CLI::App&, Context&);
void add_mutants_command(CLI::App&, Context&);
void add_time_command(CLI::App&, Context&);
void add_verdict_command(CLI::App&, Context&);
void add_report_command(CLI::App&, Context&);
void add_record_command(CLI::App&, Context&);
void add_check_records_command(CLI::App&, Context&);
void add_trivial_command(CLI::App&, Context&);
void add_ctest_file_command(CLI::App&, Context&);
void add_prepare_command(CLI::App&, Context&);
void add_store_command(CLI::App&, Context&);
void add_modules_command(CLI::App&, Context&);

}  // namespace gpuphys
