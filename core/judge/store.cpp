#include "core/judge/store.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#define XXH_INLINE_ALL
#include <xxhash.h>

#include "core/base/files.hpp"
#include "core/base/parallel.hpp"
#include "core/base/text.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr std::size_t kPage = 4096;
constexpr const char* kFormat = "gpuphys raw 1";
constexpr std::uint64_t kGiB = std::uint64_t{1} << 30;

std::size_t pages(std::size_t bytes) {
  return (bytes + kPage - 1) / kPage * kPage;
}

// Pieces are hashed in parallel and combined in order, so that the digest does not depend on the number of
// threads.
std::string digest_of_bytes(const void* data, std::size_t bytes) {
  const auto n = static_cast<std::int64_t>(bytes);
  std::vector<XXH128_canonical_t> pieces(static_cast<std::size_t>(pieces_of(n)));
  parallel_pieces(n, [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
    XXH128_canonicalFromHash(
        &pieces[static_cast<std::size_t>(piece)],
        XXH3_128bits(static_cast<const char*>(data) + begin, static_cast<std::size_t>(end - begin)));
  });
  XXH128_canonical_t all;
  XXH128_canonicalFromHash(&all, XXH3_128bits(pieces.data(), pieces.size() * sizeof pieces[0]));
  std::string hex;
  for (const unsigned char byte : all.digest) hex += fmt::format("{:02x}", byte);
  return hex;
}

std::string digest_of_text(const std::string& text) {
  return digest_of_bytes(text.data(), text.size());
}

std::string text_of(const HostArray& a, const std::string& digest) {
  return fmt::format("{} {} {} {}\n", a.name(), to_string(a.dtype()), to_string(a.shape()), digest);
}

std::string text_of(const Scalar& s) {
  return fmt::format("{} {:a}\n", s.name, s.value);
}

std::string digest_of_stored(const Arrays& arrays, const std::vector<Scalar>& scalars,
                             const std::vector<std::string>& digests) {
  std::string text;
  for (std::size_t i = 0; i < arrays.size(); ++i) text += text_of(arrays[i], digests[i]);
  for (const Scalar& s : scalars) text += text_of(s);
  return digest_of_text(text);
}

// Held by one process at a time; the kernel releases it when the process ends, however it ends.
class FileLock {
 public:
  explicit FileLock(const std::string& path) : fd_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600)) {
    while (fd_ >= 0 && ::flock(fd_, LOCK_EX) != 0 && errno == EINTR) {
    }
  }
  ~FileLock() {
    if (fd_ >= 0) ::close(fd_);
  }
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;
  bool held() const { return fd_ >= 0; }

 private:
  int fd_;
};

std::uint64_t machine_memory() {
  return static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) *
         static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
}

std::uint64_t free_space(const std::string& folder) {
  struct statvfs s {};
  return ::statvfs(folder.c_str(), &s) == 0 ? std::uint64_t{s.f_bavail} * s.f_frsize : 0;
}

// A folder that nobody else can look into.
bool make_private(const std::string& folder) {
  std::error_code ec;
  fs::create_directories(folder, ec);
  return fs::is_directory(folder, ec) && ::chmod(folder.c_str(), 0700) == 0;
}

struct Entry {
  fs::path path;
  std::uint64_t bytes;
  fs::file_time_type used;
};

std::vector<Entry> entries_of(const std::string& root) {
  std::vector<Entry> all;
  std::error_code ec;
  for (auto it = fs::recursive_directory_iterator(root, ec); it != fs::recursive_directory_iterator();
       it.increment(ec)) {
    if (ec) break;
    std::error_code gone;  // by another process meanwhile
    if (it->path().extension() != ".raw") continue;
    const auto bytes = it->file_size(gone);
    const auto used = it->last_write_time(gone);
    if (!gone) all.push_back({it->path(), bytes, used});
  }
  return all;
}

}  // namespace

std::string digest_of(const Arrays& arrays) {
  std::vector<std::string> digests;
  for (const HostArray& a : arrays) digests.push_back(digest_of_bytes(a.data(), a.bytes()));
  return digest_of_stored(arrays, {}, digests);
}

std::string digest_of(const Problem& p) {
  std::vector<std::string> digests;
  for (const HostArray& a : p.inputs) digests.push_back(digest_of_bytes(a.data(), a.bytes()));
  return digest_of_stored(p.inputs, p.scalars, digests);
}

std::string memory_store_root() {
  return fmt::format("/dev/shm/gpuphys-{}", ::getuid());
}

Store::Store(std::string disk_root) : memory_root_(memory_store_root()), disk_root_(std::move(disk_root)) {
  const std::uint64_t memory = machine_memory();
  memory_budget_ = memory >= 64 * kGiB ? memory / 10 * 4 : memory / 20 * 3;
  if (const char* asked = std::getenv("GPUPHYS_STORE_GIB"))
    memory_budget_ =
        static_cast<std::uint64_t>(std::max(0.0, std::strtod(asked, nullptr)) * static_cast<double>(kGiB));
  if (free_space("/dev/shm") == 0) memory_budget_ = 0;
  disk_budget_ = 64 * kGiB;
}

std::optional<Stored> Store::find(const std::string& path) const {
  std::error_code ec;
  if (!fs::exists(path, ec)) return std::nullopt;
  try {
    const std::shared_ptr<SharedMemory> memory = SharedMemory::file(path);
    const auto* text = reinterpret_cast<const char*>(memory->data());
    const std::size_t head = std::min<std::size_t>(memory->bytes(), 256 * kPage);
    const std::size_t end = static_cast<std::size_t>(std::find(text, text + head, '\0') - text);
    const json j = json::parse(text, text + end);
    Stored found;
    found.digest = j.at("digest").get<std::string>();
    std::vector<std::string> digests;
    if (j.at("format") != kFormat) throw Error(ExitCode::bad_input, "another format");
    for (const json& a : j.at("arrays")) {
      found.arrays.emplace_back(a.at("name").get<std::string>(), static_cast<DType>(a.at("dtype").get<int>()),
                                a.at("shape").get<Shape>(), a.at("unit").get<std::string>(), memory,
                                a.at("offset").get<std::size_t>());
      digests.push_back(
          digest_of_bytes(std::as_const(found.arrays.back()).data(), found.arrays.back().bytes()));
    }
    for (const json& s : j.at("scalars")) {
      found.scalars.push_back({s.at("name").get<std::string>(), static_cast<DType>(s.at("dtype").get<int>()),
                               std::strtod(s.at("value").get<std::string>().c_str(), nullptr)});
    }
    if (digest_of_stored(found.arrays, found.scalars, digests) != found.digest)
      throw Error(ExitCode::bad_input, "its digests do not match its bytes");
    fs::last_write_time(path, fs::file_time_type::clock::now(), ec);  // used
    return found;
  } catch (const std::exception& e) {
    fmt::print(stderr, "gpuphys: '{}' cannot be used and is made again: {}\n", printable(path),
               printable(e.what()));
    fs::remove(path, ec);
    return std::nullopt;
  }
}

bool Store::keep(const std::string& root, std::uint64_t budget, const std::string& group,
                 const std::string& key, const Stored& made) const {
  json arrays = json::array(), scalars = json::array();
  std::size_t bytes = 0;
  for (const HostArray& a : made.arrays) bytes += pages(a.bytes());
  std::size_t header = pages(4096 * (1 + made.arrays.size() / 8));
  const std::uint64_t total = header + bytes;
  if (total > budget || !make_private(root) || !make_private(root + "/" + group)) return false;
  std::size_t offset = header;
  for (const HostArray& a : made.arrays) {
    arrays.push_back({{"name", a.name()},
                      {"dtype", static_cast<int>(a.dtype())},
                      {"shape", a.shape()},
                      {"unit", a.unit()},
                      {"offset", offset}});
    offset += pages(a.bytes());
  }
  for (const Scalar& s : made.scalars)
    scalars.push_back(
        {{"name", s.name}, {"dtype", static_cast<int>(s.dtype)}, {"value", fmt::format("{:a}", s.value)}});
  const std::string text =
      json{{"format", kFormat}, {"digest", made.digest}, {"arrays", arrays}, {"scalars", scalars}}.dump();
  if (text.size() >= header) return false;
  {
    const FileLock lock(root + "/lock");
    std::vector<Entry> entries = entries_of(root);
    std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.used < b.used; });
    std::uint64_t kept = 0;
    for (const Entry& e : entries) kept += e.bytes;
    std::error_code ec;
    for (const Entry& e : entries) {
      if (kept + total <= budget && free_space(root) > total + kGiB / 4) break;
      fs::remove(e.path, ec);  // whoever has it mapped keeps it
      kept -= e.bytes;
    }
    if (free_space(root) <= total + kGiB / 8) return false;
  }
  try {
    PendingFile file(fmt::format("{}/{}/{}.raw", root, group, key));
    const int fd = ::open(file.temporary_path().c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (fd < 0) return false;
    // Room is taken before anything is written through the mapping, where a full disk would be a signal.
    void* p = MAP_FAILED;
    if (::posix_fallocate(fd, 0, static_cast<off_t>(total)) == 0)
      p = ::mmap(nullptr, total, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    ::close(fd);
    if (p == MAP_FAILED) return false;
    auto* to = static_cast<char*>(p);
    std::memcpy(to, text.c_str(), text.size() + 1);
    offset = header;
    for (const HostArray& a : made.arrays) {
      const char* from = static_cast<const char*>(std::as_const(a).data());
      parallel_pieces(static_cast<std::int64_t>(a.bytes()),
                      [&](std::int64_t, std::int64_t begin, std::int64_t end) {
                        std::memcpy(to + offset + begin, from + begin, static_cast<std::size_t>(end - begin));
                      });
      offset += pages(a.bytes());
    }
    ::munmap(p, total);
    file.commit();
  } catch (const Error&) {
    return false;
  }
  return true;
}

Stored Store::obtain(const std::string& group, const std::string& key,
                     const std::function<Stored()>& make) const {
  const auto path_in = [&](const std::string& root) { return fmt::format("{}/{}/{}.raw", root, group, key); };
  const auto look = [&]() -> std::optional<Stored> {
    for (const std::string& root : {memory_root_, disk_root_}) {
      if (std::optional<Stored> found = find(path_in(root))) return found;
    }
    return std::nullopt;
  };
  if (std::optional<Stored> found = look()) return std::move(*found);
  // One maker at a time for each entry; the lock lies on disk, so that clearing the memory does not free it
  // early.
  const bool lockable = make_private(disk_root_) && make_private(disk_root_ + "/" + group);
  const FileLock lock(lockable ? fmt::format("{}/{}/{}.lock", disk_root_, group, key)
                               : std::string("/dev/null"));
  if (std::optional<Stored> found = look()) return std::move(*found);
  Stored made = make();
  std::vector<std::string> digests;
  for (const HostArray& a : made.arrays)
    digests.push_back(digest_of_bytes(std::as_const(a).data(), a.bytes()));
  made.digest = digest_of_stored(made.arrays, made.scalars, digests);
  if (keep(memory_root_, memory_budget_, group, key, made) ||
      keep(disk_root_, disk_budget_, group, key, made)) {
    if (std::optional<Stored> found = look()) return std::move(*found);
  }
  return made;
}

void Store::clear() const {
  std::error_code ec;
  for (const std::string& root : {memory_root_, disk_root_}) fs::remove_all(root, ec);
}

std::pair<std::uint64_t, std::uint64_t> Store::size() const {
  std::uint64_t sums[2] = {0, 0};
  for (int i = 0; i < 2; ++i) {
    for (const Entry& e : entries_of(i == 0 ? memory_root_ : disk_root_)) sums[i] += e.bytes;
  }
  return {sums[0], sums[1]};
}

}  // namespace gpuphys
