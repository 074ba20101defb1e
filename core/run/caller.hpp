// One call of a module: what is needed for it, and where it runs. The runner's half of the boundary; knows
// arrays by address and size only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "core/contract/module_abi.h"
#include "core/run/fault.hpp"
#include "core/run/loaded_module.hpp"
#include "core/run/poison.hpp"

namespace gpuphys {

/// An array as compute() sees it, but in host memory.
struct CallArray {
  gpuphys_array abi{};  ///< name, type, shape; `data` is not used
  std::size_t bytes = 0;
  std::byte* data = nullptr;
  const std::byte* original = nullptr;  ///< inputs: the same bytes in memory that compute() does not see
  bool overwritable = false;            ///< inputs: compute() may change it
};

struct CallProblem {
  std::vector<CallArray> inputs, outputs;
  std::vector<gpuphys_scalar> scalars;
  bool timed = false;       ///< clocks up and caches empty first
  bool under_tool = false;  ///< work that ends late is not looked for
  bool discard = false;     ///< outputs need not reach host memory

  /// What crosses the C interface, with the given data pointers (null: shapes only).
  struct View {
    std::vector<gpuphys_array> inputs, outputs;
    const std::vector<gpuphys_scalar>* scalars;
    gpuphys_problem problem() const;
  };
  View view() const;
};

struct CallOutcome {
  double milliseconds = std::numeric_limits<double>::quiet_NaN();
  bool delivered = false;  ///< the outputs lie in their memory
  std::vector<FaultReport> faults;
};

/// Told right before and right behind compute().
struct CallMoments {
  std::function<void()> starting = [] {};
  std::function<void()> stopped = [] {};
};

/// Where modules run. One call is one fresh solver object: allocate(), inputs, poison, compute(), outputs,
/// release().
class Caller {
 public:
  virtual ~Caller() = default;
  virtual CallOutcome call(const LoadedModule&, const CallProblem&, const CallMoments&) = 0;
};

/// The problem's host memory is passed to the module as it is.
std::unique_ptr<Caller> make_host_caller();
/// Throws Error(skipped) with one line when there is no GPU or the build has no CUDA.
std::unique_ptr<Caller> make_device_caller();
std::unique_ptr<Caller> make_caller(const LoadedModule&);

std::int64_t count_of(const CallArray&);  ///< elements
/// "input 'u': 3 of 100 elements changed during compute(), ...": `now` against the array's original bytes.
std::string describe_change(const CallArray&, const std::byte* now);

}  // namespace gpuphys
