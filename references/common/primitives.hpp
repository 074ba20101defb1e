// Device-wide sort and scan (CUB), compiled once: CUB's headers take a dozen seconds a file, and every mutant
// compiles its task's reference anew. Modules link the library gpuphys_primitives.
//
// Each operation takes scratch memory from the caller: ask for its size in allocate(), pass it in compute().
// All work goes to the default stream, as everything that a module launches does unless it says otherwise.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <cstdint>

namespace gpuphys::primitives {

/// Bytes of scratch that exclusive_sum() of up to `n` elements takes.
std::size_t exclusive_sum_bytes(std::int64_t n);
/// out[i] = in[0] + ... + in[i-1]. `in` and `out` may be the same array. Throws std::runtime_error on a CUDA
/// error.
void exclusive_sum(void* scratch, std::size_t scratch_bytes, const std::int32_t* in, std::int32_t* out,
                   std::int64_t n, cudaStream_t stream = nullptr);

/// Bytes of scratch that sort_pairs() of up to `n` pairs takes.
std::size_t sort_pairs_bytes(std::int64_t n);
/// Stable radix sort by the bits [begin_bit, end_bit) of the keys; inputs are kept. Throws std::runtime_error
/// on a CUDA error.
void sort_pairs(void* scratch, std::size_t scratch_bytes, const std::uint32_t* keys_in,
                std::uint32_t* keys_out, const std::uint32_t* values_in, std::uint32_t* values_out,
                std::int64_t n, int begin_bit, int end_bit, cudaStream_t stream = nullptr);

}  // namespace gpuphys::primitives
