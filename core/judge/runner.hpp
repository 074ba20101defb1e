// The judge's side of the boundary (core/run/boundary.hpp): starts a runner, hands it inputs, takes what it
// delivers, and ends its whole tree of processes. Nothing that a runner says is trusted.
#pragma once

#include <sys/types.h>

#include <chrono>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/contract/arrays.hpp"
#include "core/run/boundary.hpp"
#include "core/run/fault.hpp"
#include "core/run/gpu_facts.hpp"

namespace gpuphys {

/// What one call of a module delivered, and what was found wrong with it.
struct CallReport {
  Arrays outputs;                                                  ///< empty when nothing was delivered
  double milliseconds = std::numeric_limits<double>::quiet_NaN();  ///< as the runner measured it
  double wall_ms =
      std::numeric_limits<double>::quiet_NaN();  ///< from "starting" to "stopped", as the judge saw it
  std::vector<FaultReport> faults;
};

/// The runner is gone without a complete answer. `timed_out`: because its time was up.
class RunnerLost : public std::runtime_error {
 public:
  RunnerLost(const std::string& why, bool timed_out) : std::runtime_error(why), timed_out_(timed_out) {}
  bool timed_out() const { return timed_out_; }

 private:
  bool timed_out_;
};

/// Whether a runner needs a GPU; decided before the module is opened.
enum class GpuUse { no, needed, unknown };

struct RunnerOptions {
  std::string program;      ///< path of gpuphys-runner
  double timeout_s = 300;   ///< for each request; finite and positive
  bool under_tool = false;  ///< a tool such as compute-sanitizer has to see the runner: it is not confined
  std::string build_root;   ///< modules below it are the suite's: a runner may read its own module only
};

class Runner {
 public:
  /// Starts the processes and waits until the runner has confined itself. Throws Error(unknown_name) when the
  /// program is missing, RunnerLost when it does not answer.
  explicit Runner(const RunnerOptions&, const std::string& module_path);
  ~Runner();
  Runner(const Runner&) = delete;
  Runner& operator=(const Runner&) = delete;

  /// "" or why nothing confines it.
  const std::string& unconfined() const { return unconfined_; }

  /// Of the GPU, before a module is loaded. Throws Error(skipped) without one.
  GpuIdentity identify();
  Ceilings ceilings();

  /// Opens the module. Throws Error(skipped) where a GPU is needed and there is none, Error(module_fault)
  /// when it is no module, RunnerLost.
  void load(GpuUse);
  const std::string& task() const { return task_; }
  bool on_device() const { return space_ == GPUPHYS_DEVICE; }
  DType output_real() const { return output_real_; }

  struct Call {
    bool timed = false;    ///< clocks up and caches empty first (device)
    bool last = true;      ///< the runner is ended before this returns; otherwise the outputs are copied
    bool discard = false;  ///< a warm-up whose outputs nobody looks at: none are returned
  };
  /// One call on a fresh solver object. Output poison and values that are not finite are found here, by the
  /// judge. Throws RunnerLost, or Error for a runner that cannot go on (out of memory, a lost CUDA context).
  CallReport call(const Contract&, const Problem&, const Call&);

  /// What the module printed, bounded and printable, one line each.
  std::vector<std::string> printed() const;
  /// Kills every process of the runner. No more calls.
  void end();

 private:
  using Clock = std::chrono::steady_clock;
  void ask(const boundary::Request&, const std::vector<int>& descriptors);
  boundary::Report answer(Clock::time_point deadline);
  boundary::Report expect(boundary::Tell, Clock::time_point deadline);
  [[noreturn]] void lost(const std::string& why, bool timed_out);
  std::string how_it_ended();
  void drain_output();
  std::uint64_t resident_bytes() const;
  Clock::time_point deadline() const;

  RunnerOptions options_;
  std::string module_path_, unconfined_, task_, output_;
  std::vector<FaultReport> stray_faults_;
  int space_ = GPUPHYS_HOST;
  DType output_real_ = DType::f32;
  pid_t supervisor_ = -1;
  int socket_ = -1, ending_ = -1, out_ = -1;
};

/// Elements that still hold the poison, and values that are not finite, appended to `report`.
void inspect_outputs(CallReport& report);

/// A whole answer by a fresh runner: load, one call, end.
CallReport run_once(const RunnerOptions&, const std::string& module_path, GpuUse, const Contract&,
                    const Problem&);

}  // namespace gpuphys
