// Calls across the C interface of modules.
#pragma once

#include <cstddef>
#include <cstdio>
#include <exception>

namespace gpuphys {

/// Room for the message that a module leaves when it returns an error.
inline constexpr std::size_t kMessageSize = 512;

/// Calls into a module; an exception that crosses its C interface counts as a returned error (1), with its
/// text in `message` (kMessageSize characters).
template <class Call>
int guarded_call(char* message, Call&& call) {
  try {
    return call();
  } catch (const std::exception& e) {
    std::snprintf(message, kMessageSize, "threw across the C interface: %s", e.what());
  } catch (...) {
    std::snprintf(message, kMessageSize, "threw across the C interface");
  }
  return 1;
}

}  // namespace gpuphys
