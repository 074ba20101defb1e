#include "core/base/sha256.hpp"

#include <fmt/format.h>
#include <openssl/evp.h>

#include <cstdint>

#include "core/base/error.hpp"
#include "core/base/files.hpp"

namespace gpuphys {
namespace {

EVP_MD_CTX* context_of(void* p) {
  return static_cast<EVP_MD_CTX*>(p);
}

void require(bool ok) {
  if (!ok) throw Error(ExitCode::internal, "OpenSSL cannot compute SHA-256");
}

}  // namespace

Sha256::Sha256() : context_(EVP_MD_CTX_new()) {
  require(context_ != nullptr && EVP_DigestInit_ex(context_of(context_), EVP_sha256(), nullptr) == 1);
}

Sha256::~Sha256() {
  EVP_MD_CTX_free(context_of(context_));
}

void Sha256::add(const void* data, std::size_t bytes) {
  require(EVP_DigestUpdate(context_of(context_), data, bytes) == 1);
}

void Sha256::add(const std::string& text) {
  const std::uint64_t length = text.size();
  add(&length, sizeof length);
  add(text.data(), text.size());
}

std::string Sha256::hex() {
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned int length = 0;
  require(EVP_DigestFinal_ex(context_of(context_), digest, &length) == 1);
  std::string text;
  for (unsigned int i = 0; i < length; ++i) text += fmt::format("{:02x}", digest[i]);
  return text;
}

std::string sha256_hex(const std::string& text) {
  Sha256 sum;
  sum.add(text.data(), text.size());
  return sum.hex();
}

std::string sha256_of_file(const std::string& path) {
  return sha256_hex(read_file(path));
}

}  // namespace gpuphys
