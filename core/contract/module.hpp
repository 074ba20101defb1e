// Turns a C++ class into a loadable module (see core/contract/module_abi.h for the rules it must keep).
//
//     class MyKernel {
//      public:
//       void allocate(const Inputs& shapes, const Outputs<float>& shapes_out);  // data pointers are null
//       void compute(const Inputs& in, const Outputs<float>& out);              // the whole algorithm, every
//       call
//     };                                                                        // the destructor releases
//     GPUPHYS_DEVICE_MODULE(advect_rk2, MyKernel)
#pragma once

#include <cstdio>
#include <exception>
#include <stdexcept>
#include <string>

#include "core/contract/contract.hpp"
#include "core/contract/module_abi.h"

#ifdef __CUDACC__
#include <cuda_runtime.h>
#endif

namespace gpuphys {

#ifdef __CUDACC__
/// Throws with the call's text when a CUDA call failed.
inline void cuda_check(cudaError_t status, const char* what) {
  if (status != cudaSuccess) {
    throw std::runtime_error(std::string(what) + ": " + cudaGetErrorString(status));
  }
}
#define GPUPHYS_CUDA(call) ::gpuphys::cuda_check((call), #call)
#endif

namespace detail {

template <class Inputs, class Outputs>
void bind_problem(const gpuphys_problem& p, Inputs& in, Outputs& out) {
  BindVisitor read{p.inputs, p.n_inputs, p.scalars, p.n_scalars};
  in.visit(read);
  BindVisitor write{p.outputs, p.n_outputs, nullptr, 0};
  out.visit(write);
  if (!read.ok || !write.ok || read.next_array != p.n_inputs || read.next_scalar != p.n_scalars ||
      write.next_array != p.n_outputs) {
    throw std::runtime_error("the problem does not match the contract this module was compiled against");
  }
}

template <class Body>
int guarded(char* message, size_t message_size, Body&& body) {
  try {
    body();
    return 0;
  } catch (const std::exception& e) {
    std::snprintf(message, message_size, "%s", e.what());
  } catch (...) {
    std::snprintf(message, message_size, "unknown exception");
  }
  return 1;
}

template <class Solver, class Inputs, class Outputs, int Space, int Real>
const gpuphys_module* module_table(const char* task) {
  static gpuphys_module table{};
  table.abi_version = GPUPHYS_ABI_VERSION;
  table.task = task;
  table.space = Space;
  table.output_real = Real;
  table.allocate = [](void** state, const gpuphys_problem* shapes, char* message, size_t n) {
    return guarded(message, n, [&] {
      Inputs in;
      Outputs out;
      bind_problem(*shapes, in, out);
      auto* solver = new Solver();
      *state = solver;
      solver->allocate(in, out);
    });
  };
  table.compute = [](void* state, const gpuphys_problem* problem, char* message, size_t n) {
    return guarded(message, n, [&] {
      Inputs in;
      Outputs out;
      bind_problem(*problem, in, out);
      static_cast<Solver*>(state)->compute(in, out);
#ifdef __CUDACC__
      // Asked here because the module may carry its own copy of the CUDA runtime, whose last error the
      // harness cannot see.
      if (Space == GPUPHYS_DEVICE) cuda_check(cudaGetLastError(), "kernel launch");
#endif
    });
  };
  table.release = [](void* state) { delete static_cast<Solver*>(state); };
  return &table;
}

}  // namespace detail
}  // namespace gpuphys

#define GPUPHYS_MODULE_(task_, solver_, space_, real_, dtype_)                                        \
  extern "C" __attribute__((visibility("default"))) const gpuphys_module* gpuphys_get_module(void) {  \
    return ::gpuphys::detail::module_table<solver_, ::gpuphys::task_::Inputs,                         \
                                           ::gpuphys::task_::Outputs<real_>, space_, dtype_>(#task_); \
  }
/// A module whose data pointers are host memory and whose outputs are float32.
#define GPUPHYS_HOST_MODULE(task_, solver_) GPUPHYS_MODULE_(task_, solver_, GPUPHYS_HOST, float, GPUPHYS_F32)
/// A module whose data pointers are device memory.
#ifdef GPUPHYS_EMULATED  // its kernels run on the CPU (tests/emulation)
#define GPUPHYS_DEVICE_MODULE(task_, solver_) GPUPHYS_HOST_MODULE(task_, solver_)
#else
#define GPUPHYS_DEVICE_MODULE(task_, solver_) \
  GPUPHYS_MODULE_(task_, solver_, GPUPHYS_DEVICE, float, GPUPHYS_F32)
#endif

/// A serial baseline: a class template over Real, built once as FP64 truth and again as FP32 variants
/// (GPUPHYS_BASELINE_REAL is set by cmake/GpuphysTask.cmake).
#ifndef GPUPHYS_BASELINE_REAL
#define GPUPHYS_BASELINE_REAL double
#endif
#define GPUPHYS_BASELINE_MODULE(task_, solver_)                                      \
  using GpuphysBaselineSolver = solver_<GPUPHYS_BASELINE_REAL>;                      \
  GPUPHYS_MODULE_(task_, GpuphysBaselineSolver, GPUPHYS_HOST, GPUPHYS_BASELINE_REAL, \
                  static_cast<int>(::gpuphys::dtype_of<GPUPHYS_BASELINE_REAL>()))
