// The rules that a module can break.
#pragma once

#include <string>

namespace gpuphys {

enum class Fault {
  returned_error,       ///< allocate() or compute() returned non-zero
  launch_failed,        ///< a CUDA error surfaced after compute()
  out_of_bounds_write,  ///< a guard band around a buffer changed
  input_modified,       ///< an input that the contract protects changed
  unwritten_output,     ///< the poison pattern is still in an output
  non_finite_output,    ///< NaN or infinity in an output
  asynchronous_return,  ///< device work was still running when compute()'s own stream order had finished
  work_in_allocate,     ///< allocate() launched kernels, copies or memsets
  stale_output,         ///< bitwise the output of an earlier call on other data
  zero_output,          ///< all zeros although the truth is not
  copied_input,         ///< an output is bitwise one of the inputs although the truth is not
  below_floor,          ///< faster than the compulsory traffic allows
  time_disagrees,       ///< the time that the runner reports is not the one that the judge saw pass
};
inline constexpr int kFaults = static_cast<int>(Fault::time_disagrees) + 1;

std::string to_string(Fault);

struct FaultReport {
  Fault fault;
  std::string detail;  ///< one line: which array, how many elements, where
};

}  // namespace gpuphys
