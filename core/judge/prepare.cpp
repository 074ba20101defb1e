#include "core/judge/prepare.hpp"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>
#include <optional>

#include "core/base/files.hpp"
#include "core/base/parallel.hpp"
#include "core/base/progress.hpp"
#include "core/base/sha256.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

std::string digest_of_file(const std::string& path) {
  return sha256_hex(read_file(path)).substr(0, 16);
}

// Inputs are this program's doing.
const std::string& own_digest() {
  static const std::string digest = digest_of_file("/proc/self/exe");
  return digest;
}

Arrays computed_truth(const Workplace& place, const Task& task, const InputSet& set, const Problem& problem) {
  if (set.known_solution) return set.known_solution(problem);
  const std::string who = fmt::format("FP64 baseline of '{}' on '{}'", task.name, set.name);
  Progress progress(fmt::format("computing the {}", who), 0);
  try {
    Runner runner(place.runner, place.baseline_of(task));
    runner.load(GpuUse::no);
    if (runner.task() != task.name || runner.output_real() != DType::f64 || runner.on_device()) {
      throw Error(ExitCode::module_fault, fmt::format("'{}' is not the FP64 host baseline of '{}'",
                                                      place.baseline_of(task), task.name));
    }
    CallReport report = runner.call(task.contract, problem, {});
    if (!report.faults.empty()) {
      const FaultReport& f = report.faults.front();
      throw Error(ExitCode::module_fault, fmt::format("{}: {} ({})", who, to_string(f.fault), f.detail));
    }
    return std::move(report.outputs);
  } catch (const RunnerLost& lost) {
    throw Error(ExitCode::crashed, fmt::format("{}: {}", who, lost.what()));
  }
}

void require_usable(const Arrays& truth, const Task& task, const InputSet& set, const Problem& problem) {
  const auto symbols = resolve_symbols(task.contract, problem, "inputs");
  for (const ArraySpec& spec : task.contract.outputs) {
    const std::string where = fmt::format("truth of '{}' on '{}'", task.name, set.name);
    const HostArray& a = find(truth, spec.name, where);
    if (a.shape() != evaluate_shape(spec, symbols)) {
      throw Error(ExitCode::module_fault,
                  fmt::format("{}: array '{}' has shape {}, expected {}", where, spec.name,
                              to_string(a.shape()), to_string(evaluate_shape(spec, symbols))));
    }
    parallel_pieces(a.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        if (!std::isfinite(a.value(i))) {
          throw Error(ExitCode::module_fault,
                      fmt::format("{}: array '{}' is not finite at flat index {}", where, spec.name, i));
        }
      }
    });
  }
}

// In the contract's order; values that float32 holds exactly (a task that only moves data) take half the
// room.
Arrays as_stored(Arrays truth, const Task& task) {
  Arrays stored;
  for (const ArraySpec& spec : task.contract.outputs) {
    for (HostArray& a : truth) {
      if (a.name() != spec.name) continue;
      std::vector<char> inexact(static_cast<std::size_t>(pieces_of(a.size())), 0);
      if (a.dtype() == DType::f64) {
        parallel_pieces(a.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
          for (std::int64_t i = begin; i < end; ++i) {
            const double v = a.value(i);
            if (static_cast<double>(static_cast<float>(v)) == v) continue;
            inexact[static_cast<std::size_t>(piece)] = 1;
            return;
          }
        });
      }
      if (a.dtype() != DType::f64 || std::count(inexact.begin(), inexact.end(), 1) > 0) {
        stored.push_back(std::move(a));
        break;
      }
      HostArray narrow(a.name(), DType::f32, a.shape(), a.unit());
      const auto values = narrow.as<float>();
      parallel_pieces(a.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i)
          values[static_cast<std::size_t>(i)] = static_cast<float>(a.value(i));
      });
      stored.push_back(std::move(narrow));
      break;
    }
  }
  return stored;
}

void add_truth(const Workplace& place, const Store& store, const Task& task, const InputSet& set,
               Prepared& p) {
  if (!set.known_solution && !fs::exists(place.baseline_of(task))) {
    throw Error(ExitCode::unknown_name,
                fmt::format("the FP64 baseline module '{}' does not exist", place.baseline_of(task)));
  }
  const std::string source = set.known_solution ? own_digest() : digest_of_file(place.baseline_of(task));
  Stored stored = store.obtain(
      task.name, fmt::format("{}.truth-{}-{}", set.name, p.inputs_digest.substr(0, 16), source), [&] {
        Arrays truth = computed_truth(place, task, set, p.problem);
        require_usable(truth, task, set, p.problem);
        return Stored{as_stored(std::move(truth), task), {}, ""};
      });
  p.truth = std::move(stored.arrays);
  p.truth_digest = stored.digest;
}

}  // namespace

std::string Workplace::baseline_of(const Task& task) const {
  return fmt::format("{}/{}/baseline_f64.so", modules_root, task.name);
}

Prepared prepare(const Workplace& place, const Task& task, const InputSet& set, bool with_truth) {
  const Store store(place.store_root);
  Stored stored = store.obtain(task.name, fmt::format("{}.inputs-{}", set.name, own_digest()), [&] {
    Progress progress(fmt::format("making the inputs of '{}' {}", task.name, set.name), 0);
    Problem problem = set.make();
    return Stored{std::move(problem.inputs), std::move(problem.scalars), ""};
  });
  Prepared p;
  p.problem.inputs = std::move(stored.arrays);
  p.problem.scalars = std::move(stored.scalars);
  p.inputs_digest = stored.digest;
  if (with_truth) add_truth(place, store, task, set, p);
  return p;
}

Prepared prepare_own(const Workplace& place, const Task& task, const InputSet& set, Problem problem) {
  Prepared p;
  p.inputs_digest = digest_of(problem);
  p.problem = std::move(problem);
  add_truth(place, Store(place.store_root), task, set, p);
  return p;
}

}  // namespace gpuphys
