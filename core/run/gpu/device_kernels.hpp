// The harness's own kernels, behind plain functions. All run on the legacy default stream and return without
// waiting; a failed launch throws Error(cuda_error).
#pragma once

#include <cstddef>
#include <cstdint>

namespace gpuphys::device {

/// Repeats an element of 1, 4 or 8 bytes `count` times. `data` is aligned to the element.
void fill(void* data, std::size_t count, const void* element, std::size_t element_bytes);

/// Adds to *counter (device memory) the number of bytes that differ from `value`.
void count_other_bytes(const void* data, std::size_t bytes, unsigned char value, std::uint64_t* counter);

/// Adds to *sum (device memory) a hash of the bytes that depends on their positions but not on the order of
/// the threads. `data` is aligned to 8 bytes.
void hash(const void* data, std::size_t bytes, std::uint64_t* sum);

/// Reads `bytes` (a multiple of 16). `sink` is never written in practice; it keeps the reads alive.
void read_all(const void* data, std::size_t bytes, std::uint32_t* sink);

/// Copies `bytes` (a multiple of 16).
void copy(void* to, const void* from, std::size_t bytes);

/// Fused multiply-adds on every lane of every multiprocessor; returns how many floating-point operations were
/// asked for (two each).
double multiply_add(int multiprocessors, int rounds, float* sink);

/// A kernel that does nothing.
void empty();

}  // namespace gpuphys::device
