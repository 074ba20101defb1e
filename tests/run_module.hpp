// Runs a module in a unit test's own process: what the runner does, without the boundary around it.
#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <string>

#include "core/contract/task.hpp"
#include "core/judge/runner.hpp"
#include "core/run/caller.hpp"

namespace gpuphys::testing {

inline CallArray call_array(const HostArray& a) {
  CallArray c;
  c.abi = abi_array(a, nullptr);
  c.bytes = a.bytes();
  return c;
}

/// One call on a copy of the inputs. Outputs are poisoned first and inspected afterwards, as the judge does.
inline CallReport call_module(Caller& caller, const LoadedModule& module, const Contract& contract,
                              const Problem& problem) {
  CallReport report;
  Problem seen = problem.clone();
  Arrays outputs = make_outputs(contract, problem, static_cast<DType>(module.table().output_real));
  CallProblem call;
  for (std::size_t i = 0; i < seen.inputs.size(); ++i) {
    CallArray a = call_array(seen.inputs[i]);
    a.data = static_cast<std::byte*>(seen.inputs[i].data());
    a.original = static_cast<const std::byte*>(std::as_const(problem.inputs[i]).data());
    a.overwritable = contract.inputs[i].access == Access::overwritable;
    call.inputs.push_back(a);
  }
  for (HostArray& o : outputs) {
    CallArray a = call_array(o);
    a.data = static_cast<std::byte*>(o.data());
    call.outputs.push_back(a);
  }
  for (const Scalar& s : problem.scalars)
    call.scalars.push_back({s.name.c_str(), static_cast<std::int32_t>(s.dtype), s.value});
  const CallOutcome outcome = caller.call(module, call, {});
  report.milliseconds = outcome.milliseconds;
  report.faults = outcome.faults;
  if (outcome.delivered) report.outputs = std::move(outputs);
  inspect_outputs(report);
  return report;
}

/// Outputs of a module built with the suite on a problem; any fault fails the test.
inline Arrays run_module(const Task& task, const std::string& label, const Problem& problem) {
  const LoadedModule module(std::string(GPUPHYS_MODULES) + "/" + task.name + "/" + label + ".so");
  CallReport report = call_module(*make_caller(module), module, task.contract, problem);
  for (const FaultReport& f : report.faults) ADD_FAILURE() << to_string(f.fault) << ": " << f.detail;
  return std::move(report.outputs);
}

}  // namespace gpuphys::testing
