// gpuphys trivial: outputs that need no computation must fail every task.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstring>
#include <memory>

#include "core/base/host_info.hpp"
#include "core/driver/context.hpp"
#include "core/judge/judge.hpp"

namespace gpuphys {
namespace {

// float32 outputs holding the values of `source` where the sizes agree; zeros elsewhere.
Arrays outputs_holding(const Task& task, const Problem& problem, const Arrays& source) {
  Arrays outputs = make_outputs(task.contract, problem);
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    for (const HostArray& s : source) {
      const bool by_name = s.name() == outputs[i].name();
      if (s.size() != outputs[i].size() || (!by_name && &s != &source.front())) continue;
      const auto out = outputs[i].as<float>();
      for (std::int64_t e = 0; e < s.size(); ++e)
        out[static_cast<std::size_t>(e)] = static_cast<float>(s.value(e));
      if (by_name) break;
    }
  }
  return outputs;
}

void run(Context& ctx, const std::string& name) {
  const Task& task = find_task(name);
  const InputSet& set = task.set("public_smoke");
  const Prepared inputs = prepare(ctx.workplace(), task, set, true);
  const Problem& problem = inputs.problem;
  const Arrays& truth = inputs.truth;
  const Prepared other = prepare(ctx.workplace(), task, task.set("hidden_smoke"), true);
  const Arrays& other_truth = other.truth;

  struct Attempt {
    std::string label, about;
    Arrays outputs;
  };
  std::vector<Attempt> attempts;
  attempts.push_back({"zeros", "all zeros", make_outputs(task.contract, problem)});
  attempts.push_back(
      {"input_copied", "inputs copied to the outputs", outputs_holding(task, problem, problem.inputs)});
  // The answer to other inputs, as a module that returns its previous call's output would give it.
  Arrays stale = make_outputs(task.contract, problem);
  for (HostArray& out : stale) {
    const HostArray& from = find(other_truth, out.name(), "truth");
    for (std::int64_t e = 0; e < std::min(out.size(), from.size()); ++e) {
      out.as<float>()[static_cast<std::size_t>(e)] = static_cast<float>(from.value(e));
    }
  }
  attempts.push_back({"previous_output", "the answer to the hidden inputs", std::move(stale)});
  // And the truth itself, rounded: if that failed, the others would prove nothing.
  attempts.push_back({"truth", "the rounded FP64 truth", outputs_holding(task, problem, truth)});

  for (Attempt& attempt : attempts) {
    RunResult result;
    result.task = task.name;
    CallReport report;
    report.outputs = std::move(attempt.outputs);
    judge_call(task, set, problem, &truth, report, nullptr, result);
    const bool right = (result.state == RunState::pass) == (attempt.label == "truth");
    const CheckResult* worst = result.worst_check();
    fmt::print("{} {}: {} ({} at {:.3g} times its tolerance){}\n", task.name, attempt.about,
               result.state == RunState::pass ? "accepted" : "rejected", worst->name, worst->ratio,
               right ? "" : "  <-- WRONG");
    if (!right) ctx.exit_code = ExitCode::check_failed;
  }
}

}  // namespace

void add_trivial_command(CLI::App& app, Context& ctx) {
  auto task = std::make_shared<std::string>();
  CLI::App* command =
      app.add_subcommand("trivial", "Try outputs that need no computation: each must be rejected");
  command->add_option("--task", *task, "Task")->required();
  command->footer(
      "Tries zeros, the inputs copied, and the answer to other inputs on the public smoke set; the rounded\n"
      "FP64 truth must be accepted.\n\nExample:\n  gpuphys trivial --task advect_rk2\n");
  command->callback([task, &ctx] { run(ctx, *task); });
}

}  // namespace gpuphys
