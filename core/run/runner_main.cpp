// gpuphys-runner: loads one module and calls it as the judge asks (core/run/boundary.hpp). Not meant to be
// started by hand.
//
//     gpuphys-runner [--readable PATH]... [--memory BYTES] [--unconfined WHY] [--no-namespace]
//
// Three processes, so that nothing outlives a verdict:
//
//     supervisor   started by the judge, killed with it
//       init       the first process of a PID namespace, where one can be had: when it ends, the kernel kills
//       the rest
//         worker   confined, opens the module
#include <fcntl.h>
#include <fmt/format.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <new>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/error.hpp"
#include "core/base/text.hpp"
#include "core/run/boundary.hpp"
#include "core/run/caller.hpp"
#include "core/run/confine.hpp"
#include "core/run/gpu/ceilings.hpp"

namespace gpuphys {
namespace {

using namespace boundary;

constexpr std::size_t kPage = 4096;
constexpr std::size_t kGuardBytes = std::size_t{256} << 20;  // of address space on both sides of an array

struct Options {
  std::vector<std::string> readable;
  unsigned long long memory = 0;
  std::string unconfined;
  bool name_space = true;
};

void copy_text(char* to, std::size_t size, std::string_view text) {
  const std::size_t n = std::min(size - 1, text.size());
  std::memcpy(to, text.data(), n);
  to[n] = '\0';
}

void tell(const Report& report) {
  // Without a judge there is nobody to work for.
  if (::send(kSocket, &report, sizeof report, MSG_NOSIGNAL) != static_cast<ssize_t>(sizeof report))
    ::_exit(kCannotStart);
}

Report report_of(Tell what, int status = 0, std::string_view text = "") {
  Report r{};
  r.magic = kMagic;
  r.tell = what;
  r.status = status;
  copy_text(r.text, sizeof r.text, text);
  return r;
}

// ---- arrays in shared memory, each between guards that cannot be touched ----

struct Region {
  char what[kNameBytes + 16];
  std::byte *begin = nullptr, *end = nullptr;  // the data
};
constexpr int kMostRegions = 2 * kMostArrays;
Region regions[kMostRegions];
int n_regions = 0;

class Mapped {
 public:
  Mapped(int fd, const ArrayAt& at, int protection, int flags) {
    const auto offset = static_cast<std::size_t>(at.offset), bytes = static_cast<std::size_t>(at.bytes);
    const std::size_t first = offset / kPage * kPage,
                      length = (offset + bytes + kPage - 1) / kPage * kPage - first;
    reserved_ = length + 2 * kGuardBytes;
    void* space = ::mmap(nullptr, reserved_, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (space == MAP_FAILED) throw std::bad_alloc();
    space_ = static_cast<std::byte*>(space);
    if (length > 0 && ::mmap(space_ + kGuardBytes, length, protection, flags | MAP_FIXED, fd,
                             static_cast<off_t>(first)) == MAP_FAILED) {
      ::munmap(space_, reserved_);
      throw std::bad_alloc();
    }
    data_ = space_ + kGuardBytes + (offset - first);
  }
  ~Mapped() {
    if (space_ != nullptr) ::munmap(space_, reserved_);
  }
  Mapped(Mapped&& o) noexcept : space_(o.space_), data_(o.data_), reserved_(o.reserved_) {
    o.space_ = nullptr;
  }
  Mapped(const Mapped&) = delete;
  Mapped& operator=(const Mapped&) = delete;
  std::byte* data() const { return data_; }

 private:
  std::byte *space_ = nullptr, *data_ = nullptr;
  std::size_t reserved_ = 0;
};

// Says which array an access beyond its end belongs to, then lets the signal do what it does.
void on_bad_access(int signal, siginfo_t* info, void*) {
  const auto* at = static_cast<const std::byte*>(info->si_addr);
  for (int i = 0; i < n_regions; ++i) {
    const Region& r = regions[i];
    if (at + kGuardBytes < r.begin || at >= r.end + kGuardBytes) continue;
    Report report{};
    report.magic = kMagic;
    report.tell = Tell::fault;
    report.status = static_cast<int>(Fault::out_of_bounds_write);
    if (at < r.begin)
      std::snprintf(report.text, sizeof report.text, "%s: an access %td bytes before its start", r.what,
                    r.begin - at);
    else if (at >= r.end)
      std::snprintf(report.text, sizeof report.text, "%s: an access %td bytes past its end", r.what,
                    at - r.end);
    else
      continue;
    (void)::send(kSocket, &report, sizeof report, MSG_NOSIGNAL | MSG_DONTWAIT);
    break;
  }
  ::signal(signal, SIG_DFL);  // the access is repeated
}

void watch_bad_accesses() {
  static std::array<std::byte, 64 * 1024> stack;
  const stack_t alternate{stack.data(), 0, stack.size()};
  ::sigaltstack(&alternate, nullptr);
  struct sigaction action {};
  action.sa_sigaction = on_bad_access;
  action.sa_flags = SA_SIGINFO | SA_ONSTACK;
  for (const int signal : {SIGSEGV, SIGBUS}) ::sigaction(signal, &action, nullptr);
}

void note_region(const char* kind, const CallArray& a) {
  if (n_regions >= kMostRegions) return;
  Region& r = regions[n_regions++];
  std::snprintf(r.what, sizeof r.what, "%s '%s'", kind, a.abi.name);
  r.begin = a.data;
  r.end = a.data + a.bytes;
}

// ---- requests ----

struct Received {
  Request request;
  std::vector<int> descriptors;
  ~Received() {
    for (const int fd : descriptors) ::close(fd);
  }
};

bool receive(Received& r) {
  iovec part{&r.request, sizeof r.request};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int) * 2 * kMostArrays)];
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control;
  message.msg_controllen = sizeof control;
  const ssize_t n = ::recvmsg(kSocket, &message, MSG_CMSG_CLOEXEC);
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level != SOL_SOCKET || c->cmsg_type != SCM_RIGHTS) continue;
    const std::size_t count = (c->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    r.descriptors.resize(count);
    std::memcpy(r.descriptors.data(), CMSG_DATA(c), count * sizeof(int));
  }
  return n == static_cast<ssize_t>(sizeof r.request) && r.request.magic == kMagic;
}

class Worker {
 public:
  void serve() {
    for (;;) {
      Received r;
      if (!receive(r)) return;
      try {
        answer(r);
      } catch (const Error& e) {
        tell(report_of(Tell::refused, static_cast<int>(e.code()), e.what()));
      } catch (const std::bad_alloc&) {
        tell(report_of(Tell::refused, static_cast<int>(ExitCode::out_of_memory), "out of host memory"));
      } catch (const std::exception& e) {
        tell(report_of(Tell::refused, static_cast<int>(ExitCode::internal), e.what()));
      }
    }
  }

 private:
  void answer(const Received& r) {
    switch (r.request.ask) {
      case Ask::identify: {
        const GpuIdentity gpu = gpu_identity();
        return tell(
            report_of(Tell::identity, 0, fmt::format("{}\n{}\n{}", gpu.device, gpu.driver, gpu.toolkit)));
      }
      case Ask::ceilings: {
        if (module_) throw Error(ExitCode::internal, "ceilings are measured before a module is loaded");
        const Ceilings c = measure_ceilings();
        Report report = report_of(Tell::ceilings);
        const double values[] = {c.copy_GBps, c.read_GBps, c.fp32_TFLOPs, c.launch_us, c.l2_MiB};
        std::copy(std::begin(values), std::end(values), report.values);
        return tell(report);
      }
      case Ask::load:
        return load(r.request);
      case Ask::call:
        return call(r);
    }
    throw Error(ExitCode::internal, "unknown request");
  }

  void load(const Request& request) {
    std::unique_ptr<Caller> device;
    std::string no_gpu;
    if ((request.flags & (kNeedsGpu | kMayUseGpu)) != 0) {
      try {
        device = make_device_caller();
      } catch (const Error& e) {
        if (e.code() != ExitCode::skipped || (request.flags & kNeedsGpu) != 0) throw;
        no_gpu = e.what();
      }
    }
    module_ = std::make_unique<LoadedModule>(std::string(bounded(request.path, sizeof request.path)));
    if (!module_->on_device()) {
      caller_ = make_host_caller();
    } else if (device) {
      caller_ = std::move(device);
    } else {
      throw Error(no_gpu.empty() ? ExitCode::module_fault : ExitCode::skipped,
                  no_gpu.empty() ? "a module of the CPU lane wants its data on the device" : no_gpu);
    }
    Report report = report_of(Tell::loaded, 0, module_->task());
    report.space = module_->table().space;
    report.output_real = module_->table().output_real;
    tell(report);
  }

  void call(const Received& r) {
    if (!module_) throw Error(ExitCode::internal, "no module is loaded");
    const Request& q = r.request;
    CallProblem problem;
    problem.timed = (q.flags & kTimed) != 0;
    problem.under_tool = (q.flags & kUnderTool) != 0;
    problem.discard = (q.flags & kDiscard) != 0;
    std::vector<Mapped> mappings;
    n_regions = 0;
    const auto map = [&](const ArrayAt& at, int protection, int flags) {
      mappings.emplace_back(r.descriptors.at(static_cast<std::size_t>(at.descriptor)), at, protection, flags);
      return mappings.back().data();
    };
    const auto array = [](const ArrayAt& at, std::byte* data) {
      CallArray a;
      a.abi.name = at.name;
      a.abi.dtype = at.dtype;
      a.abi.rank = at.rank;
      std::copy(std::begin(at.shape), std::end(at.shape), a.abi.shape);
      a.bytes = static_cast<std::size_t>(at.bytes);
      a.data = data;
      a.overwritable = at.overwritable != 0;
      return a;
    };
    for (int i = 0; i < q.n_inputs; ++i) {
      // The module's own copy of pages that it writes; the judge's stay what they are.
      CallArray a = array(q.inputs[i], map(q.inputs[i], PROT_READ | PROT_WRITE, MAP_PRIVATE));
      a.original = map(q.inputs[i], PROT_READ, MAP_SHARED);
      note_region("input", a);
      problem.inputs.push_back(a);
    }
    for (int i = 0; i < q.n_outputs; ++i) {
      const CallArray a = array(q.outputs[i], map(q.outputs[i], PROT_READ | PROT_WRITE, MAP_SHARED));
      note_region("output", a);
      problem.outputs.push_back(a);
    }
    for (int i = 0; i < q.n_scalars; ++i)
      problem.scalars.push_back({q.scalars[i].name, q.scalars[i].dtype, q.scalars[i].value});

    CallMoments moments;
    moments.starting = [] { tell(report_of(Tell::starting)); };
    moments.stopped = [] { tell(report_of(Tell::stopped)); };
    const CallOutcome outcome = caller_->call(*module_, problem, moments);
    for (const FaultReport& f : outcome.faults)
      tell(report_of(Tell::fault, static_cast<int>(f.fault), printable(f.detail, kTextBytes - 1)));
    Report done = report_of(Tell::done, outcome.delivered ? 0 : 1);
    done.values[0] = outcome.milliseconds;
    tell(done);
    n_regions = 0;
  }

  std::unique_ptr<LoadedModule> module_;
  std::unique_ptr<Caller> caller_;
};

// Folders of the libraries that this program itself runs on, wherever they lie.
std::vector<std::string> own_libraries() {
  std::set<std::string> folders;
  std::ifstream maps("/proc/self/maps");
  for (std::string line; std::getline(maps, line);) {
    const std::size_t slash = line.find('/');
    if (slash == std::string::npos || line.find(".so") == std::string::npos) continue;
    folders.insert(std::filesystem::path(line.substr(slash)).parent_path().string());
  }
  if (const char* path = std::getenv("LD_LIBRARY_PATH")) {
    for (std::size_t at = 0; std::string_view(path).size() > at;) {
      const std::string_view rest = std::string_view(path).substr(at);
      const std::size_t n = std::min(rest.find(':'), rest.size());
      if (n > 0) folders.insert(std::string(rest.substr(0, n)));
      at += n + 1;
    }
  }
  return {folders.begin(), folders.end()};
}

[[noreturn]] void work(const Options& o, bool own_namespace) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  ::setsid();
  ::close_range(kEnding, ~0u, 0);
  // The program file and its loader are needed only until now.
  limit_resources(o.memory);
  std::string unconfined = o.unconfined;
  if (unconfined.empty()) {
    std::vector<std::string> readable = o.readable;
    for (std::string& folder : own_libraries()) readable.push_back(std::move(folder));
    unconfined = confine(readable, own_namespace);
  }
  watch_bad_accesses();
  tell(report_of(Tell::confined, 0, unconfined));
  Worker().serve();
  ::_exit(0);
}

// Waits for the worker and passes on how it ended. In a namespace of its own this is the first process:
// orphans come to it, and all end with it.
[[noreturn]] void init(const Options& o, bool own_namespace) {
  if (own_namespace) {
    ::prctl(PR_SET_PDEATHSIG, SIGKILL);
    // /proc must be that of the namespace: CUDA looks itself up there by its process id. And memory that
    // other processes share is out of sight.
    own_namespace = ::mount("proc", "/proc", "proc", MS_NOSUID | MS_NODEV | MS_NOEXEC, nullptr) == 0;
    (void)!::mount("tmpfs", "/dev/shm", "tmpfs", MS_NOSUID | MS_NODEV, "size=64m");
  }
  const pid_t worker = ::fork();
  if (worker == 0) work(o, own_namespace);
  ::close(kSocket);
  int status = 0;
  for (;;) {
    int ended = 0;
    const pid_t child = ::wait(&ended);
    if (child < 0 && errno == EINTR) continue;
    if (child == worker) status = ended;
    if (child == worker || child < 0) break;
  }
  (void)!::write(kEnding, &status, sizeof status);
  ::_exit(0);
}

[[noreturn]] void supervise(const Options& o) {
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);
  const bool own_namespace = o.name_space &&
                             (::unshare(CLONE_NEWPID | CLONE_NEWNS) == 0 ||
                              ::unshare(CLONE_NEWUSER | CLONE_NEWPID | CLONE_NEWNS) == 0) &&
                             ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0;
  if (!own_namespace) init(o, false);  // the judge looks for what is left over
  const pid_t first = ::fork();
  if (first < 0) ::_exit(kCannotStart);
  if (first == 0) init(o, true);
  ::close(kSocket);
  ::close(kEnding);
  int status = 0;
  while (::waitpid(first, &status, 0) < 0 && errno == EINTR) {
  }
  ::_exit(0);
}

Options parse(int argc, char** argv) {
  Options o;
  for (int i = 1; i < argc; ++i) {
    const std::string_view word = argv[i];
    const auto value = [&] { return i + 1 < argc ? std::string(argv[++i]) : std::string(); };
    if (word == "--readable") o.readable.push_back(value());
    if (word == "--memory") o.memory = std::strtoull(value().c_str(), nullptr, 10);
    if (word == "--unconfined") o.unconfined = value();
    if (word == "--no-namespace") o.name_space = false;
  }
  return o;
}

}  // namespace
}  // namespace gpuphys

#ifdef __SANITIZE_ADDRESS__
// The check at exit wants to trace its own process, which a confined one cannot; and modules end as they
// please.
extern "C" int __lsan_is_turned_off() {
  return 1;
}
#endif

int main(int argc, char** argv) {
  if (::fcntl(gpuphys::boundary::kSocket, F_GETFD) < 0) {
    std::fputs("gpuphys-runner is started by gpuphys, which judges what it runs\n", stderr);
    return static_cast<int>(gpuphys::ExitCode::usage);
  }
  gpuphys::supervise(gpuphys::parse(argc, argv));
}
