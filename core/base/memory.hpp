// Memory that two processes can share: a file, or anonymous memory with a descriptor, mapped as a whole.
#pragma once

#include <cstddef>
#include <memory>
#include <string>

namespace gpuphys {

class SharedMemory {
 public:
  /// Fresh zeroed memory that is read and written here and by whoever gets the descriptor. Throws
  /// Error(out_of_memory).
  static std::shared_ptr<SharedMemory> anonymous(std::size_t bytes, const std::string& what);
  /// An existing file, read-only: its descriptor cannot be written through either. Throws Error(bad_input).
  static std::shared_ptr<SharedMemory> file(const std::string& path);
  ~SharedMemory();
  SharedMemory(const SharedMemory&) = delete;
  SharedMemory& operator=(const SharedMemory&) = delete;

  int descriptor() const { return fd_; }
  std::byte* data() const { return data_; }
  std::size_t bytes() const { return bytes_; }
  bool writable() const { return writable_; }
  /// No write reaches the memory any more, through whatever descriptor or mapping. It must not be mapped for
  /// writing: remaps read-only first. Throws Error(internal).
  void seal();

 private:
  SharedMemory() = default;
  int fd_ = -1;
  std::byte* data_ = nullptr;
  std::size_t bytes_ = 0;
  bool writable_ = false;
};

}  // namespace gpuphys
