#include "core/base/progress.hpp"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace gpuphys {
namespace {

constexpr auto kSilence = std::chrono::seconds(2);
constexpr auto kRedraw = std::chrono::milliseconds(100);

std::size_t terminal_width() {
  winsize size{};
  return ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 0 ? size.ws_col : 80;
}

}  // namespace

Progress::Progress(std::string what, std::int64_t total)
    : what_(std::move(what)),
      total_(total),
      terminal_(::isatty(STDERR_FILENO) == 1),
      start_(Clock::now()),
      last_draw_(start_) {}

Progress::~Progress() {
  if (drawn_) std::fputs("\r\033[K", stderr);
}

void Progress::step(const std::string& detail) {
  ++done_;
  note(detail);
}

void Progress::note(const std::string& detail) {
  detail_ = detail;
  draw();
}

void Progress::draw() {
  if (!terminal_) return;
  const Clock::time_point now = Clock::now();
  if (now - start_ < kSilence || (drawn_ && now - last_draw_ < kRedraw)) return;
  const double seconds = std::chrono::duration<double>(now - start_).count();
  std::string line = what_;
  if (total_ > 0)
    line += fmt::format(" {}/{} ({:.0f}%)", done_, total_,
                        100.0 * static_cast<double>(done_) / static_cast<double>(total_));
  line += fmt::format(" {:.0f} s", seconds);
  if (total_ > done_ && done_ > 0) {
    line += fmt::format(", about {:.0f} s left",
                        seconds / static_cast<double>(done_) * static_cast<double>(total_ - done_));
  }
  if (!detail_.empty()) line += "  " + detail_;
  line.resize(std::min(line.size(), terminal_width() - 1));
  fmt::print(stderr, "\r\033[K{}", line);
  std::fflush(stderr);
  drawn_ = true;
  last_draw_ = now;
}

}  // namespace gpuphys
