// Splits index ranges over the machine's cores. Only for generators and judges, whose work on each index is
// independent, so that results do not depend on the number of threads.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <thread>
#include <vector>

namespace gpuphys {

/// Calls body(i) for i in [0, n), each exactly once, in unspecified order over all cores. Rethrows the first
/// exception.
template <class Body>
void parallel_for(std::int64_t n, Body&& body) {
  const std::int64_t workers = std::min<std::int64_t>(n, std::max(1u, std::thread::hardware_concurrency()));
  if (workers <= 1) {
    for (std::int64_t i = 0; i < n; ++i) body(i);
    return;
  }
  std::vector<std::exception_ptr> errors(static_cast<std::size_t>(workers));
  std::vector<std::thread> threads;
  for (std::int64_t w = 0; w < workers; ++w) {
    threads.emplace_back([&, w] {
      try {
        for (std::int64_t i = w; i < n; i += workers) body(i);
      } catch (...) {
        errors[static_cast<std::size_t>(w)] = std::current_exception();
      }
    });
  }
  for (std::thread& t : threads) t.join();
  for (const std::exception_ptr& e : errors) {
    if (e) std::rethrow_exception(e);
  }
}

/// Calls body(piece, begin, end) for consecutive pieces of [0, n) of a fixed size, so that what is combined
/// from the pieces in their order does not depend on the number of threads. `kPieceSize` elements a piece.
inline constexpr std::int64_t kPieceSize = 1 << 20;
inline std::int64_t pieces_of(std::int64_t n) {
  return (n + kPieceSize - 1) / kPieceSize;
}
template <class Body>
void parallel_pieces(std::int64_t n, Body&& body) {
  parallel_for(pieces_of(n), [&](std::int64_t piece) {
    body(piece, piece * kPieceSize, std::min(n, (piece + 1) * kPieceSize));
  });
}

}  // namespace gpuphys
