#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cstring>

#include "core/base/text.hpp"
#include "core/run/caller.hpp"
#include "core/run/guarded_call.hpp"

namespace gpuphys {
namespace {

using Clock = std::chrono::steady_clock;

class HostCaller final : public Caller {
 public:
  CallOutcome call(const LoadedModule& module, const CallProblem& problem,
                   const CallMoments& moments) override {
    const gpuphys_module& table = module.table();
    CallOutcome outcome;
    char message[kMessageSize] = "";
    const auto note = [&](const char* where, int status) {
      if (status == 0) return;
      const std::string said = printable(bounded(message, sizeof message));
      outcome.faults.push_back(
          {Fault::returned_error, fmt::format("{}: {}", where, said.empty() ? "no message" : said)});
    };
    void* state = nullptr;
    const CallProblem::View shapes = problem.view();
    const gpuphys_problem shape_view = shapes.problem();
    const int allocated =
        guarded_call(message, [&] { return table.allocate(&state, &shape_view, message, sizeof message); });
    note("allocate()", allocated);

    if (allocated == 0) {
      CallProblem::View view = problem.view();
      for (std::size_t i = 0; i < problem.inputs.size(); ++i) view.inputs[i].data = problem.inputs[i].data;
      for (std::size_t i = 0; i < problem.outputs.size(); ++i) {
        const CallArray& a = problem.outputs[i];
        view.outputs[i].data = a.data;
        fill_poison(a.data, count_of(a), a.abi.dtype);
      }
      const gpuphys_problem data_view = view.problem();
      moments.starting();
      const auto start = Clock::now();
      const int computed =
          guarded_call(message, [&] { return table.compute(state, &data_view, message, sizeof message); });
      outcome.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
      moments.stopped();
      note("compute()", computed);
      // This tells an honest author of a mistake. The judge's own inputs are out of every module's reach.
      for (const CallArray& a : problem.inputs) {
        if (a.overwritable || a.bytes == 0 || std::memcmp(a.original, a.data, a.bytes) == 0) continue;
        outcome.faults.push_back({Fault::input_modified, describe_change(a, a.data)});
      }
      outcome.delivered = true;
    }
    if (allocated == 0 || state != nullptr) {
      note("release()", guarded_call(message, [&] {
             table.release(state);
             return 0;
           }));
    }
    return outcome;
  }
};

}  // namespace

gpuphys_problem CallProblem::View::problem() const {
  gpuphys_problem p{};
  p.n_inputs = static_cast<std::int32_t>(inputs.size());
  p.n_outputs = static_cast<std::int32_t>(outputs.size());
  p.n_scalars = static_cast<std::int32_t>(scalars->size());
  p.inputs = inputs.data();
  p.outputs = outputs.data();
  p.scalars = scalars->data();
  return p;
}

CallProblem::View CallProblem::view() const {
  View v;
  for (const CallArray& a : inputs) v.inputs.push_back(a.abi);
  for (const CallArray& a : outputs) v.outputs.push_back(a.abi);
  for (std::vector<gpuphys_array>* arrays : {&v.inputs, &v.outputs}) {
    for (gpuphys_array& a : *arrays) a.data = nullptr;
  }
  v.scalars = &scalars;
  return v;
}

std::int64_t count_of(const CallArray& a) {
  std::int64_t n = 1;
  for (int d = 0; d < a.abi.rank; ++d) n *= a.abi.shape[d];
  return n;
}

std::string describe_change(const CallArray& a, const std::byte* now) {
  const std::int64_t n = count_of(a);
  const std::size_t size = n > 0 ? a.bytes / static_cast<std::size_t>(n) : 1;
  std::int64_t changed = 0, first = -1;
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t at = static_cast<std::size_t>(i) * size;
    if (std::memcmp(a.original + at, now + at, size) == 0) continue;
    if (first < 0) first = i;
    ++changed;
  }
  return fmt::format("input '{}': {} of {} elements changed during compute(), first at flat index {}",
                     a.abi.name, changed, n, first);
}

std::unique_ptr<Caller> make_host_caller() {
  return std::make_unique<HostCaller>();
}

std::unique_ptr<Caller> make_caller(const LoadedModule& module) {
  return module.on_device() ? make_device_caller() : make_host_caller();
}

}  // namespace gpuphys
