// What the suite knows about a task: its contract, input sets, checks, hard cases and cost model. One
// function per task, make_task() in cases/<family>/<task>.cpp, returns it; nothing else lists a task's
// properties.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"
#include "core/contract/contract.hpp"

namespace gpuphys {

enum class SetKind { open, hidden, hard };  ///< `open` is the paper's public input set
enum class Size { smoke, paper };

std::string to_string(SetKind);  ///< "public", "hidden", "hard"
std::string to_string(Size);

/// What a check looks at.
struct Judged {
  const Problem& problem;  ///< the inputs as generated (before the module saw them)
  const Arrays& outputs;   ///< what the module returned
  const Arrays* truth;     ///< FP64 truth, null when the check does not need it
};

/// What a check found. `error` is compared with the tolerance; NaN or infinity never pass.
struct Measured {
  double error = 0;
  std::string detail;  ///< e.g. "worst at ux[255,255,255]: got 1.2, expected 0.9"
};

enum class CheckKind {
  paper,      ///< quantity, norm and tolerance of the paper's table
  local,      ///< the suite's own: the largest single error, for faults that a global norm forgives
  invariant,  ///< a property that a hard case must keep
};
std::string to_string(CheckKind);

struct Check {
  std::string name;  ///< unique within the task, snake_case: "ux_rel_l2"
  CheckKind kind;
  std::string quantity;  ///< what is compared, for people
  std::string norm;
  double tolerance;
  std::string why;  ///< where the tolerance comes from
  bool needs_truth;
  std::function<Measured(const Judged&)> measure;
};

/// One set of inputs at one size.
struct InputSet {
  std::string name;  ///< "public", "hidden", "public_smoke", "hidden_smoke", "hard_<what it stresses>"
  SetKind kind;
  Size size;
  std::string about;  ///< what it is, and for hard cases what it stresses
  std::function<Problem()> make;
  bool use_task_checks = true;    ///< false when the task's own checks are meaningless here
  std::vector<Check> invariants;  ///< hard cases: what must hold besides
  /// A solution known without the baseline (a manufactured one), where the baseline cannot run; empty
  /// otherwise.
  std::function<Arrays(const Problem&)> known_solution = nullptr;
  std::string truth_source = "serial FP64 baseline";
};

/// A hard case, called hard_<stress>, of smoke size.
InputSet hard_case(const std::string& stress, const std::string& about, std::function<Problem()> make,
                   std::vector<Check> invariants = {}, bool use_task_checks = true);

/// A scalar input that trades accuracy for speed, swept for the speed-against-error report.
struct AccuracyKnob {
  std::string scalar;
  std::vector<double> values;
};

/// A shape symbol along which the order of items carries no meaning (particles, springs, edges). The suite
/// judges the reference on permuted inputs too; its outputs are put back in order first.
struct Unordered {
  std::string symbol;                     ///< "n": permutes every array whose first extent is n
  std::vector<std::string> index_arrays;  ///< int32 inputs whose entries count along `symbol`; renumbered
};

struct Task {
  std::string name, family, title;
  int paper_number = 0;
  Contract contract;
  std::vector<InputSet> sets;
  std::vector<Check> checks;
  std::optional<AccuracyKnob> knob;
  std::vector<Unordered> unordered;  ///< empty where the order of items means something
  double target_floor_multiple = 0;  ///< the speed target: time over compulsory-traffic time on the H200

  const InputSet& set(const std::string& name) const;  ///< throws Error(unknown_name) listing what exists
};

/// Bytes that any implementation must move: each input read once, each output written once.
double compulsory_bytes(const Task&, const Problem&);

/// The checks that apply to a set: the task's (if used there) and the set's invariants.
std::vector<Check> checks_of(const Task&, const InputSet&);

/// All tasks, in the order of the paper's table. Generated from the calls of gpuphys_add_task().
const std::vector<Task>& all_tasks();
const Task& find_task(const std::string& name);  ///< throws Error(unknown_name) with the nearest names

}  // namespace gpuphys
