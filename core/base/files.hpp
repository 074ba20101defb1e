// Reading whole files and replacing files atomically.
#pragma once

#include <string>

#include "core/base/error.hpp"

namespace gpuphys {

/// The file's bytes. Throws Error(bad_input) when it is missing or cannot be read.
std::string read_file(const std::string& path);

/// A file being written under a temporary name in the folder of its final one. commit() renames it; without
/// commit() the destructor removes it, so that an interrupted or failed write leaves what was there before.
class PendingFile {
 public:
  /// Creates the folder. Throws Error(bad_input) when that is impossible.
  explicit PendingFile(const std::string& path);
  ~PendingFile();
  PendingFile(const PendingFile&) = delete;
  PendingFile& operator=(const PendingFile&) = delete;

  const std::string& temporary_path() const { return temporary_; }
  /// Flushes to disk and renames. Throws Error(bad_input).
  void commit();

 private:
  std::string path_, temporary_;
  bool committed_ = false;
};

/// A file that a user asked to be written: its folder exists, and it is new or an ordinary file. Throws
/// Error(bad_input) for a device, a link, a folder, or a folder that does not exist.
void require_output_path(const std::string& path);

/// Replaces `path` by `text` atomically; creates the folder.
void write_file(const std::string& path, const std::string& text);

}  // namespace gpuphys
