// gpuphys ctest-file: writes the CTest cases of every task. Run after the driver is built, so that tasks,
// input sets and mutants are declared in one place only.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/files.hpp"
#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/records/labels.hpp"

namespace gpuphys {
namespace {

struct CTestOptions {
  std::string output, driver, sanitizer;
};

struct TestCase {
  std::string name;
  std::vector<std::string> command;
  std::vector<std::string> labels;
  int timeout_s = 120;
  bool serial = false;
  int memory_slots = 0;  // of kSlotBytes
  std::string fixture_setup, fixture_needed;
};

// CTest shares out memory in pieces of this size (ci/lane writes how many the machine has).
constexpr double kSlotBytes = 256.0 * (1 << 20);
// The driver's own limit for one set; CTest's is longer by far, so that it is always the driver that tells.
constexpr int kSetSeconds = 60, kBeyondSeconds = 300;

// Arguments and names are file names and identifiers; brackets keep CMake from interpreting anything in them.
std::string quoted(const std::string& text) {
  return "[==[" + text + "]==]";
}

std::string cmake_text(const TestCase& test) {
  std::vector<std::string> command;
  for (const std::string& word : test.command) command.push_back(quoted(word));
  std::string text = fmt::format("add_test({} {})\n", quoted(test.name), fmt::join(command, " "));
  std::string more;
  if (test.serial) more += " RUN_SERIAL TRUE";
  if (test.memory_slots > 0) more += fmt::format(" RESOURCE_GROUPS \"memory:{}\"", test.memory_slots);
  if (!test.fixture_setup.empty()) more += fmt::format(" FIXTURES_SETUP {}", test.fixture_setup);
  if (!test.fixture_needed.empty()) more += fmt::format(" FIXTURES_REQUIRED {}", test.fixture_needed);
  text += fmt::format("set_tests_properties({} PROPERTIES LABELS \"{}\" TIMEOUT {} SKIP_RETURN_CODE 77{})\n",
                      quoted(test.name), fmt::join(test.labels, ";"), test.timeout_s, more);
  return text;
}

class Writer {
 public:
  Writer(const Context& ctx, const CTestOptions& options, const Task& task)
      : ctx_(ctx), o_(options), task_(task) {}

  std::vector<TestCase> cases() {
    const Expectation expected = expectation_of(task_, ctx_.source_root);
    const std::vector<std::string> smoke = sets(Size::smoke, false), paper = sets(Size::paper, false),
                                   hard = sets(Size::smoke, true);
    for (const char* label : {"baseline_f32", "baseline_f32_fma"}) {
      judged(label, "", label, smoke, {label, "cpu", "smoke", "validation"});
      judged(label, "hard", label, hard, {label, "cpu", "smoke", "hard", "validation"});
    }
    if (!task_.unordered.empty())
      judged("baseline_f32", "permuted", "baseline_f32", smoke, {"ensemble", "cpu", "smoke", "validation"},
             {"--label", "baseline_f32.permuted", "--permute", "1"});
    for (const std::string& fault : expected.serial_mutants) mutant("serial_mutant", fault, "cpu", smoke);
    add("trivial", "", {"trivial", "--task", task_.name}, {"trivial", "cpu", "smoke"}, kBeyondSeconds);
    add("record", "", {"check-records", "--task", task_.name, "--skip-missing"}, {"record", "cpu"},
        4 * kBeyondSeconds);
    cases_.back().memory_slots = slots(paper);

    // Without a GPU these are listed all the same, and skip one by one.
    add("prepare", "", {"prepare", "--task", task_.name, "--for-gpu"}, {"prepare", "gpu", "paper"},
        4 * kBeyondSeconds);
    cases_.back().memory_slots = 2 * slots(paper);
    cases_.back().fixture_setup = task_.name + "_paper";
    for (const char* label : {"reference", "fmad"}) {
      std::vector<std::string> labels{label, "gpu", "paper", "validation"};
      if (is_canary() && std::string(label) == "reference") labels.push_back("canary");
      on_paper(label, "", label, paper, labels);
      judged(label, "hard", label, hard, {label, "gpu", "smoke", "hard", "validation"});
    }
    for (const auto& [label, its_sets] : expected.gpu_ensemble) {
      std::vector<std::string> more;
      const std::string module = module_of(label);
      if (label != module) more = {"--label", label};
      if (label.ends_with(".permuted")) more.insert(more.end(), {"--permute", "1"});
      on_paper("ensemble", label.substr(label.find('.') + 1), module, its_sets,
               {"ensemble", "gpu", "paper", "validation"}, more);
    }
    for (const std::string& fault : expected.mutants) mutant("mutant", fault, "gpu", paper);
    if (task_.knob) on_paper("sweep", "", "reference", {"public"}, {"sweep", "gpu", "paper"}, {"--sweep"});
    // The reference as the paper measures it; variants in one process each.
    std::vector<std::string> timed{"time",     "--task",    task_.name,
                                   "--module", "reference", "--skip-unbaselined"};
    for (const std::string& set : paper) timed.insert(timed.end(), {"--set", set});
    time("reference", timed);
    std::vector<std::string> variants{"fmad", kFastMath};
    if (offers_other_blocks(task_, ctx_.source_root)) variants.push_back(kOtherBlocks);
    for (const std::string& label : variants)
      time(label, {"time", "--task", task_.name, "--module", label, "--one-process", "--skip-unbaselined"});
    if (task_.knob) time("sweep", {"time", "--task", task_.name, "--module", "reference", "--sweep"});
    if (!o_.sanitizer.empty()) {
      for (const char* tool : {"memcheck", "racecheck", "initcheck"}) {
        // The tool's own exit code when it finds something; the checks must pass under it as well.
        TestCase test =
            make("sanitizer", tool,
                 {"run", "--task", task_.name, "--module", "reference", "--set", "public_smoke", "--label",
                  fmt::format("sanitized_{}", tool), "--under-tool", "--timeout", "500"},
                 {"sanitizer", "gpu", "smoke"}, 600);
        std::vector<std::string> wrapped{o_.sanitizer, fmt::format("--tool={}", tool), "--error-exitcode=9",
                                         "--target-processes=all"};
        wrapped.insert(wrapped.end(), test.command.begin(), test.command.end());
        test.command = wrapped;
        cases_.push_back(test);
      }
    }
    return std::move(cases_);
  }

 private:
  std::vector<std::string> sets(Size size, bool hard) const {
    std::vector<std::string> names;
    for (const InputSet& set : task_.sets) {
      if (set.size == size && (set.kind == SetKind::hard) == hard) names.push_back(set.name);
    }
    return names;
  }

  // The first task of its family stands for the harness when that is recorded.
  bool is_canary() const {
    return std::none_of(all_tasks().begin(), all_tasks().end(), [&](const Task& t) {
      return t.family == task_.family && t.paper_number < task_.paper_number;
    });
  }

  // What a run on the largest of these sets takes, by the committed records; 4 GiB where none knows the set.
  int slots(const std::vector<std::string>& names) const {
    constexpr double kOwnBytes = 0.75 * 1024 * (1 << 20), kUnknownBytes = 4.0 * 1024 * (1 << 20);
    double most = 0;
    for (const std::string& name : names) {
      double bytes = task_.set(name).size == Size::paper ? kUnknownBytes : 0;
      for (const std::string& gpu : recorded_gpus(ctx_.records_root())) {
        try {
          const std::optional<TaskRecord> record = load_record(ctx_.records_root(), gpu, task_.name);
          if (record && record->sets.contains(name)) bytes = record->sets.at(name).bytes;
        } catch (const Error&) {
          // check-records names it
        }
      }
      most = std::max(most, bytes);
    }
    return static_cast<int>(std::ceil((most + kOwnBytes) / kSlotBytes));
  }

  TestCase make(const std::string& kind, const std::string& detail, std::vector<std::string> arguments,
                std::vector<std::string> labels, int timeout_s) {
    TestCase test;
    test.name = detail.empty() ? fmt::format("{}.{}", task_.name, kind)
                               : fmt::format("{}.{}.{}", task_.name, kind, detail);
    test.command.push_back(o_.driver);
    test.command.insert(test.command.end(), arguments.begin(), arguments.end());
    test.labels = {task_.name, task_.family};
    test.labels.insert(test.labels.end(), labels.begin(), labels.end());
    test.timeout_s = timeout_s;
    return test;
  }

  void add(const std::string& kind, const std::string& detail, std::vector<std::string> arguments,
           std::vector<std::string> labels, int timeout_s, bool serial = false) {
    cases_.push_back(make(kind, detail, std::move(arguments), std::move(labels), timeout_s));
    cases_.back().serial = serial;
  }

  // One module on its sets.
  void judged(const std::string& kind, const std::string& detail, const std::string& module,
              const std::vector<std::string>& names, const std::vector<std::string>& labels,
              const std::vector<std::string>& more = {}) {
    if (names.empty()) return;
    std::vector<std::string> arguments{
        "run", "--task", task_.name, "--module", module, "--timeout", std::to_string(kSetSeconds)};
    for (const std::string& name : names) arguments.insert(arguments.end(), {"--set", name});
    arguments.insert(arguments.end(), more.begin(), more.end());
    const int variations = task_.knob && kind == "sweep" ? static_cast<int>(task_.knob->values.size()) : 1;
    add(kind, detail, arguments, labels,
        kSetSeconds * variations * static_cast<int>(names.size()) + kBeyondSeconds);
    cases_.back().memory_slots = slots(names);
  }

  void on_paper(const std::string& kind, const std::string& detail, const std::string& module,
                const std::vector<std::string>& names, const std::vector<std::string>& labels,
                const std::vector<std::string>& more = {}) {
    judged(kind, detail, module, names, labels, more);
    cases_.back().fixture_needed = task_.name + "_paper";
  }

  // It must be caught on each of these sets.
  void mutant(const std::string& kind, const std::string& fault, const std::string& lane,
              const std::vector<std::string>& names) {
    judged(kind, fault, kind + "." + fault, names,
           {kind, "mutants", lane, lane == "gpu" ? "paper" : "smoke", "validation"}, {"--expect", "killed"});
    if (lane == "gpu") cases_.back().fixture_needed = task_.name + "_paper";
  }

  void time(const std::string& detail, const std::vector<std::string>& arguments) {
    add("time", detail, arguments, {"time", "gpu", "paper"}, 900, true);
    cases_.back().fixture_needed = task_.name + "_paper";
  }

  const Context& ctx_;
  const CTestOptions& o_;
  const Task& task_;
  std::vector<TestCase> cases_;
};

}  // namespace

void add_ctest_file_command(CLI::App& app, Context& ctx) {
  auto options = std::make_shared<CTestOptions>();
  CLI::App* command =
      app.add_subcommand("ctest-file", "Write the CTest cases of every task (used by the build)");
  command->add_option("--output", options->output, "File to write")->required();
  command->add_option("--driver", options->driver, "Path of this program as the tests should call it")
      ->required();
  command->add_option("--sanitizer", options->sanitizer, "compute-sanitizer, if there is one");
  command->callback([options, &ctx] {
    std::string text = "# Written by `gpuphys ctest-file`; do not edit.\n";
    for (const Task& task : all_tasks()) {
      for (const TestCase& test : Writer(ctx, *options, task).cases()) text += cmake_text(test);
    }
    write_file(options->output, text);
  });
}

}  // namespace gpuphys
