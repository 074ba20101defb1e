// SHA-256 of bytes (OpenSSL's implementation).
#pragma once

#include <cstddef>
#include <memory>
#include <string>

namespace gpuphys {

class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(const Sha256&) = delete;
  Sha256& operator=(const Sha256&) = delete;

  void add(const void* data, std::size_t bytes);
  /// A string with its length, so that neighbouring strings cannot be confused with each other.
  void add(const std::string& text);
  /// 64 lower-case hexadecimal digits. Ends the computation.
  std::string hex();

 private:
  void* context_;
};

std::string sha256_hex(const std::string& text);
/// Of a file's bytes. Throws Error(bad_input) when it cannot be read.
std::string sha256_of_file(const std::string& path);

}  // namespace gpuphys
