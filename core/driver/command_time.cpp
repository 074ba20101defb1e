// gpuphys time: how fast a device module is, against the floor and against its history.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>

#include "core/base/progress.hpp"
#include "core/contract/hdf5_io.hpp"
#include "core/driver/context.hpp"
#include "core/judge/judge.hpp"
#include "core/measure/protocol.hpp"
#include "core/measure/timing.hpp"

namespace gpuphys {
namespace {

struct TimeOptions {
  std::string task, module, label, warmup_set, against, inputs;
  std::vector<std::string> sets;
  std::vector<std::string> scalars;
  double timeout_s = 200;
  bool sweep = false, no_gate = false, skip_unbaselined = false, one_process = false;
};

using Overrides = std::map<std::string, double>;

// The set that warms up: the other one of the pair, or the small public one for hard cases and one's own
// inputs.
std::string other_set(const Task& task, const std::string& set) {
  const std::pair<const char*, const char*> pairs[] = {{"public", "hidden"},
                                                       {"hidden", "public"},
                                                       {"public_smoke", "hidden_smoke"},
                                                       {"hidden_smoke", "public_smoke"}};
  for (const auto& [one, other] : pairs) {
    if (set == one) return other;
  }
  if (set != "public_smoke") return "public_smoke";
  throw Error(
      ExitCode::usage,
      fmt::format("{}: name a second input set with --warmup-set: none goes with '{}'", task.name, set));
}

std::string percent(double x) {
  return fmt::format("{:.2f} %", 100 * x);
}

void print_timing(const TimingResult& r, const GateAnswer& gate, const std::string& prefix) {
  fmt::print("{}{} {} {}: {:.4f} ms, minimum {:.4f} ({:.2f} x floor", prefix, r.task, r.label, r.set,
             r.median_ms, r.min_ms, r.multiple);
  if (r.target_multiple > 0) fmt::print(", target {:.2f}", r.target_multiple);
  fmt::print(")  {}\n", r.gate.state);
  fmt::print("    calls {:.4f} ms, spread {} of the range, {} of the middle half, {}\n",
             fmt::join(r.times_ms, " "), percent(r.spread), percent(noise_spread(r.times_ms)),
             r.fresh_processes ? "a process each" : "in one process");
  fmt::print(
      "    floor {:.4f} ms: {:.1f} MB at {:.0f} GB/s copied; FP32 {:.1f} TFLOP/s, launch {:.2f} us, {}\n",
      r.floor_ms, r.compulsory_bytes / 1e6, r.ceilings.at("copy_GBps"), r.ceilings.at("fp32_TFLOPs"),
      r.ceilings.at("launch_us"), r.device);
  if (gate.state == GateState::unbaselined) {
    fmt::print("    no history of this GPU to compare with: nothing is said about regressions\n");
  } else if (std::isfinite(gate.limit)) {
    fmt::print("    best so far {:.2f} x floor, limit {:.2f} (noise {})\n", gate.baseline_multiple,
               gate.limit, percent(gate.spread));
  }
  std::fflush(stdout);
}

ExitCode exit_code_of(GateState state, const TimeOptions& o) {
  switch (state) {
    case GateState::ok:
      return ExitCode::ok;
    case GateState::slow:
      return o.no_gate ? ExitCode::ok : ExitCode::slow;
    case GateState::noisy:
      return o.no_gate ? ExitCode::ok : ExitCode::noisy;
    case GateState::unbaselined:
      if (o.skip_unbaselined) return ExitCode::skipped;
      return o.no_gate ? ExitCode::ok : ExitCode::unbaselined;
    case GateState::below_floor:
      return ExitCode::below_floor;
  }
  return ExitCode::internal;
}

class Timing {
 public:
  Timing(Context& ctx, const TimeOptions& o, const Task& task, const ModuleIdentity& id)
      : ctx_(ctx), o_(o), task_(task), id_(id), run_(new_run_id()) {}

  void run() {
    std::optional<Error> missing;
    try {
      path_ = ctx_.module_path(task_.name, o_.module);
    } catch (const Error& e) {
      missing = e;
    }
    {
      // In a process that loads nothing: skips without a GPU, also what this build left out.
      Runner first = Runner(ctx_.runner_options(o_.timeout_s), path_.empty() ? "/dev/null" : path_);
      gpu_ = first.identify();
      if (missing) throw *missing;
      ceilings_ = first.ceilings();
    }
    slug_ = gpu_slug(gpu_.device);
    history_ = load_history(ctx_.history_root(), slug_, task_.name);
    stamp_ = ctx_.stamp_of(path_);
    const Overrides fixed = parse_scalars(o_.scalars);
    if (!o_.inputs.empty()) {
      InputSet own;
      own.name = "own";
      own.kind = SetKind::open;
      own.size = Size::smoke;
      const Prepared inputs =
          prepare_own(ctx_.workplace(o_.timeout_s), task_, own, read_problem(o_.inputs, task_));
      time_set(own, inputs, fixed);
      return;
    }
    for (const std::string& name : o_.sets) {
      const InputSet& set = task_.set(name);
      const Prepared inputs = prepare(ctx_.workplace(), task_, set, wants_truth(task_, set));
      if (!o_.sweep) {
        time_set(set, inputs, fixed);
        continue;
      }
      // The points of a sweep are material for a plot; the gate watches the default setting.
      for (const double value : task_.knob->values) {
        Overrides overrides = fixed;
        overrides[task_.knob->scalar] = value;
        time_set(set, inputs, overrides);
      }
    }
  }

 private:
  // A copy of a problem's views with some scalars replaced.
  static Problem with(const Problem& p, const Overrides& overrides) {
    Problem changed;
    for (const HostArray& a : p.inputs) {
      if (a.shared())
        changed.inputs.emplace_back(a.name(), a.dtype(), a.shape(), a.unit(), a.shared(), a.shared_offset());
      else
        changed.inputs.push_back(a.clone());
    }
    changed.scalars = p.scalars;
    for (const auto& [name, value] : overrides) changed.set_scalar(name, value);
    return changed;
  }

  TimingResult measure(const InputSet& set, const Prepared& inputs, const Overrides& overrides) {
    const std::string warmup = o_.warmup_set.empty() ? other_set(task_, set.name) : o_.warmup_set;
    if (warmup == set.name)
      throw Error(ExitCode::usage, "--warmup-set must be another input set than the timed one");
    const Prepared other = prepare(ctx_.workplace(), task_, task_.set(warmup), false);
    const Problem timed_problem = with(inputs.problem, overrides),
                  other_problem = with(other.problem, overrides);
    // A sweep measures loose settings on purpose; wrong values are then the point, not an error.
    const bool must_pass = overrides.empty() && id_.role != kFastMath;
    const TimedSide timed{
        &timed_problem, [&](const CallReport& report, const Arrays* earlier) {
          RunResult r;
          judge_call(task_, set, timed_problem, inputs.truth_or_null(), report, earlier, r);
          std::vector<std::string> complaints;
          if (must_pass && r.state != RunState::pass)
            complaints.push_back(fmt::format("{}: {}: {}", set.name, to_string(r.state), r.state_detail));
          return complaints;
        }};
    // The reference as the paper measures; variants and sweeps are compared with each other in one process.
    TimingProtocol protocol;
    protocol.fresh_processes = !o_.one_process && overrides.empty();
    const int calls = protocol.timed_calls * (1 + (protocol.fresh_processes ? protocol.warmup_calls : 1));
    Progress progress("timing " + id_.label, calls);
    const auto start = [&] {
      auto runner = std::make_unique<Runner>(ctx_.runner_options(o_.timeout_s), path_);
      runner->load(GpuUse::needed);
      if (runner->task() != task_.name)
        throw Error(ExitCode::module_fault, fmt::format("module '{}' computes task '{}', not '{}'", path_,
                                                        runner->task(), task_.name));
      if (!runner->on_device())
        throw Error(ExitCode::usage,
                    fmt::format("'{}' is a host module: only device modules are timed", path_));
      return runner;
    };
    TimedCalls times;
    const std::string label = id_.label + suffix(overrides);
    try {
      times = time_module(start, task_.contract, timed, {&other_problem, nullptr}, protocol,
                          [&](const std::string& what) { progress.step(what); });
    } catch (const RunnerLost& e) {
      throw Error(ExitCode::crashed, fmt::format("{} {} {}: {}", task_.name, label, set.name, e.what()));
    } catch (const Error& e) {
      throw Error(e.code(), fmt::format("{} {} {}: {}", task_.name, label, set.name, e.what()));
    }
    TimingResult result =
        timing_result(task_.name, label, set.name, times.milliseconds, compulsory_bytes(task_, timed_problem),
                      task_.target_floor_multiple, ceilings_, gpu_);
    result.scalar_overrides = overrides;
    result.fresh_processes = protocol.fresh_processes;
    result.run = run_;
    result.module = stamp_;
    return result;
  }

  static std::string suffix(const Overrides& overrides) {
    std::string text;
    for (const auto& [name, value] : overrides) text += fmt::format("@{}={:g}", name, value);
    return text;
  }

  void time_set(const InputSet& set, const Prepared& inputs, const Overrides& overrides) {
    const HistoryEntry* best =
        overrides.empty() ? best_accepted(history_, o_.against.empty() ? id_.label : o_.against, set.name)
                          : nullptr;
    TimingResult result = measure(set, inputs, overrides);
    GateAnswer answer = apply_gate(result, ceilings_, best);
    print_timing(result, answer, "");
    const bool gated = !o_.no_gate && overrides.empty();
    if (gated && (answer.state == GateState::slow || answer.state == GateState::noisy)) {
      TimingResult second = measure(set, inputs, overrides);
      const GateAnswer again = apply_gate(second, ceilings_, best);
      print_timing(second, again, "again: ");
      const GateState both = confirmed_state(answer.state, again.state);
      // Kept is the one that was less disturbed; the verdict is that of both.
      if (second.multiple < result.multiple) result = std::move(second);
      result.gate.state = to_string(both);
      answer.state = both;
      fmt::print("{} {} {}: {} by both runs together\n", task_.name, result.label, result.set,
                 to_string(both));
    }
    write_result(ctx_.results_root, result);
    // A set without a history must not hide that another one is slow.
    const ExitCode code = overrides.empty()                        ? exit_code_of(answer.state, o_)
                          : answer.state == GateState::below_floor ? ExitCode::below_floor
                                                                   : ExitCode::ok;
    if (ctx_.exit_code == ExitCode::ok || ctx_.exit_code == ExitCode::skipped)
      ctx_.exit_code = code == ExitCode::ok ? ctx_.exit_code : code;
    else if (code != ExitCode::skipped)
      ctx_.exit_code = std::max(ctx_.exit_code, code);
  }

  Context& ctx_;
  const TimeOptions& o_;
  const Task& task_;
  const ModuleIdentity& id_;
  std::string run_, path_, slug_;
  GpuIdentity gpu_;
  Ceilings ceilings_;
  std::vector<HistoryEntry> history_;
  ModuleStamp stamp_;
};

void run(Context& ctx, TimeOptions& o) {
  const Task& task = find_task(o.task);
  const ModuleIdentity id = identify_module(o.module, o.label, task.name, ctx.mutants_root());
  if (o.sets.empty() && o.inputs.empty()) o.sets = {"public"};
  for (const std::string& name : o.sets) task.set(name);
  if (!o.warmup_set.empty()) task.set(o.warmup_set);
  if (o.sweep && !task.knob)
    throw Error(ExitCode::usage, fmt::format("task '{}' has no accuracy knob to sweep", task.name));
  Timing(ctx, o, task, id).run();
}

}  // namespace

void add_time_command(CLI::App& app, Context& ctx) {
  auto options = std::make_shared<TimeOptions>();
  CLI::App* command =
      app.add_subcommand("time", "Time a device module against the floor and against its history");
  command->add_option("--task", options->task, "Task")->required();
  command
      ->add_option("--module", options->module,
                   "Label of a module built with the suite, or the path of a shared object")
      ->required();
  command->add_option("--set", options->sets, "Input set that is timed (repeatable; default: public)");
  command->add_option("--inputs", options->inputs,
                      "HDF5 file of inputs of one's own to be timed, judged as by `run`");
  command->add_option("--warmup-set", options->warmup_set,
                      "Input set of the warm-up calls (default: the other of the pair)");
  command->add_option("--label", options->label, "Name under which results are kept (default: the module's)");
  command->add_option("--against", options->against,
                      "Label whose history the gate compares with (default: the module's own)");
  command->add_option("--scalar", options->scalars,
                      "Override an accuracy scalar: NAME=NUMBER (repeatable); outputs need not pass then");
  command->add_flag("--sweep", options->sweep, "Time every value of the task's accuracy knob, without gate");
  command->add_flag("--one-process", options->one_process,
                    "Make all calls in one process, for quick comparisons");
  command->add_flag(
      "--skip-unbaselined", options->skip_unbaselined,
      "End with 77 instead of 11 where there is no history to compare with (CTest: skipped, not passed)");
  command->add_flag(
      "--no-gate", options->no_gate,
      "Measure for a first or a new record: SLOW, NOISY and UNBASELINED are said but do not fail");
  command->add_option("--timeout", options->timeout_s, "Seconds that one call may take")
      ->check(CLI::Range(0.001, 86400.0))
      ->capture_default_str();
  command->footer(
      "Five calls are timed, each in a fresh process after three on another input set, its outputs judged. "
      "Minimum (the\n"
      "paper's figure) and median are printed. Exit code 0 when the gate is OK; 10 SLOW, twice; 11 "
      "UNBASELINED, "
      "no history of\n"
      "this GPU; 12 BELOW_FLOOR, faster than physically possible; 15 NOISY, twice; 3 and 4 when an output "
      "was "
      "wrong or a\n"
      "rule was broken; 77 without a GPU.\n\n"
      "Examples:\n"
      "  gpuphys time --task advect_rk2 --module reference\n"
      "  gpuphys time --task advect_rk2 --module ./mine.so --against reference\n"
      "  gpuphys time --task advect_rk2 --module ./mine.so --inputs my_inputs.h5\n"
      "  gpuphys time --task poisson_neumann --module reference --sweep\n"
      "  gpuphys time --task advect_rk2 --module reference --set public --set hidden\n");
  command->callback([options, &ctx] { run(ctx, *options); });
}

}  // namespace gpuphys
