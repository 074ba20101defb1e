// Text that the suite did not write itself (of modules, labels, file names, files) before it is shown or
// kept.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

namespace gpuphys {

/// `text` in at most `longest` bytes of valid UTF-8 without control characters: line ends and tabs become
/// blanks, whatever else cannot be printed becomes '?'. A longer text ends in "...".
std::string printable(std::string_view text, std::size_t longest = 400);

/// The text in a buffer of `size` bytes up to its first zero, or all of it where there is none.
std::string_view bounded(const char* buffer, std::size_t size);

}  // namespace gpuphys
