#include "core/base/files.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <system_error>

#include "core/base/text.hpp"

namespace gpuphys {

namespace fs = std::filesystem;

std::string read_file(const std::string& path) {
  std::error_code ec;
  if (!fs::exists(path, ec)) throw Error(ExitCode::bad_input, fmt::format("'{}' does not exist", path));
  if (fs::is_directory(path, ec))
    throw Error(ExitCode::bad_input, fmt::format("'{}' is a folder, not a file", path));
  std::ifstream in(path, std::ios::binary);
  std::string text((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
  if (!in.is_open() || in.bad()) throw Error(ExitCode::bad_input, fmt::format("cannot read '{}'", path));
  return text;
}

PendingFile::PendingFile(const std::string& path) : path_(path) {
  static std::atomic<unsigned> serial{0};
  const fs::path folder = fs::path(path).parent_path();
  std::error_code ec;
  if (!folder.empty()) fs::create_directories(folder, ec);
  if (ec)
    throw Error(ExitCode::bad_input,
                fmt::format("cannot create folder '{}': {}", folder.string(), ec.message()));
  if (fs::is_directory(path, ec))
    throw Error(ExitCode::bad_input, fmt::format("'{}' is a folder, not a file", path));
  // Process id and serial number: parallel writers of the same file never share a temporary.
  temporary_ = fmt::format("{}.tmp-{}-{}", path, ::getpid(), serial.fetch_add(1));
}

PendingFile::~PendingFile() {
  if (!committed_) ::unlink(temporary_.c_str());
}

void PendingFile::commit() {
  const int fd = ::open(temporary_.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0 || ::fsync(fd) != 0) {
    const int error = errno;
    if (fd >= 0) ::close(fd);
    throw Error(ExitCode::bad_input, fmt::format("cannot write '{}': {}", path_, std::strerror(error)));
  }
  ::close(fd);
  if (::rename(temporary_.c_str(), path_.c_str()) != 0) {
    throw Error(ExitCode::bad_input, fmt::format("cannot write '{}': {}", path_, std::strerror(errno)));
  }
  committed_ = true;
}

void require_output_path(const std::string& path) {
  const auto refuse = [&](const std::string& why) {
    throw Error(ExitCode::bad_input, fmt::format("cannot write '{}': {}", printable(path), why));
  };
  std::error_code ec;
  const fs::path folder = fs::path(path).parent_path();
  if (!folder.empty() && !fs::is_directory(folder, ec)) refuse("its folder does not exist");
  const fs::file_status status = fs::symlink_status(path, ec);
  if (status.type() == fs::file_type::symlink) refuse("it is a link");
  if (status.type() == fs::file_type::directory) refuse("it is a folder");
  if (status.type() != fs::file_type::not_found && status.type() != fs::file_type::regular)
    refuse("it is no ordinary file");
}

void write_file(const std::string& path, const std::string& text) {
  PendingFile pending(path);
  {
    std::ofstream out(pending.temporary_path(), std::ios::binary);
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    out.flush();
    if (!out)
      throw Error(ExitCode::bad_input, fmt::format("cannot write '{}': {}", path, std::strerror(errno)));
  }
  pending.commit();
}

}  // namespace gpuphys
