// gpuphys list: tasks, input sets, checks and contracts.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/driver/table.hpp"
#include "core/judge/judge.hpp"

namespace gpuphys {
namespace {

using nlohmann::json;

json check_json(const Check& c) {
  return {{"name", c.name},
          {"kind", to_string(c.kind)},
          {"quantity", c.quantity},
          {"norm", c.norm},
          {"tolerance", c.tolerance},
          {"why", c.why},
          {"needs_truth", c.needs_truth}};
}

json array_json(const ArraySpec& a) {
  return {{"name", a.name},
          {"dtype", to_string(a.dtype)},
          {"shape", a.shape},
          {"unit", a.unit},
          {"overwritable", a.access == Access::overwritable}};
}

json task_json(const Task& task, const std::string& mutants_root) {
  json inputs = json::array(), outputs = json::array(), scalars = json::array(), sets = json::array(),
       checks = json::array();
  for (const ArraySpec& a : task.contract.inputs) inputs.push_back(array_json(a));
  for (const ArraySpec& a : task.contract.outputs) outputs.push_back(array_json(a));
  for (const ScalarSpec& s : task.contract.scalars) {
    scalars.push_back({{"name", s.name}, {"dtype", to_string(s.dtype)}, {"unit", s.unit}});
  }
  for (const InputSet& s : task.sets) {
    json invariants = json::array();
    for (const Check& c : s.invariants) invariants.push_back(check_json(c));
    sets.push_back({{"name", s.name},
                    {"kind", to_string(s.kind)},
                    {"size", to_string(s.size)},
                    {"about", s.about},
                    {"uses_task_checks", s.use_task_checks},
                    {"invariants", invariants},
                    {"truth", s.truth_source}});
  }
  for (const Check& c : task.checks) checks.push_back(check_json(c));
  json j = {{"name", task.name},
            {"family", task.family},
            {"title", task.title},
            {"paper_number", task.paper_number},
            {"target_floor_multiple", task.target_floor_multiple},
            {"inputs", inputs},
            {"scalars", scalars},
            {"outputs", outputs},
            {"sets", sets},
            {"checks", checks},
            {"mutants", planted_faults(mutants_root, task.name)}};
  if (task.knob) j["knob"] = {{"scalar", task.knob->scalar}, {"values", task.knob->values}};
  return j;
}

void print_details(const Task& task, const std::string& mutants_root) {
  fmt::print("{}  ({}, number {} of the paper)\n  {}\n  specification: cases/{}/{}.md\n\n", task.name,
             task.family, task.paper_number, task.title, task.family, task.name);
  Table contract({"contract", "name", "type", "shape (C order)", "unit", ""});
  for (const ArraySpec& a : task.contract.inputs) {
    contract.add({"input", a.name, to_string(a.dtype), "(" + a.shape + ")", a.unit,
                  a.access == Access::overwritable ? "may be overwritten" : ""});
  }
  for (const ScalarSpec& s : task.contract.scalars)
    contract.add({"scalar", s.name, to_string(s.dtype), "", s.unit, ""});
  for (const ArraySpec& a : task.contract.outputs) {
    contract.add({"output", a.name, to_string(a.dtype), "(" + a.shape + ")", a.unit, ""});
  }
  fmt::print("{}\n", contract.text());
  Table sets({"input set", "kind", "size", "about"});
  for (const InputSet& s : task.sets) sets.add({s.name, to_string(s.kind), to_string(s.size), s.about});
  fmt::print("{}\n", sets.text());
  // Hard cases often share an invariant: it is shown once, with all of them.
  struct Shown {
    const Check* check;
    std::vector<std::string> sets;
  };
  std::vector<Shown> shown;
  const auto show = [&](const Check& c, const std::string& set) {
    for (Shown& s : shown) {
      if (s.check->name == c.name && s.check->tolerance == c.tolerance && s.check->why == c.why &&
          s.check->norm == c.norm) {
        s.sets.push_back(set);
        return;
      }
    }
    shown.push_back({&c, {set}});
  };
  for (const Check& c : task.checks) show(c, "");
  for (const InputSet& s : task.sets) {
    for (const Check& c : s.invariants) show(c, s.name);
  }
  for (const Shown& s : shown) {
    fmt::print("check {} ({}): {}; {} <= {:g}\n", s.check->name, to_string(s.check->kind), s.check->quantity,
               s.check->norm, s.check->tolerance);
    if (!s.sets.front().empty()) fmt::print("    on {}\n", fmt::join(s.sets, ", "));
    fmt::print("    why: {}\n", s.check->why);
  }
  fmt::print("\n");
  if (task.knob) {
    fmt::print("accuracy knob: {} in {}\n", task.knob->scalar, fmt::join(task.knob->values, ", "));
  }
  fmt::print("mutants: {}\n", fmt::join(planted_faults(mutants_root, task.name), ", "));
}

}  // namespace

void add_list_command(CLI::App& app, Context& ctx) {
  struct Options {
    std::string task;
    bool as_json = false;
  };
  auto o = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand(
      "list", "List tasks, or everything about one: contract, input sets, checks, mutants");
  command->add_option("--task", o->task, "Show one task in full");
  command->add_flag("--json", o->as_json, "Write JSON");
  command->footer(
      "Examples:\n"
      "  gpuphys list\n"
      "  gpuphys list --task poisson_neumann\n"
      "  gpuphys list --json | jq '.[].name'\n");
  command->callback([o, &ctx] {
    const std::string mutants_root = ctx.source_root + "/mutants";
    const std::vector<const Task*> tasks =
        select_tasks(o->task.empty() ? std::vector<std::string>{} : std::vector<std::string>{o->task});
    if (o->as_json) {
      json all = json::array();
      for (const Task* t : tasks) all.push_back(task_json(*t, mutants_root));
      fmt::print("{}\n", (o->task.empty() ? all : all.front()).dump(2));
      return;
    }
    if (!o->task.empty()) return print_details(*tasks.front(), mutants_root);
    Table table({">no", "task", "family", ">sets", ">checks", ">mutants", "title"});
    for (const Task* t : tasks) {
      table.add({std::to_string(t->paper_number), t->name, t->family, std::to_string(t->sets.size()),
                 std::to_string(t->checks.size()),
                 std::to_string(planted_faults(mutants_root, t->name).size()), t->title});
    }
    fmt::print("{}", table.text());
  });
}

}  // namespace gpuphys
