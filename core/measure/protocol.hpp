// The timing protocol: which calls are made, in which processes, and what is believed of the times that come
// back.
//
// As the paper: each timed call in a fresh process, after three warm-up calls on the other input set (and
// until the clocks are up), five of them. Where a variant is only compared, one process serves for all: its
// calls alternate between the two sets. Every timed output is judged.
//
// The runner measures with events on the device. The judge sees the same call begin and end, and holds the
// one against the other: a module that tampers with its clock would have to tamper with the judge's.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/judge/runner.hpp"

namespace gpuphys {

/// One of the two input sets of a timing.
struct TimedSide {
  const Problem* problem = nullptr;
  /// What is wrong with the outputs of a call on this set, one line each; `earlier` (may be null) is what the
  /// call before returned, on the other set. The timed side must have one.
  std::function<std::vector<std::string>(const CallReport&, const Arrays* earlier)> judge;
};

struct TimingProtocol {
  int warmup_calls = 3;
  int timed_calls = 5;
  bool fresh_processes = true;  ///< one for each timed call
};

struct TimedCalls {
  std::vector<double> milliseconds;
};

/// A runner with the module loaded.
using StartRunner = std::function<std::unique_ptr<Runner>()>;

/// Throws Error(module_fault) naming the call and the fault when the module breaks a rule in any call or its
/// times disagree, Error(check_failed) when a judged output is wrong, RunnerLost. `progress` is called before
/// each call.
TimedCalls time_module(const StartRunner&, const Contract&, const TimedSide& timed, const TimedSide& other,
                       const TimingProtocol& = {},
                       const std::function<void(const std::string&)>& progress = nullptr);

/// What is wrong with the reported times, "" when they agree with what the judge saw: over all calls, the
/// wall clock may exceed the event time by the cost of two messages and of waiting, not more.
std::string disagreement(const std::vector<double>& reported_ms, const std::vector<double>& wall_ms);

}  // namespace gpuphys
