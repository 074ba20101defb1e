#include "core/base/memory.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "core/base/error.hpp"
#include "core/base/text.hpp"

namespace gpuphys {

std::shared_ptr<SharedMemory> SharedMemory::anonymous(std::size_t bytes, const std::string& what) {
  std::shared_ptr<SharedMemory> m(new SharedMemory());
  m->bytes_ = bytes;
  m->writable_ = true;
  m->fd_ = ::memfd_create("gpuphys", MFD_CLOEXEC | MFD_ALLOW_SEALING);
  const std::size_t length = std::max<std::size_t>(bytes, 1);
  void* p = MAP_FAILED;
  if (m->fd_ >= 0 && ::ftruncate(m->fd_, static_cast<off_t>(length)) == 0)
    p = ::mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, m->fd_, 0);
  if (p == MAP_FAILED) {
    throw Error(ExitCode::out_of_memory, fmt::format("{}: cannot allocate {} MiB of shared memory: {}", what,
                                                     bytes >> 20, std::strerror(errno)));
  }
  // A receiver must not be able to change its size under us: reading would end in SIGBUS.
  ::fcntl(m->fd_, F_ADD_SEALS, F_SEAL_SHRINK | F_SEAL_GROW);
  m->data_ = static_cast<std::byte*>(p);
  return m;
}

std::shared_ptr<SharedMemory> SharedMemory::file(const std::string& path) {
  std::shared_ptr<SharedMemory> m(new SharedMemory());
  m->fd_ = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
  struct stat what {};
  if (m->fd_ < 0 || ::fstat(m->fd_, &what) != 0 || !S_ISREG(what.st_mode))
    throw Error(ExitCode::bad_input,
                fmt::format("cannot open '{}': {}", printable(path), std::strerror(errno)));
  m->bytes_ = static_cast<std::size_t>(what.st_size);
  void* p = ::mmap(nullptr, std::max<std::size_t>(m->bytes_, 1), PROT_READ, MAP_SHARED, m->fd_, 0);
  if (p == MAP_FAILED)
    throw Error(ExitCode::bad_input,
                fmt::format("cannot map '{}': {}", printable(path), std::strerror(errno)));
  m->data_ = static_cast<std::byte*>(p);
  return m;
}

SharedMemory::~SharedMemory() {
  if (data_ != nullptr) ::munmap(data_, std::max<std::size_t>(bytes_, 1));
  if (fd_ >= 0) ::close(fd_);
}

void SharedMemory::seal() {
  const std::size_t length = std::max<std::size_t>(bytes_, 1);
  ::munmap(data_, length);
  data_ = nullptr;
  writable_ = false;
  void* p = MAP_FAILED;
  if (::fcntl(fd_, F_ADD_SEALS, F_SEAL_WRITE | F_SEAL_SHRINK | F_SEAL_GROW | F_SEAL_SEAL) == 0)
    p = ::mmap(nullptr, length, PROT_READ, MAP_SHARED, fd_, 0);
  if (p == MAP_FAILED)
    throw Error(ExitCode::internal, fmt::format("cannot seal shared memory: {}", std::strerror(errno)));
  data_ = static_cast<std::byte*>(p);
}

}  // namespace gpuphys
