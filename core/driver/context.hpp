// What the driver's commands share: where things lie, and the exit code to end with.
#pragma once

#include <string>

#include "core/error.hpp"

namespace CLI {
class App;
}

namespace gpuphys {

struct Context {
  std::string source_root;            ///< the repository (mutants, records, report script)
  std::string modules_root;           ///< <build>/modules: one folder a task
  std::string results_root;           ///< where runs leave their results
  std::string truth_root;             ///< cache of FP64 truths
  ExitCode exit_code = ExitCode::ok;  ///< set by the command that ran

  std::string records_root() const { return source_root + "/ci/records"; }
  /// `name` is a path to a shared object, or the label of a module built with the suite ("reference", "fmad",
  /// "mutant.<fault>", "serial_mutant.<fault>", "baseline_f64", ...). Throws Error(unknown_name) listing what
  /// is built.
  std::string module_path(const std::string& task, const std::string& name) const;
};

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

}  // namespace gpuphys
