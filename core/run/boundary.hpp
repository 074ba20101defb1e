// The boundary between the judge and the runner: two programs that share nothing but one socket and the
// memory whose descriptors pass over it.
//
// The judge (`gpuphys`) knows tasks, truth, checks and results. It never loads a module. The runner
// (`gpuphys-runner`) loads one module and calls it; it is handed inputs and empty outputs, and knows nothing
// else. What the runner says is a claim by a process that a module may have taken over: the judge believes
// none of it, except that what lies in the output memory when the runner is gone (or when the judge copied
// it) is what it delivered.
//
//     judge                                         runner
//       start -------------------------------------> confine itself
//       <------------------------------- confined, what confines it
//       identify / ceilings (timing only) ---------> measured before any module is loaded
//       load --------------------------------------> dlopen
//       <------------------------------- loaded: task, space, type of the outputs
//       call: shapes, descriptors of inputs, outputs -> allocate, upload, compute, download
//       <------------------------------- starting, stopped (the judge notes when), faults, done
//
// Requests carry the descriptors of their arrays' memory. Every message is one packet of fixed size.
#pragma once

#include <cstdint>

#include "core/contract/module_abi.h"

namespace gpuphys::boundary {

inline constexpr std::uint32_t kMagic = 0x67707935;
inline constexpr int kMostArrays = 32, kMostScalars = 32;
inline constexpr int kNameBytes = 64, kTextBytes = 768;

/// An array in shared memory: `bytes` bytes at `offset` of the descriptor number `descriptor` of this
/// message.
struct ArrayAt {
  char name[kNameBytes];
  std::int32_t dtype, rank;
  std::int64_t shape[GPUPHYS_MAX_RANK];
  std::int64_t bytes, offset;
  std::int32_t descriptor;
  std::int32_t overwritable;  ///< inputs: the contract lets compute() change it
};

struct ScalarAt {
  char name[kNameBytes];
  std::int32_t dtype, unused;
  double value;
};

enum class Ask : std::uint32_t { identify = 1, ceilings, load, call };

/// Options of `load`: whether there is a GPU is decided before the module is opened.
enum LoadFlags : std::uint32_t {
  kNeedsGpu = 1,   ///< refuse with 77 where there is none
  kMayUseGpu = 2,  ///< nobody knows yet: find out, and refuse only if the module turns out to need it
};
/// Options of `call`.
enum CallFlags : std::uint32_t {
  kTimed = 1,      ///< bring the clocks up and empty the L2 cache first (device)
  kUnderTool = 2,  ///< a tool slows the device: do not look for work that ends late
  kDiscard = 4,    ///< a warm-up: the outputs stay where they are
};

struct Request {
  std::uint32_t magic;
  Ask ask;
  std::uint32_t flags;
  char path[4096];  ///< load: the module
  std::int32_t n_inputs, n_outputs, n_scalars;
  ArrayAt inputs[kMostArrays], outputs[kMostArrays];
  ScalarAt scalars[kMostScalars];
};

enum class Tell : std::uint32_t {
  confined = 1,  ///< text: "" or why nothing confines the runner
  identity,      ///< text: device, driver, toolkit, one per line; status 77 without a GPU (text: why)
  ceilings,      ///< values[0..4]: copy GB/s, read GB/s, FP32 TFLOP/s, launch us, L2 MiB
  loaded,        ///< text: the task that it says it computes; space, output_real
  refused,       ///< the module or the request cannot be used; status: an ExitCode; text: why
  starting,      ///< compute() begins
  stopped,       ///< the device is idle behind compute()
  fault,         ///< status: a Fault; text: detail
  done,          ///< the outputs lie in their memory; values[0]: milliseconds
};

struct Report {
  std::uint32_t magic;
  Tell tell;
  std::int32_t status;
  std::int32_t space, output_real;
  double values[5];
  char text[kTextBytes];
};

/// Descriptors that the runner finds: its end of the socket, and the pipe by which its supervisor tells how
/// it ended (waitpid's status, an int).
inline constexpr int kSocket = 3, kEnding = 4;

/// Exit code of a runner that could not start.
inline constexpr int kCannotStart = 125;

}  // namespace gpuphys::boundary
