// Runs a module in a unit test.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "core/harness.hpp"
#include "core/task.hpp"

namespace gpuphys::testing {

/// Outputs of a module built with the suite on a problem; any fault fails the test.
inline Arrays run_module(const Task& task, const std::string& label, const Problem& problem) {
  const LoadedModule module(std::string(GPUPHYS_MODULES) + "/" + task.name + "/" + label + ".so");
  CallReport report = make_backend(module)->call(module, task.contract, problem);
  for (const FaultReport& f : report.faults) ADD_FAILURE() << to_string(f.fault) << ": " << f.detail;
  return std::move(report.outputs);
}

}  // namespace gpuphys::testing
