#include "core/measure/protocol.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <limits>

namespace gpuphys {
namespace {

// Two messages between processes and the wait for an idle device take some 0.1 ms on a quiet machine. Where
// the judge wakes late to the first of them, it sees that much less.
constexpr double kMessagesMs = 0.5;
constexpr double kWallFraction = 0.1;

void require_no_fault(const CallReport& report, const std::string& what, bool judged,
                      bool discarded = false) {
  // NaN and infinity are wrong values, which the judge reports in its own words.
  for (const FaultReport& f : report.faults) {
    if (f.fault == Fault::non_finite_output && judged) continue;
    throw Error(ExitCode::module_fault, fmt::format("{}: {}: {}", what, to_string(f.fault), f.detail));
  }
  if (report.outputs.empty() && !discarded)
    throw Error(ExitCode::module_fault, fmt::format("{}: nothing was delivered", what));
}

}  // namespace

std::string disagreement(const std::vector<double>& reported, const std::vector<double>& wall) {
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < reported.size(); ++i) {
    if (!(std::isfinite(reported[i]) && reported[i] > 0 && std::isfinite(wall[i])))
      return fmt::format("call {} took {} ms, by the judge's clock {} ms", i + 1, reported[i], wall[i]);
    if (reported[i] > wall[i] * (1 + kWallFraction) + kMessagesMs) {
      return fmt::format("call {} is said to have taken {:.3f} ms; the judge saw only {:.3f} ms pass", i + 1,
                         reported[i], wall[i]);
    }
    least = std::min(least, wall[i] - reported[i] * (1 + kWallFraction));
  }
  if (least <= kMessagesMs) return "";
  return fmt::format("the judge saw at least {:.3f} ms more pass in every call than it is said to have taken",
                     least);
}

TimedCalls time_module(const StartRunner& start, const Contract& contract, const TimedSide& timed,
                       const TimedSide& other, const TimingProtocol& protocol,
                       const std::function<void(const std::string&)>& progress) {
  if (timed.problem == nullptr || other.problem == nullptr || !timed.judge)
    throw Error(ExitCode::internal, "time_module: a timing needs two problems and a judge");
  TimedCalls times;
  std::vector<double> wall;
  // Outputs are judged while the next process starts, not while anything is timed.
  std::future<std::vector<std::string>> verdict;
  std::string verdict_of;
  const auto await_verdict = [&] {
    if (!verdict.valid()) return;
    const std::vector<std::string> complaints = verdict.get();
    if (!complaints.empty())
      throw Error(ExitCode::check_failed, fmt::format("{}: {}", verdict_of, complaints.front()));
  };
  std::unique_ptr<Runner> runner;
  Arrays earlier;
  for (int i = 0; i < protocol.timed_calls; ++i) {
    if (!runner) runner = start();
    const int before = protocol.fresh_processes || i == 0 ? protocol.warmup_calls : 1;
    for (int w = 0; w < before; ++w) {
      const std::string what = fmt::format("call {} on the other inputs before timed call {}", w + 1, i + 1);
      if (progress) progress(what);
      const bool discard = w + 1 < before;  // the last one's outputs tell a stale answer
      CallReport report =
          runner->call(contract, *other.problem, {.timed = true, .last = false, .discard = discard});
      require_no_fault(report, what, false, discard);
      earlier = std::move(report.outputs);
      await_verdict();
    }
    const std::string what = fmt::format("timed call {}", i + 1);
    if (progress) progress(what);
    const bool last = protocol.fresh_processes || i + 1 == protocol.timed_calls;
    auto report =
        std::make_shared<CallReport>(runner->call(contract, *timed.problem, {.timed = true, .last = last}));
    if (last) runner.reset();
    require_no_fault(*report, what, true);
    times.milliseconds.push_back(report->milliseconds);
    wall.push_back(report->wall_ms);
    verdict_of = what;
    verdict =
        std::async(protocol.fresh_processes ? std::launch::async : std::launch::deferred,
                   [judge = timed.judge, report, before_it = std::make_shared<Arrays>(std::move(earlier))] {
                     return judge(*report, before_it->empty() ? nullptr : before_it.get());
                   });
    earlier.clear();
  }
  await_verdict();
  if (const std::string what = disagreement(times.milliseconds, wall); !what.empty())
    throw Error(ExitCode::module_fault, fmt::format("{}: {}", to_string(Fault::time_disagrees), what));
  return times;
}

}  // namespace gpuphys
