// gpuphys ctest-file: writes the CTest cases of every task. Run after the driver is built, so that tasks,
// input sets and mutants are declared in one place only.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/files.hpp"
#include "core/task.hpp"

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
};

// Arguments and names are file names and identifiers; brackets keep CMake from interpreting anything in them.
std::string quoted(const std::string& text) {
  return "[==[" + text + "]==]";
}

std::string cmake_text(const TestCase& test) {
  std::vector<std::string> command;
  for (const std::string& word : test.command) command.push_back(quoted(word));
  std::string text = fmt::format("add_test({} {})\n", quoted(test.name), fmt::join(command, " "));
  text += fmt::format("set_tests_properties({} PROPERTIES LABELS \"{}\" TIMEOUT {} SKIP_RETURN_CODE 77{})\n",
                      quoted(test.name), fmt::join(test.labels, ";"), test.timeout_s,
                      test.serial ? " RUN_SERIAL TRUE" : "");
  return text;
}

class Writer {
 public:
  Writer(const Context& ctx, const CTestOptions& options, const Task& task)
      : ctx_(ctx), o_(options), task_(task) {}

  std::vector<TestCase> cases() {
    const Expectation expected = expectation_of(task_, ctx_.source_root);
    for (const char* label : {"baseline_f32", "baseline_f32_fma"}) {
      for (const InputSet& set : task_.sets) {
        if (set.size == Size::smoke) judged(label, "cpu", set);
      }
    }
    for (const std::string& fault : expected.serial_mutants)
      mutant("serial_mutant", fault, "cpu", Size::smoke);
    add("trivial", "", {"trivial", "--task", task_.name}, {"trivial", "cpu", "smoke"}, 120);
    add("record", "", {"check-records", "--task", task_.name}, {"record", "cpu"}, 60);

    // Without a GPU these are listed all the same, and skip one by one.
    for (const char* label : {"reference", "fmad"}) {
      for (const InputSet& set : task_.sets) judged(label, "gpu", set);
    }
    ensemble(expected);
    for (const std::string& fault : expected.mutants) mutant("mutant", fault, "gpu", Size::paper);
    if (task_.knob) {
      add("sweep", "", {"run", "--task", task_.name, "--module", "reference", "--set", "public", "--sweep"},
          {"sweep", "gpu", "paper"}, 300);
    }
    // Both sets of paper size in one process, where each is the other's alternate.
    std::vector<std::string> timed{"time",     "--task",    task_.name,
                                   "--module", "reference", "--skip-unbaselined"};
    for (const InputSet& set : task_.sets) {
      if (set.size == Size::paper) timed.insert(timed.end(), {"--set", set.name});
    }
    add("time", "reference", timed, {"time", "gpu", "paper"}, 300, true);
    add("time", "fmad", {"time", "--task", task_.name, "--module", "fmad", "--skip-unbaselined"},
        {"time", "gpu", "paper"}, 300, true);
    if (task_.knob) {
      add("time", "sweep", {"time", "--task", task_.name, "--module", "reference", "--sweep"},
          {"time", "gpu", "paper"}, 600, true);
    }
    if (!o_.sanitizer.empty()) {
      for (const char* tool : {"memcheck", "racecheck", "initcheck"}) {
        // The tool's own exit code when it finds something; the checks must pass under it as well.
        TestCase test = make(fmt::format("sanitizer.{}", tool), "public_smoke",
                             {"run", "--task", task_.name, "--module", "reference", "--set", "public_smoke",
                              "--label", fmt::format("sanitized_{}", tool), "--under-tool"},
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

  void judged(const std::string& label, const std::string& lane, const InputSet& set) {
    std::vector<std::string> labels{label, lane, to_string(set.size)};
    if (set.kind == SetKind::hard) labels.push_back("hard");
    labels.push_back("validation");
    add(label, set.name, {"run", "--task", task_.name, "--module", label, "--set", set.name}, labels, 300);
  }

  // Correct runs that round differently: another order of the items, other blocks, the same again.
  void ensemble(const Expectation& expected) {
    for (const auto& [label, sets] : expected.gpu_ensemble) {
      for (const std::string& set : sets) {
        const bool permuted = label.ends_with(".permuted");
        const std::string module = label.substr(0, label.find('.'));
        std::vector<std::string> arguments{"run",   "--task", task_.name, "--module", module,
                                           "--set", set,      "--label",  label};
        if (permuted) {
          arguments.push_back("--permute");
          arguments.push_back("1");
        }
        add(label, set, arguments, {"ensemble", "gpu", "paper", "validation"}, 300);
      }
    }
    if (task_.unordered.empty()) return;
    for (const InputSet& set : task_.sets) {
      if (set.size != Size::smoke || set.kind == SetKind::hard) continue;
      add("baseline_f32.permuted", set.name,
          {"run", "--task", task_.name, "--module", "baseline_f32", "--set", set.name, "--label",
           "baseline_f32.permuted", "--permute", "1"},
          {"ensemble", "cpu", "smoke", "validation"}, 120);
    }
  }

  // One test a mutant: it must be caught on the public and on the hidden inputs of the size.
  void mutant(const std::string& kind, const std::string& fault, const std::string& lane, Size size) {
    std::vector<std::string> arguments{"run",      "--task", task_.name, "--module", kind + "." + fault,
                                       "--expect", "killed"};
    for (const InputSet& set : task_.sets) {
      if (set.size == size && set.kind != SetKind::hard) {
        arguments.push_back("--set");
        arguments.push_back(set.name);
      }
    }
    add(kind, fault, arguments, {kind, "mutants", lane, to_string(size), "validation"}, 300);
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
