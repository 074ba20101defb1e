// gpuphys prepare and store: inputs and truths, made before they are needed, and where they are kept.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/judge/judge.hpp"

namespace gpuphys {

void add_prepare_command(CLI::App& app, Context& ctx) {
  struct Options {
    std::vector<std::string> tasks, sets;
    bool for_gpu = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("prepare", "Make inputs and FP64 truth of input sets, for later runs to map");
  command->add_option("--task", o->tasks, "Task (repeatable; default: all)");
  command->add_option("--set", o->sets, "Input set (repeatable; default: all of paper size)");
  command->add_flag("--for-gpu", o->for_gpu,
                    "Skip (exit code 77) where there is no GPU that would need them");
  command->footer(
      "Runs make what they need themselves; this makes it before, once for many runs at the same time.\n\n"
      "Examples:\n"
      "  gpuphys prepare --task advect_rk2\n"
      "  gpuphys prepare --task advect_rk2 --set public_smoke --set hidden_smoke\n");
  command->callback([o, &ctx] {
    if (o->for_gpu) Runner(ctx.runner_options(60), "/dev/null").identify();
    for (const Task* task : select_tasks(o->tasks)) {
      std::vector<const InputSet*> sets;
      for (const std::string& name : o->sets) sets.push_back(&task->set(name));
      for (const InputSet& set : task->sets) {
        if (o->sets.empty() && set.size == Size::paper) sets.push_back(&set);
      }
      for (const InputSet* set : sets) {
        const Prepared p = prepare(ctx.workplace(), *task, *set, wants_truth(*task, *set));
        fmt::print("{} {}: inputs {:.12}, truth {:.12}\n", task->name, set->name, p.inputs_digest,
                   p.truth_digest.empty() ? "none" : p.truth_digest);
      }
    }
  });
}

void add_modules_command(CLI::App& app, Context& ctx) {
  auto stale_only = std::make_shared<bool>(false);
  auto tasks = std::make_shared<std::vector<std::string>>();
  CLI::App* command =
      app.add_subcommand("modules", "Say which built modules are of the present sources and flags");
  command->add_option("--task", *tasks, "Task (repeatable; default: all)");
  command->add_flag("--stale", *stale_only, "Only those that are missing or of other sources or flags");
  command->footer("Examples:\n  gpuphys modules --task advect_rk2\n  gpuphys modules --stale\n");
  command->callback([stale_only, tasks, &ctx] {
    for (const Task* task : select_tasks(*tasks)) {
      for (const auto& [label, expected] : expected_stamps(ctx, *task)) {
        const std::string path = fmt::format("{}/{}/{}.so", ctx.modules_root, task->name, label);
        const bool there = std::filesystem::exists(path);
        const ModuleStamp stamp = there ? ctx.stamp_of(path) : ModuleStamp{};
        const bool current = stamp.sources == expected.sources && stamp.flags == expected.flags;
        if (current && *stale_only) continue;
        fmt::print("{} {}: {}\n", task->name, label,
                   current ? "current"
                   : there ? "of other sources or flags"
                           : "not built");
      }
    }
  });
}

void add_store_command(CLI::App& app, Context& ctx) {
  auto clear = std::make_shared<bool>(false);
  CLI::App* command = app.add_subcommand("store", "Say how much made inputs and truths take, or remove them");
  command->add_flag("--clear", *clear, "Remove them, in memory and on disk");
  command->footer("Examples:\n  gpuphys store\n  gpuphys store --clear\n");
  command->callback([clear, &ctx] {
    const Store store(ctx.store_root);
    if (*clear) store.clear();
    const auto [memory, disk] = store.size();
    fmt::print("{}: {} MiB\n{}: {} MiB\n", memory_store_root(), memory >> 20, ctx.store_root, disk >> 20);
  });
}

}  // namespace gpuphys
