// gpuphys check: outputs in an HDF5 file, judged like those of a module.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "core/base/host_info.hpp"
#include "core/base/text.hpp"
#include "core/contract/hdf5_io.hpp"
#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/judge/judge.hpp"
#include "core/records/results.hpp"

namespace gpuphys {
namespace {

struct CheckOptions {
  std::string task, set, outputs, inputs, label;
  double timeout_s = 600;
};

void check(Context& ctx, const CheckOptions& o) {
  const Task& task = find_task(o.task);
  if (o.set.empty() == o.inputs.empty()) {
    throw Error(ExitCode::usage, "name the inputs that the outputs belong to: either --set or --inputs");
  }
  // A user's own inputs are judged by the task's checks; invariants and known solutions belong to the suite's
  // sets.
  InputSet own;
  own.name = "custom";
  own.kind = SetKind::open;
  own.size = Size::smoke;
  const InputSet& set = o.set.empty() ? own : task.set(o.set);

  const FileInfo info = read_info(o.outputs);
  if (!o.set.empty() && !info.set.empty() && info.set != o.set) {
    throw Error(ExitCode::bad_input, fmt::format("'{}': it says that it belongs to input set '{}', not '{}'",
                                                 printable(o.outputs), printable(info.set), o.set));
  }
  if (!o.label.empty() && role_of(o.label) != "user")
    throw Error(ExitCode::usage,
                fmt::format("label '{}' belongs to a module of the suite: choose another", o.label));
  const Prepared inputs =
      o.set.empty() ? prepare_own(ctx.workplace(o.timeout_s), task, set, read_problem(o.inputs, task))
                    : prepare(ctx.workplace(), task, set, wants_truth(task, set));
  const Problem& problem = inputs.problem;
  CallReport report;
  report.outputs = read_arrays(o.outputs, task, problem);
  inspect_outputs(report);

  RunResult result;
  result.task = task.name;
  result.lane = "user";
  result.run = new_run_id();
  result.inputs = inputs.inputs_digest;
  result.truth = inputs.truth_digest;
  result.label = o.label.empty() ? "file" : o.label;
  result.role = "user";
  result.set = set.name;
  result.set_kind = to_string(set.kind);
  result.size = to_string(set.size);
  result.device = host_name();
  result.started = utc_now();
  judge_call(task, set, problem, inputs.truth_or_null(), report, nullptr, result);
  fmt::print("{} {} {}: {}{}\n{}", task.name, printable(o.outputs), set.name, to_string(result.state),
             result.state_detail.empty() ? "" : " - " + result.state_detail, check_table(result));
  for (const FaultResult& f : result.faults) fmt::print("    fault {}: {}\n", f.fault, f.detail);
  for (const auto& [array, gap] : result.truth_gap) {
    fmt::print("    relative L2 distance of {} to the FP64 truth: {:.3g}\n", array, gap);
  }
  if (!o.label.empty()) write_result(ctx.results_root, result);
  if (result.state == RunState::fault) ctx.exit_code = ExitCode::module_fault;
  if (result.state == RunState::fail) ctx.exit_code = ExitCode::check_failed;
}

}  // namespace

void add_check_command(CLI::App& app, Context& ctx) {
  auto o = std::make_shared<CheckOptions>();
  CLI::App* command =
      app.add_subcommand("check", "Judge outputs in an HDF5 file, written by a program in any language");
  command->add_option("--task", o->task, "Task")->required();
  command->add_option("--outputs", o->outputs, "HDF5 file with the task's outputs")->required();
  command->add_option("--set", o->set, "Input set that they were computed from");
  command->add_option("--inputs", o->inputs, "HDF5 file of inputs that they were computed from");
  command
      ->add_option("--timeout", o->timeout_s, "Seconds that the FP64 baseline may take for one's own inputs")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
  command->add_option("--label", o->label, "Keep the result under this name, for verdict and report");
  command->footer(
      "The file needs one dataset for each output, of the contract's type and shape (`gpuphys list --task "
      "T`); attributes\n"
      "are optional, but a wrong `task` or `set` is refused. Values are never converted. Exit code 0 when "
      "every check\n"
      "passes, 3 when one fails, 4 for unwritten elements, 5 for a file that cannot be judged.\n\n"
      "Examples:\n"
      "  gpuphys export --task advect_rk2 --set public --output inputs.h5\n"
      "  ./my_solver inputs.h5 outputs.h5\n"
      "  gpuphys check --task advect_rk2 --set public --outputs outputs.h5\n"
      "  gpuphys check --task advect_rk2 --inputs my_inputs.h5 --outputs outputs.h5 --label my_solver\n");
  command->callback([o, &ctx] { check(ctx, *o); });
}

}  // namespace gpuphys
