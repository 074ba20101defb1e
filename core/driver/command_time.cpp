// gpuphys time: how fast a device module is, against the floor and against the record.
#include <fcntl.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "core/driver/context.hpp"
#include "core/files.hpp"
#include "core/host_info.hpp"
#include "core/judge.hpp"
#include "core/progress.hpp"
#include "core/timing.hpp"
#include "core/truth_cache.hpp"

extern char** environ;

namespace gpuphys {
namespace {

struct TimeOptions {
  std::string task, module, label, warmup_set, against;
  std::vector<std::string> sets{"public"};  // one that is timed, or two that are timed in turn
  std::vector<std::string> scalars;
  bool sweep = false, no_gate = false, skip_unbaselined = false;
  std::string confirm_to;  // hidden: this is the second process, its result goes to this file
};

using Overrides = std::map<std::string, double>;

Overrides parse_scalars(const std::vector<std::string>& assignments) {
  Overrides overrides;
  for (const std::string& assignment : assignments) {
    const std::size_t equals = assignment.find('=');
    try {
      if (equals == std::string::npos) throw std::invalid_argument(assignment);
      std::size_t used = 0;
      const std::string value = assignment.substr(equals + 1);
      overrides[assignment.substr(0, equals)] = std::stod(value, &used);
      if (used != value.size()) throw std::invalid_argument(assignment);
    } catch (const std::exception&) {
      throw Error(ExitCode::usage, fmt::format("--scalar wants NAME=NUMBER, not '{}'", assignment));
    }
  }
  return overrides;
}

// The set that warms up and alternates: the other one of the pair, or the small public one for hard cases.
std::string other_set(const Task& task, const std::string& set) {
  const std::pair<const char*, const char*> pairs[] = {{"public", "hidden"},
                                                       {"hidden", "public"},
                                                       {"public_smoke", "hidden_smoke"},
                                                       {"hidden_smoke", "public_smoke"}};
  for (const auto& [one, other] : pairs) {
    if (set == one) return other;
  }
  for (const InputSet& candidate : task.sets) {
    if (candidate.name != set && candidate.size == Size::smoke) return candidate.name;
  }
  throw Error(
      ExitCode::usage,
      fmt::format("{}: name a second input set with --warmup-set: none goes with '{}'", task.name, set));
}

std::string percent(double x) {
  return fmt::format("{:.2f} %", 100 * x);
}

void print_timing(const TimingResult& r, const GateAnswer& gate, const std::string& prefix) {
  fmt::print("{}{} {} {}: {:.4f} ms ({:.2f} x floor", prefix, r.task, r.label, r.set, r.median_ms,
             r.multiple);
  if (r.target_multiple > 0) fmt::print(", target {:.2f}", r.target_multiple);
  fmt::print(")  {}\n", r.gate.state);
  fmt::print("    calls {:.4f} ms, spread {} of the range, {} of the middle half\n",
             fmt::join(r.times_ms, " "), percent(r.spread), percent(noise_spread(r.times_ms)));
  fmt::print(
      "    floor {:.4f} ms: {:.1f} MB at {:.0f} GB/s copied; FP32 {:.1f} TFLOP/s, launch {:.2f} us, {}\n",
      r.floor_ms, r.compulsory_bytes / 1e6, r.ceilings.at("copy_GBps"), r.ceilings.at("fp32_TFLOPs"),
      r.ceilings.at("launch_us"), r.device);
  if (gate.state == GateState::unbaselined) {
    fmt::print("    no record of this GPU to compare with: nothing is said about regressions\n");
  } else if (std::isfinite(gate.limit)) {
    fmt::print("    record {:.2f} x floor, limit {:.2f} (noise {})\n", gate.baseline_multiple, gate.limit,
               percent(gate.spread));
  }
  std::fflush(stdout);
}

// What is timed on one input set and judged there.
struct Side {
  const InputSet& set;
  Problem problem;
  Arrays truth;
};

Side make_side(const Context& ctx, const Task& task, const std::string& name, const Overrides& overrides,
               bool judged) {
  const InputSet& set = task.set(name);
  Side side{set, set.make(), {}};
  // Overrides are accuracy knobs: they do not change what is true.
  if (judged && wants_truth(task, set)) {
    side.truth =
        obtain_truth(task, set, side.problem, ctx.module_path(task.name, "baseline_f64"), ctx.truth_root);
  }
  for (const auto& [scalar, value] : overrides) side.problem.set_scalar(scalar, value);
  return side;
}

// One process's measurement of one or two sets at one choice of scalars.
std::vector<TimingResult> measure(const Context& ctx, const TimeOptions& o, const Task& task,
                                  const ModuleIdentity& id, const std::string& path, const Ceilings& ceilings,
                                  const GpuIdentity& gpu, const Overrides& overrides, bool must_pass) {
  const LoadedModule module(path);
  if (task.name != module.table().task) {
    throw Error(ExitCode::module_fault, fmt::format("module '{}' computes task '{}', not '{}'", path,
                                                    module.table().task, task.name));
  }
  if (!module.on_device())
    throw Error(ExitCode::usage, fmt::format("'{}' is a host module: only device modules are timed", path));

  const TimingProtocol protocol;
  const bool both = o.sets.size() == 2;
  Progress progress("timing " + id.label, protocol.warmup_calls + 2 * protocol.timed_calls - (both ? 0 : 1));
  progress.note("inputs and truth");
  Side first = make_side(ctx, task, o.sets[0], overrides, true);
  Side second = make_side(ctx, task, both ? o.sets[1] : o.warmup_set, overrides, both);
  std::string suffix;
  for (const auto& [name, value] : overrides) suffix += fmt::format("@{}={:g}", name, value);

  const auto judge_of = [&](const Side& side) {
    return [&task, &side, must_pass](const CallReport& report, const Arrays* earlier) {
      RunResult r;
      judge_call(task, side.set, side.problem, side.truth.empty() ? nullptr : &side.truth, report, earlier,
                 r);
      std::vector<std::string> complaints;
      if (must_pass && r.state != RunState::pass)
        complaints.push_back(fmt::format("{}: {}: {}", side.set.name, to_string(r.state), r.state_detail));
      return complaints;
    };
  };
  const TimedSide timed{&first.problem, judge_of(first)};
  TimedSide other{&second.problem, nullptr};
  if (both) other.judge = judge_of(second);

  const std::unique_ptr<Backend> backend = make_device_backend();
  TimedCalls times;
  try {
    times = time_module(*backend, module, task.contract, timed, other, protocol,
                        [&](const std::string& what) { progress.step(what); });
  } catch (const Error& e) {
    throw Error(e.code(),
                fmt::format("{} {} {}: {}", task.name, id.label + suffix, first.set.name, e.what()));
  }
  std::vector<TimingResult> results;
  const auto keep = [&](const Side& side, const std::vector<double>& milliseconds) {
    results.push_back(timing_result(task.name, id.label + suffix, side.set.name, milliseconds,
                                    compulsory_bytes(task, side.problem), task.target_floor_multiple,
                                    ceilings, gpu));
    results.back().scalar_overrides = overrides;
  };
  keep(first, times.timed);
  if (both) keep(second, times.other);
  return results;
}

// Runs the same measurement in a fresh process (its own context, clocks, memory layout) and reads what it
// found.
TimingResult second_opinion(const Context& ctx, const TimeOptions& o, const ModuleIdentity& id,
                            const std::string& path, const std::string& set, const Overrides& overrides) {
  namespace fs = std::filesystem;
  std::string folder = (fs::temp_directory_path() / "gpuphys-time-XXXXXX").string();
  if (mkdtemp(folder.data()) == nullptr)
    throw Error(ExitCode::internal, fmt::format("cannot create a folder in {}", folder));
  const std::string file = folder + "/second.json";
  std::vector<std::string> words{
      "gpuphys",        "--results",
      ctx.results_root, "--modules",
      ctx.modules_root, "--truth",
      ctx.truth_root,   "time",
      "--task",         o.task,
      "--module",       is_module_path(o.module) ? fs::absolute(path).string() : o.module,
      "--label",        id.label,
      "--set",          set,
      "--warmup-set",   set == o.sets[0] ? o.warmup_set : o.sets[0],
      "--against",      o.against,
      "--confirm-to",   file};
  for (const auto& [name, value] : overrides) {
    words.push_back("--scalar");
    words.push_back(fmt::format("{}={:.17g}", name, value));
  }
  if (o.sweep) words.push_back("--sweep");
  std::vector<char*> arguments;
  for (std::string& w : words) arguments.push_back(w.data());
  arguments.push_back(nullptr);
  // Its own lines would repeat what is printed here from its result; errors stay visible.
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  const int spawned = posix_spawn(&child, "/proc/self/exe", &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  int status = 0;
  if (spawned != 0 || waitpid(child, &status, 0) != child || !WIFEXITED(status) || !fs::exists(file)) {
    fs::remove_all(folder);
    throw Error(ExitCode::crashed, "the second process, which was to confirm a slow timing, did not answer");
  }
  TimingResult r = timing_result_from(nlohmann::json::parse(read_file(file)), "the second process's result");
  fs::remove_all(folder);
  return r;
}

ExitCode exit_code_of(GateState state, bool no_gate, bool skip_unbaselined) {
  switch (state) {
    case GateState::ok:
      return ExitCode::ok;
    case GateState::slow:
      return no_gate ? ExitCode::ok : ExitCode::slow;
    case GateState::unbaselined:
      if (skip_unbaselined) return ExitCode::skipped;
      return no_gate ? ExitCode::ok : ExitCode::unbaselined;
    case GateState::below_floor:
      return ExitCode::below_floor;
  }
  return ExitCode::internal;
}

Ceilings ceilings_from(const std::map<std::string, double>& m) {
  const auto get = [&](const char* name) {
    const auto found = m.find(name);
    return found == m.end() ? std::numeric_limits<double>::quiet_NaN() : found->second;
  };
  return {get("copy_GBps"), get("read_GBps"), get("fp32_TFLOPs"), get("launch_us"), get("l2_MiB")};
}

// The verdict on one measurement, confirmed by a second process where it is SLOW.
void conclude(Context& ctx, const TimeOptions& o, const Task& task, const ModuleIdentity& id,
              const std::string& path, const Ceilings& ceilings, const std::optional<TaskRecord>& record,
              TimingResult result) {
  const std::string suffix = result.label.substr(id.label.size());
  const TimingResult* recorded = nullptr;
  if (record) {
    for (const TimingResult& t : record->timing) {
      if (t.label == o.against + suffix && t.set == result.set) recorded = &t;
    }
  }
  GateAnswer answer = apply_gate(result, ceilings, recorded);
  if (!o.confirm_to.empty()) {
    write_file(o.confirm_to, to_json(result).dump());
    return;
  }
  print_timing(result, answer, "");
  if (answer.state == GateState::slow && !o.no_gate) {
    TimingResult second = second_opinion(ctx, o, id, path, result.set, result.scalar_overrides);
    const GateAnswer again = apply_gate(second, ceilings_from(second.ceilings), recorded);
    print_timing(second, again, "second process: ");
    const GateState both = confirmed_state(answer.state, again.state);
    // Kept is the one that was less disturbed; the verdict is that of both.
    if (second.multiple < result.multiple) result = std::move(second);
    result.gate.state = to_string(both);
    answer.state = both;
    fmt::print("{} {} {}: {} by both processes together\n", task.name, result.label, result.set,
               to_string(both));
  }
  write_result(ctx.results_root, result);
  // A set without a record must not hide that another one is slow.
  const ExitCode code = exit_code_of(answer.state, o.no_gate, o.skip_unbaselined);
  if (ctx.exit_code == ExitCode::ok || ctx.exit_code == ExitCode::skipped)
    ctx.exit_code = code == ExitCode::ok ? ctx.exit_code : code;
  else if (code != ExitCode::skipped)
    ctx.exit_code = std::max(ctx.exit_code, code);
}

void time_once(Context& ctx, const TimeOptions& o, const Task& task, const ModuleIdentity& id,
               const std::string& path, const Ceilings& ceilings, const GpuIdentity& gpu,
               const std::optional<TaskRecord>& record, const Overrides& overrides) {
  // A sweep measures loose settings on purpose; wrong values are then the point, not an error.
  for (TimingResult& result : measure(ctx, o, task, id, path, ceilings, gpu, overrides, overrides.empty()))
    conclude(ctx, o, task, id, path, ceilings, record, std::move(result));
}

void run(Context& ctx, TimeOptions& o) {
  const Task& task = find_task(o.task);
  const GpuIdentity gpu = gpu_identity();  // skips without a GPU, also what this build left out
  const std::string path = ctx.module_path(task.name, o.module);
  const ModuleIdentity id = identify_module(o.module, o.label, task.name, ctx.source_root + "/mutants");
  if (o.against.empty()) o.against = id.label;
  for (const std::string& name : o.sets) task.set(name);
  if (o.sets.size() == 2) {
    if (!o.warmup_set.empty())
      throw Error(ExitCode::usage, "--warmup-set goes with one timed set: two are each other's");
    o.warmup_set = o.sets[1];
  }
  if (o.warmup_set.empty()) o.warmup_set = other_set(task, o.sets[0]);
  task.set(o.warmup_set);
  if (o.warmup_set == o.sets[0])
    throw Error(ExitCode::usage, "--warmup-set must be another input set than the timed one");
  if (o.sweep && !task.knob)
    throw Error(ExitCode::usage, fmt::format("task '{}' has no accuracy knob to sweep", task.name));

  const Ceilings ceilings = measure_ceilings();
  const std::optional<TaskRecord> record = load_record(ctx.records_root(), gpu.slug, task.name);
  const Overrides fixed = parse_scalars(o.scalars);
  // The second process is given one value of the sweep.
  if (!o.sweep || !o.confirm_to.empty()) {
    time_once(ctx, o, task, id, path, ceilings, gpu, record, fixed);
    return;
  }
  // The points of a sweep are material for a plot; the gate watches the default setting.
  TimeOptions ungated = o;
  ungated.no_gate = true;
  for (const double value : task.knob->values) {
    Overrides overrides = fixed;
    overrides[task.knob->scalar] = value;
    time_once(ctx, ungated, task, id, path, ceilings, gpu, record, overrides);
  }
}

}  // namespace

void add_time_command(CLI::App& app, Context& ctx) {
  auto options = std::make_shared<TimeOptions>();
  CLI::App* command =
      app.add_subcommand("time", "Time a device module against the floor and against the record");
  command->add_option("--task", options->task, "Task")->required();
  command
      ->add_option("--module", options->module,
                   "Label of a module built with the suite, or the path of a shared object")
      ->required();
  command
      ->add_option("--set", options->sets,
                   "Input set that is timed; given twice, both are timed in turn (default: public)")
      ->expected(1, 2);
  command->add_option(
      "--warmup-set", options->warmup_set,
      "Input set of the warm-up and of the calls in between (default: the other of the pair)");
  command->add_option("--label", options->label, "Name under which results are kept (default: the module's)");
  command->add_option("--against", options->against,
                      "Label whose record the gate compares with (default: the module's own)");
  command->add_option("--scalar", options->scalars,
                      "Override an accuracy scalar: NAME=NUMBER (repeatable); outputs need not pass then");
  command->add_flag("--sweep", options->sweep, "Time every value of the task's accuracy knob, without gate");
  command->add_flag(
      "--skip-unbaselined", options->skip_unbaselined,
      "End with 77 instead of 11 where there is no record to compare with (CTest: skipped, not passed)");
  command->add_flag("--no-gate", options->no_gate,
                    "Measure for a first or a new record: SLOW and UNBASELINED are said but do not fail");
  command->add_option("--confirm-to", options->confirm_to)->group("");
  command->footer(
      "Five calls are timed, each a fresh solver object with its outputs judged, in turn with calls on "
      "another\n"
      "input set. Exit code 0 when the gate is OK; 10 SLOW, in this process and in a second one; 11 "
      "UNBASELINED,\n"
      "no record of this GPU; 12 BELOW_FLOOR, faster than physically possible; 3 and 4 when an output was "
      "wrong\n"
      "or a rule was broken; 77 without a GPU.\n\n"
      "Examples:\n"
      "  gpuphys time --task advect_rk2 --module reference\n"
      "  gpuphys time --task advect_rk2 --module ./mine.so --against reference\n"
      "  gpuphys time --task poisson_neumann --module reference --sweep\n"
      "  gpuphys time --task advect_rk2 --module reference --set hidden --no-gate\n"
      "  gpuphys time --task advect_rk2 --module reference --set public --set hidden\n");
  command->callback([options, &ctx] { run(ctx, *options); });
}

}  // namespace gpuphys
