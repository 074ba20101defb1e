// gpuphys run: a module on input sets, judged.
#include <fmt/format.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <thread>

#include "core/driver/context.hpp"
#include "core/harness.hpp"
#include "core/host_info.hpp"
#include "core/judge.hpp"
#include "core/permutation.hpp"
#include "core/progress.hpp"
#include "core/truth_cache.hpp"

namespace gpuphys {
namespace {

struct RunOptions {
  std::string task, module, label, expect = "pass";
  std::vector<std::string> sets;
  std::vector<std::string> scalars;
  double timeout_s = 600;
  bool sweep = false, under_tool = false;
  std::uint64_t permute = 0;  // seed of the order of the items; 0 leaves them alone
};

std::string number_text(double v) {
  return fmt::format("{:g}", v);
}

// Every run of the command: the sets at the values of one scalar, or once with the scalars given.
struct Variation {
  std::map<std::string, double> overrides;
  std::string suffix;  // of the label: "@tol=1e-4"
};

std::vector<Variation> variations(const Task& task, const RunOptions& o) {
  Variation fixed;
  for (const std::string& assignment : o.scalars) {
    const std::size_t equals = assignment.find('=');
    try {
      fixed.overrides[assignment.substr(0, equals)] = std::stod(assignment.substr(equals + 1));
    } catch (const std::exception&) {
      throw Error(ExitCode::usage, fmt::format("--scalar wants NAME=NUMBER, not '{}'", assignment));
    }
  }
  if (!o.sweep) {
    for (const auto& [name, value] : fixed.overrides)
      fixed.suffix += fmt::format("@{}={}", name, number_text(value));
    return {fixed};
  }
  if (!task.knob)
    throw Error(ExitCode::usage, fmt::format("task '{}' has no accuracy knob to sweep", task.name));
  std::vector<Variation> all;
  for (const double value : task.knob->values) {
    all.push_back(
        {{{task.knob->scalar, value}}, fmt::format("@{}={}", task.knob->scalar, number_text(value))});
  }
  return all;
}

RunResult blank_result(const Task& task, const InputSet& set, const ModuleIdentity& id, bool on_device,
                       const Variation& v) {
  RunResult r;
  r.task = task.name;
  r.lane = on_device ? "gpu" : "cpu";
  r.label = id.label + v.suffix;
  r.role = id.role;
  r.set = set.name;
  r.set_kind = to_string(set.kind);
  r.size = to_string(set.size);
  r.mutant_class = id.mutant_class;
  r.expected_check = id.expected_check;
  r.sparse = id.sparse;
  r.scalar_overrides = v.overrides;
  r.started = utc_now();
  return r;
}

void print_result(const RunResult& r) {
  std::string gaps;
  for (const auto& [name, gap] : r.truth_gap) gaps += fmt::format(" {} {:.2e}", name, gap);
  fmt::print("{} {} {}: {}{}  ({:.3f} ms)\n", r.task, r.label, r.set, to_string(r.state),
             r.state_detail.empty() ? "" : " - " + r.state_detail, r.milliseconds);
  fmt::print("{}", check_table(r));
  if (!gaps.empty()) fmt::print("    distance to {}:{}\n", r.truth_source, gaps);
  for (const FaultResult& f : r.faults) fmt::print("    fault {}: {}\n", f.fault, f.detail);
  std::fflush(stdout);
}

// Whether a run ended as its caller wants it to.
bool as_expected(const RunResult& r, const std::string& expect) {
  return r.state == (expect == "killed" ? RunState::killed : RunState::pass);
}

bool same_scalars(const std::vector<Scalar>& a, const std::vector<Scalar>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const Scalar& x, const Scalar& y) { return x.value == y.value; });
}

// Runs in a child process. Returns its exit code.
int work(const Context& ctx, const RunOptions& o, const Task& task, const ModuleIdentity& id) {
  // Without a GPU the device modules are skipped, also those that this build left out.
  if (id.lane == "gpu") make_device_backend();
  const std::string path = ctx.module_path(task.name, o.module);
  const LoadedModule module(path);
  if (task.name != module.table().task) {
    throw Error(ExitCode::module_fault, fmt::format("module '{}' computes task '{}', not '{}'", path,
                                                    module.table().task, task.name));
  }
  const std::unique_ptr<Backend> backend = make_backend(module);
  const std::vector<Variation> all = variations(task, o);
  Progress progress("judging " + id.label, static_cast<std::int64_t>(o.sets.size() * all.size()));
  ExitCode worst = ExitCode::ok;
  Arrays earlier;
  for (const std::string& set_name : o.sets) {
    const InputSet& set = task.set(set_name);
    progress.note(set_name + ": inputs");
    Problem problem = set.make();
    Arrays truth;
    const bool has_truth = wants_truth(task, set);
    const std::vector<Scalar> prescribed = problem.scalars;
    for (const Variation& v : all) {
      for (const auto& [name, value] : v.overrides) problem.set_scalar(name, value);
      // The knob trades accuracy for speed and leaves the problem alone: one truth serves the whole sweep.
      if (has_truth && truth.empty()) {
        progress.note(set_name + ": truth");
        truth = obtain_truth(task, set, problem, ctx.module_path(task.name, "baseline_f64"), ctx.truth_root);
      }
      RunResult result = blank_result(task, set, id, module.on_device(), v);
      result.device = module.on_device() ? device_name() : host_name();
      CallReport report;
      if (o.permute == 0) {
        report = backend->call(module, task.contract, problem);
      } else {
        const PermutedProblem other = permuted(task, problem, o.permute);
        report = backend->call(module, task.contract, other.problem);
        if (!report.outputs.empty()) report.outputs = restore_order(task, other.permutation, report.outputs);
      }
      if (o.under_tool)
        std::erase_if(report.faults,
                      [](const FaultReport& f) { return f.fault == Fault::asynchronous_return; });
      judge_call(task, set, problem, has_truth ? &truth : nullptr, report,
                 earlier.empty() ? nullptr : &earlier, result);
      if (o.expect == "killed") {
        result.state = mutant_state(result);
        if (result.state == RunState::killed) {
          const CheckResult* killer = result.worst_check();
          result.state_detail = fmt::format("{} at {:.3g} times its tolerance", killer->name, killer->ratio);
        }
      }
      write_result(ctx.results_root, result);
      print_result(result);
      // A sweep measures: that a setting looser than the prescribed one misses a check is its point. Nothing
      // else is.
      const bool may_fail =
          o.sweep && result.state == RunState::fail && !same_scalars(problem.scalars, prescribed);
      if (!may_fail && !as_expected(result, o.expect)) {
        worst = std::max(worst, result.state == RunState::fault     ? ExitCode::module_fault
                                : result.state == RunState::crashed ? ExitCode::crashed
                                                                    : ExitCode::check_failed);
      }
      earlier = std::move(report.outputs);
      progress.step(set_name);
    }
  }
  return static_cast<int>(worst);
}

// Waits for the worker; a worker that outlives its time is killed. Returns waitpid's status, or nothing on
// time-out.
std::optional<int> wait_for(pid_t worker, double timeout_s) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::duration<double>(timeout_s);
  for (;;) {
    int status = 0;
    if (waitpid(worker, &status, WNOHANG) == worker) return status;
    if (std::chrono::steady_clock::now() > deadline) {
      kill(worker, SIGKILL);
      waitpid(worker, &status, 0);
      return std::nullopt;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
}

void run(Context& ctx, RunOptions& o) {
  const Task& task = find_task(o.task);
  const ModuleIdentity id = identify_module(o.module, o.label, task.name, ctx.source_root + "/mutants");
  if (o.sets.empty()) o.sets = {"public", "hidden"};
  for (const std::string& name : o.sets) task.set(name);
  const std::string started = utc_now();

  // The module runs in a child, so that its crash is a verdict and not the end of this program. Forked before
  // anything touches CUDA, which does not survive a fork.
  std::fflush(nullptr);
  const pid_t worker = fork();
  if (worker < 0) throw Error(ExitCode::internal, "cannot start a worker process");
  if (worker == 0) {
    int code = static_cast<int>(ExitCode::internal);
    try {
      code = work(ctx, o, task, id);
    } catch (const Error& e) {
      fmt::print(stderr, "gpuphys: {}\n", e.what());
      code = static_cast<int>(e.code());
    } catch (const std::bad_alloc&) {
      fmt::print(stderr, "gpuphys: out of host memory\n");
      code = static_cast<int>(ExitCode::out_of_memory);
    } catch (const std::exception& e) {
      fmt::print(stderr, "gpuphys: internal error: {}\n", e.what());
    }
    std::fflush(nullptr);
    _exit(code);
  }
  const std::optional<int> status = wait_for(worker, o.timeout_s);
  if (status && WIFEXITED(*status)) {
    const auto code = static_cast<ExitCode>(WEXITSTATUS(*status));
    if (code == ExitCode::skipped) throw Error(code, fmt::format("{} {}: skipped", task.name, id.label));
    ctx.exit_code = code;
    return;
  }
  // Whatever had been judged before stays written; the sets that were not reached are recorded as lost.
  const RunState state = status ? RunState::crashed : RunState::timeout;
  const std::string why = status ? fmt::format("the module's process died of signal {} ({})",
                                               WTERMSIG(*status), strsignal(WTERMSIG(*status)))
                                 : fmt::format("no answer within {:g} s", o.timeout_s);
  const ResultSet written = load_results(ctx.results_root, task.name);
  for (const Variation& v : variations(task, o)) {
    for (const std::string& name : o.sets) {
      RunResult lost = blank_result(task, task.set(name), id, id.lane != "cpu", v);
      const RunResult* there = written.find_run(task.name, lost.lane, lost.label, name);
      if (there != nullptr && there->started >= started) continue;
      lost.state = state;
      lost.state_detail = why;
      write_result(ctx.results_root, lost);
      fmt::print("{} {} {}: {} - {}\n", task.name, lost.label, name, to_string(state), why);
    }
  }
  ctx.exit_code = ExitCode::crashed;
}

}  // namespace

void add_run_command(CLI::App& app, Context& ctx) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = app.add_subcommand("run", "Run a module on input sets and judge its outputs");
  command->add_option("--task", options->task, "Task")->required();
  command
      ->add_option("--module", options->module,
                   "Label of a module built with the suite, or the path of a shared object")
      ->required();
  command->add_option("--set", options->sets, "Input set (repeatable; default: public and hidden)");
  command->add_option("--label", options->label, "Name under which results are kept (default: the module's)");
  command->add_option("--expect", options->expect, "What counts as success")
      ->check(CLI::IsMember({"pass", "killed"}))
      ->capture_default_str();
  command->add_option("--scalar", options->scalars, "Override a scalar input: NAME=NUMBER (repeatable)");
  command->add_flag("--sweep", options->sweep, "Run at every value of the task's accuracy knob");
  command->add_flag("--under-tool", options->under_tool,
                    "A tool such as compute-sanitizer slows the device: ignore what is judged by its times");
  command->add_option(
      "--permute", options->permute,
      "Put the items whose order carries no meaning in the order of this seed first (0: leave them)");
  command->add_option("--timeout", options->timeout_s, "Seconds after which the module is stopped")
      ->capture_default_str();
  command->footer(
      "The module runs in a process of its own. Exit code 0 when every set ended as expected, 3 when a check "
      "failed (or a\n"
      "mutant survived), 4 when the module broke a rule, 9 when it crashed or ran out of time, 77 without a "
      "GPU.\n\n"
      "Examples:\n"
      "  gpuphys run --task advect_rk2 --module reference --set public --set hard_cfl60\n"
      "  gpuphys run --task advect_rk2 --module build/mine.so --label mine\n"
      "  gpuphys run --task poisson_neumann --module reference --sweep --set public\n"
      "  gpuphys run --task contact_dem --module reference --permute 1 --label reference.permuted\n"
      "  gpuphys run --task advect_rk2 --module mutant.forward_half_step --expect killed\n");
  command->callback([options, &ctx] { run(ctx, *options); });
}

}  // namespace gpuphys
