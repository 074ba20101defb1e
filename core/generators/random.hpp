// Counter-based random numbers: stateless, so the same on every machine, in every language and for any number
// of threads.
#pragma once

#include <cstdint>

#include "core/contract/view.hpp"

namespace gpuphys {

/// The finaliser of SplitMix64 (Steele, Lea, Flood 2014; constants of Stafford's variant 13).
GPUPHYS_HD constexpr std::uint64_t mix64(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
  return z ^ (z >> 31);
}

/// Random bits of item `i` in stream `stream` under `seed`.
GPUPHYS_HD constexpr std::uint64_t random_bits(std::uint64_t seed, std::uint64_t stream, std::uint64_t i) {
  constexpr std::uint64_t golden = 0x9E3779B97F4A7C15ull;
  return mix64(mix64(seed + golden * (stream + 1)) + golden * (i + 1));
}

/// Uniform in [0, 1), 53 bits.
GPUPHYS_HD constexpr double uniform01(std::uint64_t seed, std::uint64_t stream, std::uint64_t i) {
  return static_cast<double>(random_bits(seed, stream, i) >> 11) * 0x1p-53;
}

/// Uniform in [-1, 1).
GPUPHYS_HD constexpr double uniform11(std::uint64_t seed, std::uint64_t stream, std::uint64_t i) {
  return 2.0 * uniform01(seed, stream, i) - 1.0;
}

}  // namespace gpuphys
