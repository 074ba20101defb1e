/* The binary interface between the harness and anything that computes a task: a reference, one of its
 * variants or mutants, a serial baseline, or a user's own kernel. Plain C, so that any language that can
 * export one C symbol can be judged. C++ and CUDA authors use the adapter in core/contract/module.hpp
 * instead.
 *
 * A module is a shared object that exports
 *
 *     const gpuphys_module* gpuphys_get_module(void);
 *
 * The harness calls allocate() once per solver object with every `data` pointer null (shapes and scalars
 * only, untimed), then compute() any number of times (timed, the whole algorithm, every call), then
 * release().
 *
 * Rules a module must keep; the harness checks each of them:
 *  - allocate() does no device work: no launches, copies, memsets.
 *  - compute() writes every element of every output, writes nothing outside them, and leaves the inputs
 * unchanged unless the task's contract marks them as overwritable.
 *  - Device modules order all their work before the legacy default stream, or synchronise before they return.
 *  - A non-zero return means failure; `message` then holds one line that says what went wrong.
 */
#ifndef GPUPHYS_MODULE_ABI_H
#define GPUPHYS_MODULE_ABI_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define GPUPHYS_ABI_VERSION 1
#define GPUPHYS_MAX_RANK 4

/* Element types. GPUPHYS_BOOL is one byte, 0 or 1. */
enum { GPUPHYS_F32 = 1, GPUPHYS_F64 = 2, GPUPHYS_I32 = 3, GPUPHYS_BOOL = 4 };

/* Where the data pointers that compute() receives point to. */
enum { GPUPHYS_HOST = 0, GPUPHYS_DEVICE = 1 };

/* A dense C-order array; the last index is fastest. */
typedef struct gpuphys_array {
  const char* name;
  int32_t dtype;
  int32_t rank;
  int64_t shape[GPUPHYS_MAX_RANK];
  void* data; /* null while allocate() runs */
} gpuphys_array;

/* A scalar parameter. float32 and int32 values are held exactly. */
typedef struct gpuphys_scalar {
  const char* name;
  int32_t dtype;
  double value;
} gpuphys_scalar;

/* Inputs, outputs and scalars in the order of the task's contract (`gpuphys list --task T` prints it). */
typedef struct gpuphys_problem {
  int32_t n_inputs, n_outputs, n_scalars;
  const gpuphys_array* inputs;
  const gpuphys_array* outputs;
  const gpuphys_scalar* scalars;
} gpuphys_problem;

typedef struct gpuphys_module {
  uint32_t abi_version; /* GPUPHYS_ABI_VERSION */
  const char* task;     /* the task's name, e.g. "advect_rk2" */
  int32_t space;        /* GPUPHYS_HOST or GPUPHYS_DEVICE */
  int32_t output_real;  /* GPUPHYS_F32; serial FP64 baselines write GPUPHYS_F64 */
  int (*allocate)(void** state, const gpuphys_problem* shapes, char* message, size_t message_size);
  int (*compute)(void* state, const gpuphys_problem* problem, char* message, size_t message_size);
  void (*release)(void* state);
} gpuphys_module;

const gpuphys_module* gpuphys_get_module(void);

#ifdef __cplusplus
}
#endif
#endif
