#include "core/base/text.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>

namespace gpuphys {
namespace {

// Length of the well-formed UTF-8 sequence that starts at `at`, 0 if there is none (Unicode, table 3-7).
std::size_t sequence_length(std::string_view s, std::size_t at) {
  const auto byte = [&](std::size_t i) { return static_cast<std::uint8_t>(s[at + i]); };
  const std::uint8_t first = byte(0);
  if (first < 0x80) return 1;
  std::size_t n = 0;
  std::uint8_t low = 0x80, high = 0xBF;  // bounds of the second byte
  if (first >= 0xC2 && first <= 0xDF) n = 2;
  if (first >= 0xE0 && first <= 0xEF) n = 3;
  if (first >= 0xF0 && first <= 0xF4) n = 4;
  if (first == 0xE0) low = 0xA0;
  if (first == 0xED) high = 0x9F;
  if (first == 0xF0) low = 0x90;
  if (first == 0xF4) high = 0x8F;
  if (n == 0 || at + n > s.size() || byte(1) < low || byte(1) > high) return 0;
  for (std::size_t i = 2; i < n; ++i) {
    if (byte(i) < 0x80 || byte(i) > 0xBF) return 0;
  }
  return n;
}

bool is_control(std::string_view sequence) {
  const auto first = static_cast<std::uint8_t>(sequence[0]);
  if (sequence.size() == 1) return first < 0x20 || first == 0x7F;
  if (first == 0xC2 && static_cast<std::uint8_t>(sequence[1]) < 0xA0) return true;  // C1 controls
  // Marks that reorder what is shown around them: U+200E, 200F, 202A to 202E, 2066 to 2069.
  const std::string_view reordering[] = {"\u200E", "\u200F", "\u202A", "\u202B", "\u202C", "\u202D",
                                         "\u202E", "\u2066", "\u2067", "\u2068", "\u2069"};
  return std::find(std::begin(reordering), std::end(reordering), sequence) != std::end(reordering);
}

}  // namespace

std::string printable(std::string_view text, std::size_t longest) {
  constexpr std::string_view kMore = "...";
  std::string out;
  std::size_t room_for_more = 0;  // where "..." goes if the rest does not fit
  for (std::size_t i = 0; i < text.size();) {
    const std::size_t n = sequence_length(text, i);
    std::string_view piece = n == 0 ? std::string_view("?") : text.substr(i, n);
    if (piece == "\n" || piece == "\r" || piece == "\t") piece = " ";
    if (is_control(piece)) piece = "?";
    if (out.size() + piece.size() > longest) {
      out.resize(room_for_more);
      return out.append(kMore.substr(0, longest - out.size()));
    }
    out += piece;
    if (out.size() + kMore.size() <= longest) room_for_more = out.size();
    i += std::max<std::size_t>(n, 1);
  }
  return out;
}

std::string_view bounded(const char* buffer, std::size_t size) {
  return {buffer, ::strnlen(buffer, size)};
}

}  // namespace gpuphys
