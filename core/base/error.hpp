// Errors that reach the user: one clear line and a distinct exit code.
#pragma once

#include <stdexcept>
#include <string>

namespace gpuphys {

/// Exit codes of the driver; `gpuphys --help` prints this table from exit_code_table().
enum class ExitCode : int {
  ok = 0,
  usage = 2,          ///< bad command line
  check_failed = 3,   ///< a check exceeded its tolerance, or a mutant survived
  module_fault = 4,   ///< the module broke a rule of the harness (the fault is named)
  bad_input = 5,      ///< missing, corrupt, truncated or wrongly shaped file
  unknown_name = 6,   ///< no such task, input set, check or module
  cuda_error = 7,     ///< a CUDA call failed
  out_of_memory = 8,  ///< host or device memory exhausted
  crashed = 9,        ///< the module's process died or ran out of time
  slow = 10,          ///< the timing gate: slower than the record
  unbaselined = 11,   ///< the timing gate: no record for this GPU
  below_floor = 12,   ///< the timing gate: faster than physically possible
  stale_record = 13,  ///< a GPU record is older than its sources
  output_lost = 14,   ///< standard output could not be written: the verdict was not seen
  noisy = 15,         ///< the timing gate: calls scatter too much to say anything
  internal = 70,      ///< a bug in the suite
  skipped = 77,       ///< needs a GPU and there is none (CTest reports it as skipped)
};

/// An error with the exit code that the driver ends with.
class Error : public std::runtime_error {
 public:
  Error(ExitCode code, const std::string& what) : std::runtime_error(what), code_(code) {}
  ExitCode code() const { return code_; }

 private:
  ExitCode code_;
};

/// Lines "code  meaning" for --help and the manual.
std::string exit_code_table();

}  // namespace gpuphys
