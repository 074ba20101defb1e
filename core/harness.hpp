// Runs a module without trusting it: outputs are poisoned before each call, guard bands surround every
// buffer, inputs are compared before and after, the device is idle before the stop event, and whatever rule
// was broken is named.
#pragma once

#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/arrays.hpp"
#include "core/task.hpp"

namespace gpuphys {

/// A rule that a module broke.
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
};
std::string to_string(Fault);

struct FaultReport {
  Fault fault;
  std::string detail;  ///< one line: which array, how many elements, where
};

/// What one call of a module did.
struct CallReport {
  Arrays outputs;  ///< empty when nothing could be read back
  double milliseconds =
      std::numeric_limits<double>::quiet_NaN();  ///< compute(), device idle before and after
  std::vector<FaultReport> faults;
};

/// A module that has been opened and whose interface has been checked.
class LoadedModule {
 public:
  /// Opens `path`. Throws Error(unknown_name) when the file is missing, Error(module_fault) when it is not a
  /// module of this ABI version.
  explicit LoadedModule(const std::string& path);
  ~LoadedModule();
  LoadedModule(const LoadedModule&) = delete;
  LoadedModule& operator=(const LoadedModule&) = delete;

  const gpuphys_module& table() const { return *table_; }
  const std::string& path() const { return path_; }
  bool on_device() const { return table_->space == GPUPHYS_DEVICE; }

 private:
  std::string path_;
  void* handle_ = nullptr;
  const gpuphys_module* table_ = nullptr;
};

/// Where modules run. One call() is one fresh solver object: allocate(), upload, poison, compute(), read
/// back, release().
class Backend {
 public:
  virtual ~Backend() = default;
  virtual CallReport call(const LoadedModule&, const Contract&, const Problem&) = 0;
};

std::unique_ptr<Backend> make_host_backend();

/// Throws Error(skipped) with one line when there is no GPU or the build has no CUDA.
std::unique_ptr<Backend> make_device_backend();

std::unique_ptr<Backend> make_backend(const LoadedModule&);

/// The poison that fills outputs before a call: a quiet NaN with a payload no computation produces, for each
/// element type. Bool outputs are poisoned with 0xA5.
void fill_poison(HostArray&);

/// Elements of `array` that still hold the poison.
std::int64_t count_poison(const HostArray&);

/// Faults that are visible in the outputs alone (unwritten, non-finite), appended to `report`.
void inspect_outputs(CallReport& report);

/// Guesses why outputs are wrong, to be called when a check failed: zeros, a copied input, or the output of
/// an earlier call. `earlier` may be null.
std::vector<FaultReport> diagnose(const Problem&, const Arrays& outputs, const Arrays* truth,
                                  const Arrays* earlier);

}  // namespace gpuphys
