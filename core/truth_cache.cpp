#include "core/truth_cache.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>

#include "core/harness.hpp"
#include "core/hdf5_io.hpp"
#include "core/parallel.hpp"
#include "core/progress.hpp"
#include "core/sha256.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

/// Held by one process at a time; the kernel releases it when the process ends, however it ends.
class FileLock {
 public:
  explicit FileLock(const std::string& path) : fd_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666)) {
    if (fd_ < 0)
      throw Error(ExitCode::bad_input, fmt::format("cannot create '{}': {}", path, std::strerror(errno)));
    while (::flock(fd_, LOCK_EX) != 0) {
      if (errno == EINTR) continue;
      const int error = errno;
      ::close(fd_);
      throw Error(ExitCode::bad_input, fmt::format("cannot lock '{}': {}", path, std::strerror(error)));
    }
  }
  ~FileLock() { ::close(fd_); }
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  int fd_;
};

Arrays computed_truth(const Task& task, const InputSet& set, const Problem& problem,
                      const std::string& module_path) {
  if (set.known_solution) return set.known_solution(problem);
  const LoadedModule module(module_path);
  const std::string who = fmt::format("FP64 baseline of '{}' on '{}'", task.name, set.name);
  if (module.table().task != task.name || module.table().output_real != GPUPHYS_F64 || module.on_device()) {
    throw Error(ExitCode::module_fault,
                fmt::format("'{}' is not the FP64 host baseline of '{}'", module_path, task.name));
  }
  Progress progress(fmt::format("computing the {}", who), 0);
  CallReport report = make_host_backend()->call(module, task.contract, problem);
  if (!report.faults.empty()) {
    const FaultReport& f = report.faults.front();
    throw Error(ExitCode::module_fault, fmt::format("{}: {} ({})", who, to_string(f.fault), f.detail));
  }
  return std::move(report.outputs);
}

void require_usable(const Arrays& truth, const Task& task, const InputSet& set, const Problem& problem) {
  const auto symbols = resolve_symbols(task.contract, problem, "inputs");
  for (const ArraySpec& spec : task.contract.outputs) {
    const std::string where = fmt::format("truth of '{}' on '{}'", task.name, set.name);
    const HostArray& a = find(truth, spec.name, where);
    if (a.shape() != evaluate_shape(spec, symbols)) {
      throw Error(ExitCode::module_fault,
                  fmt::format("{}: array '{}' has shape {}, expected {}", where, spec.name,
                              to_string(a.shape()), to_string(evaluate_shape(spec, symbols))));
    }
    parallel_pieces(a.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        if (!std::isfinite(a.value(i))) {
          throw Error(ExitCode::module_fault,
                      fmt::format("{}: array '{}' is not finite at flat index {}", where, spec.name, i));
        }
      }
    });
  }
}

/// FP64 whatever it came as, in the contract's order, so that a cached truth and a fresh one are the same
/// thing.
Arrays as_stored(const Arrays& truth, const Task& task) {
  Arrays stored;
  for (const ArraySpec& spec : task.contract.outputs) {
    const HostArray& a = find(truth, spec.name, "truth");
    if (a.dtype() != DType::f32) {
      stored.push_back(a.clone());
      continue;
    }
    HostArray wide(a.name(), DType::f64, a.shape(), a.unit());
    const auto values = wide.as<double>();
    for (std::int64_t i = 0; i < a.size(); ++i) values[static_cast<std::size_t>(i)] = a.value(i);
    stored.push_back(std::move(wide));
  }
  return stored;
}

/// Truths of the same inputs by earlier builds: nobody will ask for them again, and each may take hundreds of
/// megabytes.
void remove_superseded(const fs::path& folder, const std::string& problem_key) {
  std::error_code ec;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ec)) {
    if (entry.path().extension() == ".h5" && entry.path().filename().string().starts_with(problem_key)) {
      fs::remove(entry.path(), ec);
    }
  }
}

}  // namespace

std::string digest_of(const Problem& problem) {
  Sha256 sum;
  for (const HostArray& a : problem.inputs) {
    sum.add(a.name());
    sum.add(to_string(a.dtype()) + to_string(a.shape()));
    sum.add(a.data(), a.bytes());
  }
  for (const Scalar& s : problem.scalars) {
    sum.add(s.name);
    sum.add(&s.value, sizeof s.value);
  }
  return sum.hex();
}

Arrays obtain_truth(const Task& task, const InputSet& set, const Problem& problem,
                    const std::string& module_path, const std::string& cache_dir) {
  std::error_code ec;
  // A known solution is part of this program.
  const std::string source =
      set.known_solution ? fs::read_symlink("/proc/self/exe", ec).string() : module_path;
  if (!fs::exists(source, ec)) {
    throw Error(ExitCode::unknown_name, fmt::format("the FP64 baseline module '{}' does not exist", source));
  }
  const fs::path folder = fs::path(cache_dir) / task.name;
  fs::create_directories(folder, ec);
  if (ec)
    throw Error(ExitCode::bad_input,
                fmt::format("cannot create folder '{}': {}", folder.string(), ec.message()));
  const std::string problem_key = fmt::format("{}-{:.16}-", set.name, digest_of(problem));
  const std::string name = fmt::format("{}{:.16}", problem_key, sha256_of_file(source));
  const std::string path = (folder / (name + ".h5")).string();

  const auto cached = [&]() -> std::optional<Arrays> {
    if (!fs::exists(path, ec)) return std::nullopt;
    try {
      Arrays truth = read_arrays(path, task, problem, DType::f64, Origin::own);
      require_usable(truth, task, set, problem);
      return truth;
    } catch (const Error& e) {
      if (e.code() == ExitCode::out_of_memory) throw;
      fmt::print(stderr, "note: truth is computed again because its cache file is unusable: {}\n", e.what());
      return std::nullopt;
    }
  };

  // Files appear whole, so that many processes can read one at the same time; only who has to compute it
  // waits for whoever may be doing so already.
  if (std::optional<Arrays> truth = cached()) return std::move(*truth);
  const FileLock lock((folder / (name + ".lock")).string());
  if (std::optional<Arrays> truth = cached()) return std::move(*truth);
  const Arrays fresh = computed_truth(task, set, problem, module_path);
  require_usable(fresh, task, set, problem);
  Arrays truth = as_stored(fresh, task);
  // A full disk costs the cache, not the result.
  try {
    remove_superseded(folder, problem_key);
    write_arrays(path, FileKind::truth, task, set.name, truth, set.truth_source, Storage::checksummed);
  } catch (const Error& e) {
    fmt::print(stderr, "note: truth is not cached: {}\n", e.what());
  }
  return truth;
}

}  // namespace gpuphys
