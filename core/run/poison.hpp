// What outputs hold before a call, so that elements that nobody wrote are seen.
#pragma once

#include <cstdint>

namespace gpuphys {

/// The poison that fills outputs before a call: quiet NaNs whose payloads spell a pattern that arithmetic
/// does not produce (it yields 0x7FC00000 / 0x7FF8...), and 0xA5 for bool.
inline constexpr std::uint32_t kPoison32 = 0x7FE5A5A5u;
inline constexpr std::uint64_t kPoison64 = 0x7FFCA5A5A5A5A5A5ull;
inline constexpr unsigned char kPoisonByte = 0xA5;
/// Fills `count` elements of `dtype`.
void fill_poison(void* data, std::int64_t count, std::int32_t dtype);
std::int64_t count_poison(const void* data, std::int64_t count, std::int32_t dtype);

}  // namespace gpuphys
