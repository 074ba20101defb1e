#include "core/run/confine.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <linux/landlock.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace gpuphys {
namespace {

// From later headers than Debian 12's.
constexpr unsigned long long kRefer = 1ull << 13, kTruncate = 1ull << 14, kIoctlDev = 1ull << 15;
constexpr unsigned long long kScopeAbstractSocket = 1ull << 0, kScopeSignal = 1ull << 1;
struct RulesetAttributes {
  unsigned long long handled_access_fs, handled_access_net, scoped;
};

constexpr unsigned long long kExecute = LANDLOCK_ACCESS_FS_EXECUTE, kReadFile = LANDLOCK_ACCESS_FS_READ_FILE,
                             kReadFolder = LANDLOCK_ACCESS_FS_READ_DIR,
                             kWriteFile = LANDLOCK_ACCESS_FS_WRITE_FILE;

class Ruleset {
 public:
  explicit Ruleset(int version) : handled_((1ull << 13) - 1) {
    if (version >= 2) handled_ |= kRefer;
    if (version >= 3) handled_ |= kTruncate;
    if (version >= 5) handled_ |= kIoctlDev;
    RulesetAttributes a{handled_, 0, version >= 6 ? kScopeAbstractSocket | kScopeSignal : 0};
    // Older kernels take a shorter structure; what lies beyond it is zero for them.
    const std::size_t size = version >= 6 ? sizeof a : version >= 4 ? 16 : 8;
    fd_ = static_cast<int>(::syscall(SYS_landlock_create_ruleset, &a, size, 0));
  }
  ~Ruleset() {
    if (fd_ >= 0) ::close(fd_);
  }
  bool valid() const { return fd_ >= 0; }

  // Paths that do not exist are passed over: machines differ.
  void allow(const std::string& path, unsigned long long access) {
    const int fd = ::open(path.c_str(), O_PATH | O_CLOEXEC);
    if (fd < 0) return;
    struct stat what {};
    ::fstat(fd, &what);
    if (!S_ISDIR(what.st_mode)) access &= kExecute | kReadFile | kWriteFile | kTruncate | kIoctlDev;
    landlock_path_beneath_attr rule{access & handled_, fd};
    ::syscall(SYS_landlock_add_rule, fd_, LANDLOCK_RULE_PATH_BENEATH, &rule, 0);
    ::close(fd);
  }
  bool enforce() { return ::syscall(SYS_landlock_restrict_self, fd_, 0) == 0; }

 private:
  unsigned long long handled_;
  int fd_ = -1;
};

// The devices that a GPU program opens. Never all of /dev: /dev/shm is memory that every process can read.
std::vector<std::string> devices() {
  std::vector<std::string> paths{"/dev/null",    "/dev/zero",        "/dev/full", "/dev/random",
                                 "/dev/urandom", "/dev/nvidia-caps", "/dev/dri"};
  if (DIR* folder = ::opendir("/dev")) {
    while (const dirent* entry = ::readdir(folder)) {
      if (std::strncmp(entry->d_name, "nvidia", 6) == 0)
        paths.push_back(std::string("/dev/") + entry->d_name);
    }
    ::closedir(folder);
  }
  return paths;
}

}  // namespace

std::string confine(const std::vector<std::string>& readable, bool own_namespace) {
  const long version = ::syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
  if (version < 1) return std::string("the kernel has no Landlock: ") + std::strerror(errno);
  Ruleset rules(static_cast<int>(version));
  if (!rules.valid()) return std::string("Landlock refused its rules: ") + std::strerror(errno);
  const unsigned long long read = kExecute | kReadFile | kReadFolder;
  for (const char* folder : {"/usr", "/lib", "/lib64", "/bin", "/etc", "/opt", "/sys", "/proc"})
    rules.allow(folder, read);
  for (const std::string& path : readable) rules.allow(path, read);
  for (const std::string& path : devices())
    rules.allow(path, kReadFile | kReadFolder | kWriteFile | kIoctlDev | kTruncate);
  // CUDA names its threads and asks the driver through these, some of them opened to be truncated; it does
  // not start without. In a namespace of its own /proc shows nobody else.
  const unsigned long long write = read | kWriteFile | kTruncate | kIoctlDev;
  if (own_namespace) rules.allow("/proc", write);
  rules.allow("/proc/self", write);
  rules.allow("/proc/driver", write);
  if (::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0 || !rules.enforce())
    return std::string("Landlock cannot be enforced: ") + std::strerror(errno);
  return "";
}

void limit_resources(unsigned long long memory_bytes) {
  const auto limit = [](auto which, rlim_t most) {
    const rlimit value{most, most};
    ::setrlimit(which, &value);
  };
  limit(RLIMIT_CORE, 0);
  limit(RLIMIT_FSIZE, 1 << 20);
  ::signal(SIGXFSZ, SIG_IGN);  // the write fails instead
  if (memory_bytes > 0) limit(RLIMIT_DATA, memory_bytes);
}

}  // namespace gpuphys
