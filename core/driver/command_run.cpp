// gpuphys run: a module on input sets, judged.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>

#include "core/base/host_info.hpp"
#include "core/base/progress.hpp"
#include "core/contract/hdf5_io.hpp"
#include "core/contract/permutation.hpp"
#include "core/driver/context.hpp"
#include "core/judge/judge.hpp"

namespace gpuphys {
namespace {

struct RunOptions {
  std::string task, module, label, expect = "pass", inputs;
  std::vector<std::string> sets;
  std::vector<std::string> scalars;
  double timeout_s = 200;
  bool sweep = false, under_tool = false;
  std::uint64_t permute = 0;  // seed of the order of the items; 0 leaves them alone
};

// Every run of the command: the sets at the values of one scalar, or once with the scalars given.
struct Variation {
  std::map<std::string, double> overrides;
  std::string suffix;  // of the label: "@tol=1e-4"
};

std::vector<Variation> variations(const Task& task, const RunOptions& o) {
  Variation fixed;
  fixed.overrides = parse_scalars(o.scalars);
  if (!o.sweep) {
    for (const auto& [name, value] : fixed.overrides) fixed.suffix += fmt::format("@{}={:g}", name, value);
    return {fixed};
  }
  if (!task.knob)
    throw Error(ExitCode::usage, fmt::format("task '{}' has no accuracy knob to sweep", task.name));
  std::vector<Variation> all;
  for (const double value : task.knob->values) {
    all.push_back({{{task.knob->scalar, value}}, fmt::format("@{}={:g}", task.knob->scalar, value)});
  }
  return all;
}

void print_result(const RunResult& r) {
  std::string gaps;
  for (const auto& [name, gap] : r.truth_gap) gaps += fmt::format(" {} {:.2e}", name, gap);
  fmt::print("{} {} {}: {}{}  ({:.3f} ms)\n", r.task, r.label, r.set, to_string(r.state),
             r.state_detail.empty() ? "" : " - " + r.state_detail, r.milliseconds);
  fmt::print("{}", check_table(r));
  if (!gaps.empty()) fmt::print("    distance to {}:{}\n", r.truth_source, gaps);
  for (const FaultResult& f : r.faults) fmt::print("    fault {}: {}\n", f.fault, f.detail);
  if (!r.confinement.empty()) fmt::print("    {}\n", r.confinement);
  std::fflush(stdout);
}

bool same_scalars(const std::vector<Scalar>& a, const std::vector<Scalar>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const Scalar& x, const Scalar& y) { return x.value == y.value; });
}

// One judgement to come: a set at one choice of scalars.
struct Job {
  const InputSet* set;
  const Variation* variation;
  RunResult result;  // RUNNING until judged
};

class Session {
 public:
  Session(Context& ctx, const RunOptions& o, const Task& task, const ModuleIdentity& id)
      : ctx_(ctx), o_(o), task_(task), id_(id) {}

  void run() {
    const std::vector<Variation> all = variations(task_, o_);
    std::vector<InputSet> own;
    std::vector<const InputSet*> sets;
    if (!o_.inputs.empty()) {
      own.push_back(own_inputs());
      sets.push_back(&own.front());
    }
    for (const std::string& name : o_.sets) sets.push_back(&task_.set(name));

    // Whether there is a GPU is decided before anything else: without one device modules are skipped, also
    // those that this build left out.
    GpuUse gpu = id_.lane == "gpu" ? GpuUse::needed : id_.lane == "user" ? GpuUse::unknown : GpuUse::no;
    std::string device = host_name();
    std::optional<Error> missing;
    try {
      path_ = ctx_.module_path(task_.name, o_.module);
    } catch (const Error& e) {
      missing = e;
    }
    if (gpu != GpuUse::no) {
      waiting_ = new_runner();
      try {
        device = waiting_->identify().device;
      } catch (const Error& e) {
        if (gpu == GpuUse::needed || e.code() != ExitCode::skipped) throw;
      }
    }
    if (missing) throw *missing;

    const std::string run_id = new_run_id();
    std::vector<Job> jobs;
    for (const InputSet* set : sets) {
      for (const Variation& v : all) {
        jobs.push_back({set, &v, blank_result(*set, v, run_id)});
        jobs.back().result.device = device;
        write_result(ctx_.results_root, jobs.back().result);
      }
    }
    Progress progress("judging " + id_.label, static_cast<std::int64_t>(jobs.size()));
    ExitCode worst = ExitCode::ok;
    for (std::size_t i = 0; i < jobs.size(); ++i) {
      progress.note(jobs[i].set->name);
      judge(jobs[i], i + 1 == jobs.size(), gpu);
      RunResult& r = jobs[i].result;
      write_result(ctx_.results_root, r);
      print_result(r);
      worst = std::max(worst, exit_code(r));
      progress.step(jobs[i].set->name);
    }
    ctx_.exit_code = worst;
  }

 private:
  static constexpr const char* kOwn = "own";

  InputSet own_inputs() {
    own_problem_ = read_problem(o_.inputs, task_);
    InputSet own;
    own.name = kOwn;
    own.kind = SetKind::open;
    own.size = Size::smoke;
    return own;
  }

  RunResult blank_result(const InputSet& set, const Variation& v, const std::string& run_id) const {
    RunResult r;
    r.task = task_.name;
    r.run = run_id;
    r.lane = id_.lane;
    r.label = id_.label + v.suffix;
    r.role = id_.role;
    r.set = set.name;
    r.set_kind = to_string(set.kind);
    r.size = to_string(set.size);
    r.state = RunState::running;
    r.mutant_class = id_.mutant_class;
    r.expected_check = id_.expected_check;
    r.sparse = id_.sparse;
    r.scalar_overrides = v.overrides;
    r.module = ctx_.stamp_of(path_);
    r.started = utc_now();
    return r;
  }

  // Inputs and truth stay those of one set while its variations run.
  const Prepared& prepared(const InputSet& set) {
    if (prepared_for_ != set.name) {
      prepared_ = {};
      if (set.name == kOwn && own_problem_) {
        prepared_ = prepare_own(ctx_.workplace(o_.timeout_s), task_, set, std::move(*own_problem_));
        own_problem_.reset();
      } else {
        prepared_ = prepare(ctx_.workplace(), task_, set, wants_truth(task_, set));
      }
      prescribed_ = prepared_.problem.scalars;
      prepared_for_ = set.name;
    }
    return prepared_;
  }

  void judge(Job& job, bool last, GpuUse gpu) {
    RunResult& r = job.result;
    (void)prepared(*job.set);
    prepared_.problem.scalars = prescribed_;
    // The knob trades accuracy for speed and leaves the problem alone: one truth serves the whole sweep.
    for (const auto& [name, value] : job.variation->overrides) prepared_.problem.set_scalar(name, value);
    r.inputs = prepared_.inputs_digest;
    r.truth = prepared_.truth_digest;
    try {
      if (!runner_) start(gpu);
      r.confinement = runner_->unconfined().empty() ? "" : "unconfined: " + runner_->unconfined();
      if (!runner_->on_device()) r.device = host_name();
      CallReport report;
      if (o_.permute == 0) {
        report = runner_->call(task_.contract, prepared_.problem, {.timed = false, .last = last});
      } else {
        const PermutedProblem other = permuted(task_, prepared_.problem, o_.permute);
        report = runner_->call(task_.contract, other.problem, {.timed = false, .last = last});
        if (!report.outputs.empty()) report.outputs = restore_order(task_, other.permutation, report.outputs);
      }
      r.bytes = 0;
      for (const Arrays* arrays : {&prepared_.problem.inputs, &prepared_.truth, &report.outputs}) {
        for (const HostArray& a : *arrays) r.bytes += static_cast<double>(a.bytes());
      }
      if (last) say(*runner_);
      judge_call(task_, *job.set, prepared_.problem, prepared_.truth_or_null(), report,
                 earlier_.empty() ? nullptr : &earlier_, r);
      if (id_.role == "mutant" || o_.expect == "killed") conclude_mutant(r);
      earlier_ = std::move(report.outputs);
    } catch (const RunnerLost& lost) {
      r.state = lost.timed_out() ? RunState::timeout : RunState::crashed;
      r.state_detail = lost.what();
      runner_.reset();
      earlier_.clear();
    } catch (const Error& e) {
      if (e.code() == ExitCode::skipped && runner_ == nullptr) throw;
      // No runner survives a lost CUDA context or exhausted memory; the next set gets a fresh one.
      r.state = e.code() == ExitCode::module_fault ? RunState::fault : RunState::error;
      r.state_detail = e.what();
      runner_.reset();
      earlier_.clear();
      if (e.code() != ExitCode::module_fault) error_ = std::max(error_, e.code());
    }
  }

  std::unique_ptr<Runner> new_runner() const {
    RunnerOptions options = ctx_.runner_options(o_.timeout_s);
    options.under_tool = o_.under_tool;
    return std::make_unique<Runner>(options, path_.empty() ? "/dev/null" : path_);
  }

  void start(GpuUse gpu) {
    std::unique_ptr<Runner> runner = waiting_ ? std::move(waiting_) : new_runner();
    runner->load(gpu);
    if (runner->task() != task_.name) {
      throw Error(ExitCode::module_fault,
                  fmt::format("module '{}' computes task '{}', not '{}'", path_, runner->task(), task_.name));
    }
    if (runner->output_real() != DType::f32 && id_.label != "baseline_f64")
      throw Error(ExitCode::module_fault,
                  fmt::format("module '{}' has float64 outputs: float32 are judged", path_));
    runner_ = std::move(runner);
  }

  static void say(const Runner& runner) {
    for (const std::string& line : runner.printed()) fmt::print(stderr, "module: {}\n", line);
  }

  // Whether a run ended as its caller wants it to.
  ExitCode exit_code(const RunResult& r) const {
    if (r.state == (o_.expect == "killed" ? RunState::killed : RunState::pass)) return ExitCode::ok;
    // A sweep measures: that a setting looser than the prescribed one misses a check is its point. Nothing
    // else is.
    if (o_.sweep && r.state == RunState::fail && !same_scalars(prepared_.problem.scalars, prescribed_))
      return ExitCode::ok;
    // Judged and reported, not required to pass.
    if (id_.role == kFastMath && (r.state == RunState::fail || r.state == RunState::pass))
      return ExitCode::ok;
    switch (r.state) {
      case RunState::fault:
        return ExitCode::module_fault;
      case RunState::crashed:
      case RunState::timeout:
        return ExitCode::crashed;
      case RunState::error:
        return error_;
      default:
        return ExitCode::check_failed;
    }
  }

  Context& ctx_;
  const RunOptions& o_;
  const Task& task_;
  const ModuleIdentity& id_;
  std::string path_;
  std::unique_ptr<Runner> waiting_;  // has told about the GPU, and loaded nothing yet
  std::unique_ptr<Runner> runner_;
  Prepared prepared_;
  std::string prepared_for_;
  std::vector<Scalar> prescribed_;
  std::optional<Problem> own_problem_;
  Arrays earlier_;
  ExitCode error_ = ExitCode::check_failed;
};

void run(Context& ctx, RunOptions& o) {
  const Task& task = find_task(o.task);
  const ModuleIdentity id = identify_module(o.module, o.label, task.name, ctx.mutants_root());
  if (!(std::isfinite(o.timeout_s) && o.timeout_s > 0))
    throw Error(ExitCode::usage, fmt::format("--timeout {}: not a positive number of seconds", o.timeout_s));
  if (!o.inputs.empty() && id.role != "user")
    throw Error(ExitCode::usage,
                "--inputs goes with a module of one's own: the suite's are judged on its sets");
  if (o.sets.empty() && o.inputs.empty()) o.sets = {"public", "hidden"};
  for (const std::string& name : o.sets) task.set(name);
  Session(ctx, o, task, id).run();
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
  command->add_option("--inputs", options->inputs,
                      "HDF5 file of inputs of one's own, judged against the FP64 baseline");
  command->add_option("--label", options->label, "Name under which results are kept (default: the module's)");
  command->add_option("--expect", options->expect, "What counts as success")
      ->check(CLI::IsMember({"pass", "killed"}))
      ->capture_default_str();
  command->add_option("--scalar", options->scalars, "Override a scalar input: NAME=NUMBER (repeatable)");
  command->add_flag("--sweep", options->sweep, "Run at every value of the task's accuracy knob");
  command->add_flag(
      "--under-tool", options->under_tool,
      "A tool such as compute-sanitizer slows the device: ignore what is judged by its times, and do "
      "not confine the module, which the tool has to reach");
  command->add_option(
      "--permute", options->permute,
      "Put the items whose order carries no meaning in the order of this seed first (0: leave them)");
  command->add_option("--timeout", options->timeout_s, "Seconds that the module may take for one set")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
  command->footer(
      "The module runs in a confined process of its own, which can neither write files nor read the truth. "
      "Exit code 0 when\n"
      "every set ended as expected, 3 when a check failed (or a mutant survived), 4 when the module broke a "
      "rule, 9 when it\n"
      "crashed or ran out of time, 77 without a GPU.\n\n"
      "Examples:\n"
      "  gpuphys run --task advect_rk2 --module reference --set public --set hard_cfl60\n"
      "  gpuphys run --task advect_rk2 --module build/mine.so --label mine\n"
      "  gpuphys run --task advect_rk2 --module build/mine.so --inputs my_inputs.h5\n"
      "  gpuphys run --task poisson_neumann --module reference --sweep --set public\n"
      "  gpuphys run --task contact_dem --module reference --permute 1 --label reference.permuted\n"
      "  gpuphys run --task advect_rk2 --module mutant.forward_half_step --expect killed\n");
  command->callback([options, &ctx] { run(ctx, *options); });
}

}  // namespace gpuphys
