// What the rules of numerics.rules write into a mutant. Included before everything else.
#pragma once

#include <bit>
#include <cmath>
#include <cstdint>

namespace mutation {

/// The value with the 10 bits after the point that half precision keeps. What is not floating does not
/// compile.
inline float narrow(float v) {
  if (!std::isfinite(v)) return v;
  return std::bit_cast<float>((std::bit_cast<std::uint32_t>(v) + 0x1000u) & ~0x1fffu);
}
inline double narrow(double v) {
  if (!std::isfinite(v)) return v;
  return std::bit_cast<double>((std::bit_cast<std::uint64_t>(v) + (1ull << 41)) & ~((1ull << 42) - 1));
}
template <class T>
T narrow(T) = delete;

/// True at every 1000th call of a place in the code, and at its third.
template <int Place>
bool rarely() {
  static unsigned calls = 0;
  ++calls;
  return calls % 1000 == 0 || calls == 3;
}

}  // namespace mutation
