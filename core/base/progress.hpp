// A progress line on stderr for work that takes longer than two seconds; nothing when stderr is not a
// terminal.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace gpuphys {

/// Counts steps of a known total. The line appears after two seconds, is redrawn at most ten times a second,
/// and is wiped by the destructor, so that it never mixes with output.
class Progress {
 public:
  /// `what` names the work: "judging". `total` 0 means unknown: only the elapsed time is shown.
  Progress(std::string what, std::int64_t total);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// One more step done; `detail` says what comes next.
  void step(const std::string& detail = "");
  /// As step() without counting.
  void note(const std::string& detail);

 private:
  void draw();

  using Clock = std::chrono::steady_clock;
  std::string what_, detail_;
  std::int64_t total_, done_ = 0;
  bool terminal_, drawn_ = false;
  Clock::time_point start_, last_draw_;
};

}  // namespace gpuphys
