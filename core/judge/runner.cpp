#include "core/judge/runner.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <set>
#include <sstream>

#include "core/base/parallel.hpp"
#include "core/base/text.hpp"
#include "core/run/poison.hpp"

extern char** environ;

namespace gpuphys {
namespace {

namespace fs = std::filesystem;
using namespace boundary;

constexpr std::size_t kPage = 4096;
constexpr std::size_t kMostOutput = 16 * 1024;
constexpr std::size_t kMostFaults = 32;
constexpr std::uint64_t kGiB = std::uint64_t{1} << 30;

std::uint64_t machine_memory() {
  return static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) *
         static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
}
// What one runner may hold.
std::uint64_t memory_limit() {
  return std::max<std::uint64_t>(machine_memory() / 10 * 8, 2 * kGiB);
}

std::mutex children_mutex;
std::set<pid_t>& supervisors() {
  static std::set<pid_t> all;
  return all;
}

std::vector<pid_t> children_of(pid_t parent) {
  std::vector<pid_t> found;
  std::error_code ec;
  for (const auto& task : fs::directory_iterator(fmt::format("/proc/{}/task", parent), ec)) {
    std::ifstream in(task.path() / "children");
    for (pid_t child; in >> child;) found.push_back(child);
  }
  return found;
}

// Where no PID namespace could be had, what a runner left behind comes to this process, the nearest
// subreaper.
void kill_orphans() {
  for (int round = 0; round < 1000; ++round) {
    bool any = false;
    for (const pid_t child : children_of(::getpid())) {
      {
        const std::lock_guard lock(children_mutex);
        if (supervisors().contains(child)) continue;
      }
      any = true;
      ::kill(child, SIGKILL);
      ::waitpid(child, nullptr, 0);
    }
    if (!any) return;
  }
}

std::string program_in_path(const char* name) {
  std::istringstream path(std::getenv("PATH") != nullptr ? std::getenv("PATH") : "/usr/bin:/bin");
  for (std::string folder; std::getline(path, folder, ':');) {
    const std::string candidate = folder + "/" + name;
    if (::access(candidate.c_str(), X_OK) == 0) return candidate;
  }
  return "";
}

bool has_landlock() {
  return std::getenv("GPUPHYS_NO_LANDLOCK") == nullptr &&
         ::syscall(SYS_landlock_create_ruleset, nullptr, 0, 1) >= 1;
}

// What a runner may read besides the system's own files: its module, and libraries beside a user's module.
std::vector<std::string> readable_for(const std::string& module, const std::string& build_root) {
  std::error_code ec;
  const fs::path path = fs::weakly_canonical(module, ec);
  std::vector<std::string> readable{path.string()};
  const fs::path root = fs::weakly_canonical(build_root, ec);
  const bool of_suite = !build_root.empty() &&
                        std::mismatch(root.begin(), root.end(), path.begin(), path.end()).first == root.end();
  if (of_suite) return readable;
  for (const auto& entry : fs::directory_iterator(path.parent_path(), ec)) {
    if (entry.path().filename().string().find(".so") != std::string::npos)
      readable.push_back(entry.path().string());
  }
  return readable;
}

// Under bubblewrap the file system is what is bound here.
std::vector<std::string> bubblewrap(const std::string& program, const std::string& runner,
                                    const std::vector<std::string>& readable) {
  std::vector<std::string> words{
      program, "--die-with-parent", "--unshare-pid", "--proc",        "/proc", "--dev-bind", "/dev",
      "/dev",  "--tmpfs",           "/dev/shm",      "--ro-bind-try", "/sys",  "/sys"};
  for (const char* folder : {"/usr", "/lib", "/lib64", "/bin", "/etc", "/opt"})
    words.insert(words.end(), {"--ro-bind-try", folder, folder});
  for (const std::string& path : readable) words.insert(words.end(), {"--ro-bind-try", path, path});
  words.insert(words.end(), {"--ro-bind", runner, runner, "--"});
  return words;
}

void copy_name(char (&to)[kNameBytes], const std::string& name) {
  if (name.size() >= sizeof to) throw Error(ExitCode::internal, fmt::format("name '{}' is too long", name));
  std::memcpy(to, name.c_str(), name.size() + 1);
}

ArrayAt array_at(const HostArray& a, std::size_t offset, std::size_t descriptor) {
  ArrayAt at{};
  copy_name(at.name, a.name());
  at.dtype = static_cast<std::int32_t>(a.dtype());
  at.rank = static_cast<std::int32_t>(a.shape().size());
  std::copy(a.shape().begin(), a.shape().end(), at.shape);
  at.bytes = static_cast<std::int64_t>(a.bytes());
  at.offset = static_cast<std::int64_t>(offset);
  at.descriptor = static_cast<std::int32_t>(descriptor);
  return at;
}

// Fresh memory in which the array ends (to 64 bytes) where the last page does, so that the first byte beyond
// it cannot be touched.
HostArray shared_array(const std::string& name, DType dtype, const Shape& shape, const std::string& unit) {
  const std::size_t bytes = static_cast<std::size_t>(element_count(shape)) * size_of(dtype);
  const std::size_t length = (bytes + kPage - 1) / kPage * kPage;
  const auto memory = SharedMemory::anonymous(length, fmt::format("array '{}'", name));
  return HostArray(name, dtype, shape, unit, memory, length - (bytes + 63) / 64 * 64);
}

// What lies in the array's first and last page besides it holds this; the judge looks whether it still does.
constexpr std::byte kAround{0xC3};

template <class Body>
void for_each_byte_around(HostArray& a, Body&& body) {
  std::byte* const begin = a.shared()->data();
  const std::size_t at = a.shared_offset(), end = a.shared()->bytes();
  for (std::size_t i = at / kPage * kPage; i < at; ++i) body(begin[i], false);
  for (std::size_t i = at + a.bytes(); i < end; ++i) body(begin[i], true);
}

// The array itself if it lies in memory that nobody can write, else a sealed copy.
HostArray sealed(const HostArray& a) {
  HostArray copy = shared_array(a.name(), a.dtype(), a.shape(), a.unit());
  if (a.bytes() > 0) std::memcpy(copy.data(), a.data(), a.bytes());
  const std::size_t offset = copy.shared_offset();
  copy.shared()->seal();
  return HostArray(a.name(), a.dtype(), a.shape(), a.unit(), copy.shared(), offset);
}

ExitCode trusted_code(int status) {
  for (const ExitCode code : {ExitCode::unknown_name, ExitCode::module_fault, ExitCode::cuda_error,
                              ExitCode::out_of_memory, ExitCode::skipped}) {
    if (status == static_cast<int>(code)) return code;
  }
  return ExitCode::internal;
}

}  // namespace

Runner::Runner(const RunnerOptions& options, const std::string& module_path)
    : options_(options), module_path_(module_path) {
  if (!(std::isfinite(options_.timeout_s) && options_.timeout_s > 0))
    throw Error(ExitCode::usage,
                fmt::format("a time limit of {} s is not a positive number", options_.timeout_s));
  if (::access(options_.program.c_str(), X_OK) != 0)
    throw Error(ExitCode::unknown_name, fmt::format("the runner '{}' does not exist", options_.program));
  int ends[2], ending[2], out[2];
  if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0 || ::pipe2(ending, O_CLOEXEC) != 0 ||
      ::pipe2(out, O_CLOEXEC | O_NONBLOCK) != 0)
    throw Error(ExitCode::internal, fmt::format("cannot talk to a runner: {}", std::strerror(errno)));
  socket_ = ends[0];
  ending_ = ending[0];
  out_ = out[0];
  ::fcntl(ending_, F_SETFL, O_NONBLOCK);

  std::vector<std::string> words;
  const std::vector<std::string> readable = readable_for(module_path, options_.build_root);
  if (options_.under_tool) {
    words = {options_.program, "--unconfined", "a tool watches it", "--no-namespace"};
  } else if (has_landlock()) {
    words = {options_.program};
    for (const std::string& path : readable) words.insert(words.end(), {"--readable", path});
#ifndef __SANITIZE_ADDRESS__
    words.insert(words.end(), {"--memory", std::to_string(memory_limit())});
#endif
  } else if (const std::string wrapper = program_in_path("bwrap"); !wrapper.empty()) {
    words = bubblewrap(wrapper, options_.program, readable);
    words.insert(words.end(), {options_.program, "--unconfined", "bubblewrap", "--no-namespace"});
  } else {
    words = {options_.program, "--unconfined", "neither Landlock nor bubblewrap is there"};
  }
  std::vector<char*> arguments;
  for (std::string& w : words) arguments.push_back(w.data());
  arguments.push_back(nullptr);
  // Compiled code that the driver caches would outlive the runner.
  std::vector<std::string> variables{"CUDA_CACHE_DISABLE=1"};
  for (char** v = environ; *v != nullptr; ++v) variables.emplace_back(*v);
  std::vector<char*> environment;
  for (std::string& v : variables) environment.push_back(v.data());
  environment.push_back(nullptr);

  ::prctl(PR_SET_CHILD_SUBREAPER, 1);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  // The descriptors to be may be taken by those here: the new ones go high first.
  const int high[] = {::fcntl(ends[1], F_DUPFD_CLOEXEC, 64), ::fcntl(ending[1], F_DUPFD_CLOEXEC, 64),
                      ::fcntl(out[1], F_DUPFD_CLOEXEC, 64)};
  for (const int fd : {ends[1], ending[1], out[1]}) ::close(fd);
  posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, high[2], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, high[2], STDERR_FILENO);
  posix_spawn_file_actions_adddup2(&actions, high[0], kSocket);
  posix_spawn_file_actions_adddup2(&actions, high[1], kEnding);
  pid_t child = -1;
  int spawned = 0;
  {
    const std::lock_guard lock(children_mutex);
    spawned =
        ::posix_spawn(&child, words[0].c_str(), &actions, nullptr, arguments.data(), environment.data());
    if (spawned == 0) supervisors().insert(child);
  }
  posix_spawn_file_actions_destroy(&actions);
  for (const int fd : high) ::close(fd);
  if (spawned != 0) {
    end();
    throw Error(ExitCode::internal, fmt::format("cannot start '{}': {}", words[0], std::strerror(spawned)));
  }
  supervisor_ = child;
  const Report confined = expect(Tell::confined, deadline());
  unconfined_ = printable(bounded(confined.text, sizeof confined.text));
  if (unconfined_ == "bubblewrap") unconfined_.clear();
}

Runner::~Runner() {
  end();
}

void Runner::end() {
  if (supervisor_ > 0) {
    ::kill(supervisor_, SIGKILL);
    while (::waitpid(supervisor_, nullptr, 0) < 0 && errno == EINTR) {
    }
    {
      const std::lock_guard lock(children_mutex);
      supervisors().erase(supervisor_);
    }
    supervisor_ = -1;
    // With the supervisor the namespace's first process dies, and the kernel ends the rest before anybody can
    // wait for it; the socket's other end closes with the last of them.
    char byte;
    pollfd gone{socket_, POLLIN, 0};
    for (int i = 0; i < 200 && ::poll(&gone, 1, 50) >= 0; ++i) {
      kill_orphans();
      const ssize_t n = ::recv(socket_, &byte, 1, MSG_DONTWAIT);
      if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) break;
    }
    kill_orphans();
    drain_output();
  }
  for (int* fd : {&socket_, &ending_, &out_}) {
    if (*fd >= 0) ::close(*fd);
    *fd = -1;
  }
}

Runner::Clock::time_point Runner::deadline() const {
  return Clock::now() +
         std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options_.timeout_s));
}

void Runner::drain_output() {
  char buffer[4096];
  for (;;) {
    const ssize_t n = ::read(out_, buffer, sizeof buffer);
    if (n <= 0) return;
    // What was said last tells most.
    output_.append(buffer, static_cast<std::size_t>(n));
    if (output_.size() > 2 * kMostOutput) output_.erase(0, output_.size() - kMostOutput);
  }
}

std::vector<std::string> Runner::printed() const {
  std::vector<std::string> lines;
  std::istringstream in(output_.size() > kMostOutput ? output_.substr(output_.size() - kMostOutput)
                                                     : output_);
  for (std::string line; std::getline(in, line) && lines.size() < 64;) {
    if (!line.empty()) lines.push_back(printable(line, 300));
  }
  return lines;
}

std::uint64_t Runner::resident_bytes() const {
  std::uint64_t pages = 0;
  std::vector<pid_t> todo{supervisor_};
  for (std::size_t i = 0; i < todo.size() && i < 256; ++i) {
    std::ifstream in(fmt::format("/proc/{}/statm", todo[i]));
    std::uint64_t size = 0, resident = 0;
    if (in >> size >> resident) pages += resident;
    for (const pid_t child : children_of(todo[i])) todo.push_back(child);
  }
  return pages * kPage;
}

std::string Runner::how_it_ended() {
  int status = 0;
  pollfd p{ending_, POLLIN, 0};
  for (int i = 0; i < 40; ++i) {  // the pipe may say a little later than the socket
    if (::read(ending_, &status, sizeof status) == static_cast<ssize_t>(sizeof status)) {
      if (WIFSIGNALED(status))
        return fmt::format("its process died of signal {} ({})", WTERMSIG(status),
                           strsignal(WTERMSIG(status)));
      return fmt::format("its process ended with exit code {}", WEXITSTATUS(status));
    }
    ::poll(&p, 1, 50);
    if ((p.revents & POLLIN) == 0 && (p.revents & POLLHUP) != 0) break;
  }
  return "its process is gone";
}

void Runner::lost(const std::string& why, bool timed_out) {
  std::string text = why;
  for (const FaultReport& f : stray_faults_) text += fmt::format("; {}", f.detail);
  end();
  if (const std::vector<std::string> lines = printed(); !lines.empty())
    text += fmt::format("; it printed: {}", lines.back());
  throw RunnerLost(printable(text), timed_out);
}

void Runner::ask(const Request& request, const std::vector<int>& descriptors) {
  if (socket_ < 0) throw Error(ExitCode::internal, "the runner has ended");
  iovec part{const_cast<Request*>(&request), sizeof request};
  alignas(cmsghdr) char control[CMSG_SPACE(sizeof(int) * 2 * kMostArrays)];
  msghdr message{};
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  if (!descriptors.empty()) {
    message.msg_control = control;
    message.msg_controllen = CMSG_SPACE(sizeof(int) * descriptors.size());
    cmsghdr* c = CMSG_FIRSTHDR(&message);
    c->cmsg_level = SOL_SOCKET;
    c->cmsg_type = SCM_RIGHTS;
    c->cmsg_len = CMSG_LEN(sizeof(int) * descriptors.size());
    std::memcpy(CMSG_DATA(c), descriptors.data(), sizeof(int) * descriptors.size());
  }
  // A runner that does not read its socket must not stop the judge.
  if (::sendmsg(socket_, &message, MSG_NOSIGNAL | MSG_DONTWAIT) != static_cast<ssize_t>(sizeof request))
    lost(how_it_ended(), false);
}

Report Runner::answer(Clock::time_point until) {
  for (;;) {
    Report report{};
    const ssize_t n = ::recv(socket_, &report, sizeof report, MSG_DONTWAIT | MSG_TRUNC);
    drain_output();
    if (n == static_cast<ssize_t>(sizeof report) && report.magic == kMagic) {
      if (report.tell == Tell::refused) {
        const ExitCode code = trusted_code(report.status);
        const std::string text = printable(bounded(report.text, sizeof report.text));
        throw Error(code, text);
      }
      return report;
    }
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EWOULDBLOCK && errno != EINTR))
      lost(how_it_ended(), false);
    if (n > 0) lost("it sent what is no answer", false);
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(until - Clock::now()).count();
    if (left <= 0) lost(fmt::format("no answer within {:g} s", options_.timeout_s), true);
    pollfd fds[] = {{socket_, POLLIN, 0}, {out_, POLLIN, 0}};
    ::poll(fds, 2, static_cast<int>(std::min<long long>(left, 100)));
    if ((fds[1].revents & POLLHUP) != 0 && (fds[0].revents & POLLIN) == 0) ::poll(fds, 1, 20);
    if (fds[0].revents == 0 && resident_bytes() > memory_limit())
      lost(fmt::format("it took more than {} GiB of memory", memory_limit() / kGiB), false);
  }
}

Report Runner::expect(Tell what, Clock::time_point until) {
  const Report report = answer(until);
  if (report.tell != what) lost("it answered out of turn", false);
  return report;
}

GpuIdentity Runner::identify() {
  Request request{};
  request.magic = kMagic;
  request.ask = Ask::identify;
  ask(request, {});
  const Report report = expect(Tell::identity, deadline());
  GpuIdentity gpu;
  std::istringstream lines{std::string(bounded(report.text, sizeof report.text))};
  for (std::string* part : {&gpu.device, &gpu.driver, &gpu.toolkit}) {
    std::getline(lines, *part);
    *part = printable(*part, 120);
  }
  return gpu;
}

Ceilings Runner::ceilings() {
  Request request{};
  request.magic = kMagic;
  request.ask = Ask::ceilings;
  ask(request, {});
  const Report report = expect(Tell::ceilings, deadline());
  const double* v = report.values;
  return {v[0], v[1], v[2], v[3], v[4]};
}

void Runner::load(GpuUse gpu) {
  Request request{};
  request.magic = kMagic;
  request.ask = Ask::load;
  request.flags = gpu == GpuUse::needed    ? static_cast<std::uint32_t>(kNeedsGpu)
                  : gpu == GpuUse::unknown ? kMayUseGpu
                                           : 0u;
  const std::string path = fs::absolute(module_path_).string();
  if (path.size() >= sizeof request.path) throw Error(ExitCode::usage, "the module's path is too long");
  std::memcpy(request.path, path.c_str(), path.size() + 1);
  ask(request, {});
  const Report report = expect(Tell::loaded, deadline());
  if ((report.space != GPUPHYS_HOST && report.space != GPUPHYS_DEVICE) ||
      (report.output_real != GPUPHYS_F32 && report.output_real != GPUPHYS_F64))
    lost("its table makes no sense", false);
  task_ = printable(bounded(report.text, sizeof report.text), 64);
  space_ = report.space;
  output_real_ = static_cast<DType>(report.output_real);
}

CallReport Runner::call(const Contract& contract, const Problem& problem, const Call& how) {
  if (problem.inputs.size() > kMostArrays || contract.outputs.size() > kMostArrays ||
      problem.scalars.size() > kMostScalars)
    throw Error(ExitCode::internal, "more arrays or scalars than the boundary carries");
  CallReport result;
  Request request{};
  request.magic = kMagic;
  request.ask = Ask::call;
  request.flags =
      (how.timed ? kTimed : 0u) | (options_.under_tool ? kUnderTool : 0u) | (how.discard ? kDiscard : 0u);
  std::vector<int> descriptors;
  std::vector<HostArray> keep;  // inputs that had to be copied, until the answer is there
  keep.reserve(problem.inputs.size());
  for (std::size_t i = 0; i < problem.inputs.size(); ++i) {
    const HostArray* a = &problem.inputs[i];
    if (!a->shared() || a->shared()->writable()) {
      keep.push_back(sealed(*a));
      a = &keep.back();
    }
    descriptors.push_back(a->shared()->descriptor());
    ArrayAt& at = request.inputs[request.n_inputs++];
    at = array_at(*a, a->shared_offset(), descriptors.size() - 1);
    at.overwritable = contract.inputs[i].access == Access::overwritable ? 1 : 0;
  }
  const auto symbols = resolve_symbols(contract, problem, "inputs");
  for (const ArraySpec& spec : contract.outputs) {
    const bool floating = spec.dtype == DType::f32 || spec.dtype == DType::f64;
    result.outputs.push_back(shared_array(spec.name, floating ? output_real_ : spec.dtype,
                                          evaluate_shape(spec, symbols), spec.unit));
    HostArray& a = result.outputs.back();
    for_each_byte_around(a, [](std::byte& b, bool) { b = kAround; });
    descriptors.push_back(a.shared()->descriptor());
    request.outputs[request.n_outputs++] = array_at(a, a.shared_offset(), descriptors.size() - 1);
  }
  for (const Scalar& s : problem.scalars) {
    ScalarAt& at = request.scalars[request.n_scalars++];
    copy_name(at.name, s.name);
    at.dtype = static_cast<std::int32_t>(s.dtype);
    at.value = s.value;
  }

  const auto until = deadline();
  stray_faults_.clear();
  ask(request, descriptors);
  std::optional<Clock::time_point> started, stopped;
  bool delivered = false;
  for (bool done = false; !done;) {
    const Report report = answer(until);
    switch (report.tell) {
      case Tell::starting:
        if (started) lost("it answered out of turn", false);
        started = Clock::now();
        break;
      case Tell::stopped:
        if (!started || stopped) lost("it answered out of turn", false);
        stopped = Clock::now();
        break;
      case Tell::fault:
        if (report.status < 0 || report.status >= kFaults)
          lost("it reported a fault that does not exist", false);
        if (stray_faults_.size() < kMostFaults)
          stray_faults_.push_back(
              {static_cast<Fault>(report.status), printable(bounded(report.text, sizeof report.text))});
        break;
      case Tell::done:
        done = true;
        delivered = report.status == 0;
        result.milliseconds = report.values[0];
        break;
      default:
        lost("it answered out of turn", false);
    }
  }
  if (delivered && !(started && stopped)) lost("it delivered without having computed", false);
  if (started && stopped)
    result.wall_ms = std::chrono::duration<double, std::milli>(*stopped - *started).count();
  result.faults = std::move(stray_faults_);
  stray_faults_.clear();
  if (how.last) end();
  if (how.discard) {
    result.outputs.clear();
    return result;
  }
  for (HostArray& a : result.outputs) {
    int before = 0, past = 0;
    for_each_byte_around(a, [&](const std::byte& b, bool behind) {
      if (b != kAround) ++(behind ? past : before);
    });
    if (before + past == 0) continue;
    result.faults.push_back({Fault::out_of_bounds_write,
                             fmt::format("output '{}': wrote {} bytes before its start and {} past its end",
                                         a.name(), before, past)});
  }
  if (!how.last && delivered) {
    // The runner goes on, and may write to what it delivered: the judge looks at a copy.
    for (HostArray& a : result.outputs) a = a.clone();
  }
  if (!delivered) {
    result.outputs.clear();
    if (result.faults.empty()) result.faults.push_back({Fault::returned_error, "it delivered nothing"});
  }
  inspect_outputs(result);
  return result;
}

void inspect_outputs(CallReport& report) {
  for (const HostArray& a : report.outputs) {
    const std::size_t element = size_of(a.dtype());
    std::vector<std::int64_t> counts(static_cast<std::size_t>(pieces_of(a.size())));
    parallel_pieces(a.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      counts[static_cast<std::size_t>(piece)] =
          count_poison(static_cast<const std::byte*>(a.data()) + static_cast<std::size_t>(begin) * element,
                       end - begin, static_cast<std::int32_t>(a.dtype()));
    });
    std::int64_t poisoned = 0;
    for (const std::int64_t n : counts) poisoned += n;
    if (poisoned > 0) {
      report.faults.push_back(
          {Fault::unwritten_output,
           fmt::format("output '{}': {} of {} elements were never written", a.name(), poisoned, a.size())});
      continue;
    }
    if (a.dtype() != DType::f32 && a.dtype() != DType::f64) continue;
    struct Bad {
      std::int64_t n = 0, first = -1;
    };
    std::vector<Bad> found(static_cast<std::size_t>(pieces_of(a.size())));
    parallel_pieces(a.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      Bad& here = found[static_cast<std::size_t>(piece)];
      for (std::int64_t i = begin; i < end; ++i) {
        if (std::isfinite(a.value(i))) continue;
        if (here.first < 0) here.first = i;
        ++here.n;
      }
    });
    std::int64_t n = 0, first = -1;
    for (const Bad& here : found) {
      n += here.n;
      if (first < 0) first = here.first;
    }
    if (n > 0) {
      report.faults.push_back(
          {Fault::non_finite_output, fmt::format("output '{}': {} of {} elements, first at flat index {}",
                                                 a.name(), n, a.size(), first)});
    }
  }
}

CallReport run_once(const RunnerOptions& options, const std::string& module_path, GpuUse gpu,
                    const Contract& contract, const Problem& problem) {
  Runner runner(options, module_path);
  runner.load(gpu);
  return runner.call(contract, problem, {});
}

}  // namespace gpuphys
