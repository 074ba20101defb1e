#include "core/harness.hpp"

#include <dlfcn.h>
#include <fmt/format.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "core/guarded_call.hpp"
#include "core/parallel.hpp"

namespace gpuphys {
namespace {

// Quiet NaNs whose payloads spell a pattern that arithmetic does not produce (it yields 0x7FC00000 /
// 0x7FF8...).
constexpr std::uint32_t kPoison32 = 0x7FE5A5A5u;
constexpr std::uint64_t kPoison64 = 0x7FFCA5A5A5A5A5A5ull;
constexpr unsigned char kPoisonByte = 0xA5;

constexpr std::size_t kGuardBytes = 64 * 1024;
constexpr unsigned char kGuardByte = 0xC3;

// A host buffer between two guard bands.
class GuardedBuffer {
 public:
  explicit GuardedBuffer(std::size_t bytes)
      : bytes_(bytes), memory_(bytes + 2 * kGuardBytes, std::byte{kGuardByte}) {}
  void* data() { return memory_.data() + kGuardBytes; }
  /// Bytes of the guard bands that changed.
  std::size_t damage() const {
    std::size_t n = 0;
    for (std::size_t i = 0; i < kGuardBytes; ++i) {
      n += memory_[i] != std::byte{kGuardByte};
      n += memory_[kGuardBytes + bytes_ + i] != std::byte{kGuardByte};
    }
    return n;
  }

 private:
  std::size_t bytes_;
  std::vector<std::byte> memory_;
};

template <class T>
std::int64_t count_equal(const HostArray& a, T pattern) {
  std::atomic<std::int64_t> total = 0;
  parallel_pieces(a.size(), [&](std::int64_t, std::int64_t begin, std::int64_t end) {
    std::int64_t n = 0;
    for (std::int64_t i = begin; i < end; ++i) {
      T v;
      std::memcpy(&v, static_cast<const char*>(a.data()) + static_cast<std::size_t>(i) * sizeof(T),
                  sizeof(T));
      n += v == pattern;
    }
    total += n;
  });
  return total;
}

template <class T>
void fill(HostArray& a, T pattern) {
  for (std::int64_t i = 0; i < a.size(); ++i) {
    std::memcpy(static_cast<char*>(a.data()) + static_cast<std::size_t>(i) * sizeof(T), &pattern, sizeof(T));
  }
}

class HostBackend final : public Backend {
 public:
  CallReport call(const LoadedModule& module, const Contract& contract, const Problem& problem) override {
    const gpuphys_module& table = module.table();
    CallReport report;
    Arrays outputs = make_outputs(contract, problem, static_cast<DType>(table.output_real));

    const AbiProblem shapes = abi_problem(problem, outputs, false);
    char message[kMessageSize] = "";
    void* state = nullptr;
    const gpuphys_problem shape_view = shapes.problem();
    const int allocated =
        guarded_call(message, [&] { return table.allocate(&state, &shape_view, message, sizeof message); });
    if (allocated != 0) {
      report.faults.push_back({Fault::returned_error, fmt::format("allocate(): {}", message)});
      if (state != nullptr) table.release(state);
      return report;
    }

    AbiProblem abi = abi_problem(problem, outputs, false);
    std::vector<GuardedBuffer> inputs, results;
    for (std::size_t i = 0; i < problem.inputs.size(); ++i) {
      const HostArray& a = problem.inputs[i];
      inputs.emplace_back(a.bytes());
      std::memcpy(inputs.back().data(), a.data(), a.bytes());
    }
    for (HostArray& a : outputs) {
      fill_poison(a);
      results.emplace_back(a.bytes());
      std::memcpy(results.back().data(), a.data(), a.bytes());
    }
    for (std::size_t i = 0; i < inputs.size(); ++i) abi.inputs[i].data = inputs[i].data();
    for (std::size_t i = 0; i < results.size(); ++i) abi.outputs[i].data = results[i].data();

    const gpuphys_problem view = abi.problem();
    const auto start = std::chrono::steady_clock::now();
    const int status =
        guarded_call(message, [&] { return table.compute(state, &view, message, sizeof message); });
    const auto stop = std::chrono::steady_clock::now();
    report.milliseconds = std::chrono::duration<double, std::milli>(stop - start).count();
    if (status != 0) report.faults.push_back({Fault::returned_error, fmt::format("compute(): {}", message)});

    for (std::size_t i = 0; i < results.size(); ++i) {
      std::memcpy(outputs[i].data(), results[i].data(), outputs[i].bytes());
      if (const std::size_t n = results[i].damage(); n > 0) {
        report.faults.push_back(
            {Fault::out_of_bounds_write,
             fmt::format("output '{}': {} bytes of its guard bands changed", outputs[i].name(), n)});
      }
    }
    for (std::size_t i = 0; i < inputs.size(); ++i) {
      const HostArray& a = problem.inputs[i];
      if (const std::size_t n = inputs[i].damage(); n > 0) {
        report.faults.push_back(
            {Fault::out_of_bounds_write,
             fmt::format("input '{}': {} bytes of its guard bands changed", a.name(), n)});
      }
      if (contract.inputs[i].access == Access::read_only &&
          std::memcmp(inputs[i].data(), a.data(), a.bytes()) != 0) {
        report.faults.push_back(
            {Fault::input_modified, fmt::format("input '{}' changed during compute()", a.name())});
      }
    }
    table.release(state);
    report.outputs = std::move(outputs);
    inspect_outputs(report);
    return report;
  }
};

}  // namespace

std::string to_string(Fault fault) {
  switch (fault) {
    case Fault::returned_error:
      return "returned_error";
    case Fault::launch_failed:
      return "launch_failed";
    case Fault::out_of_bounds_write:
      return "out_of_bounds_write";
    case Fault::input_modified:
      return "input_modified";
    case Fault::unwritten_output:
      return "unwritten_output";
    case Fault::non_finite_output:
      return "non_finite_output";
    case Fault::asynchronous_return:
      return "asynchronous_return";
    case Fault::work_in_allocate:
      return "work_in_allocate";
    case Fault::stale_output:
      return "stale_output";
    case Fault::zero_output:
      return "zero_output";
    case Fault::copied_input:
      return "copied_input";
    case Fault::below_floor:
      return "below_floor";
  }
  return "unknown";
}

LoadedModule::LoadedModule(const std::string& path) : path_(path) {
  if (!std::filesystem::exists(path)) {
    throw Error(ExitCode::unknown_name, fmt::format("module '{}' does not exist", path));
  }
  handle_ = dlopen(std::filesystem::absolute(path).c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle_ == nullptr)
    throw Error(ExitCode::module_fault, fmt::format("cannot load module: {}", dlerror()));
  using Entry = const gpuphys_module* (*)();
  const auto entry = reinterpret_cast<Entry>(dlsym(handle_, "gpuphys_get_module"));
  const auto refuse = [&](const std::string& why) {
    dlclose(handle_);
    throw Error(ExitCode::module_fault, fmt::format("'{}' is not a gpuphys module: {}", path, why));
  };
  if (entry == nullptr) refuse("it does not export gpuphys_get_module");
  table_ = entry();
  if (table_ == nullptr) refuse("gpuphys_get_module returned null");
  if (table_->abi_version != GPUPHYS_ABI_VERSION) {
    refuse(fmt::format("its interface version is {}, this suite speaks {}", table_->abi_version,
                       GPUPHYS_ABI_VERSION));
  }
  if (table_->allocate == nullptr || table_->compute == nullptr || table_->release == nullptr ||
      table_->task == nullptr) {
    refuse("a function of its table is missing");
  }
}

LoadedModule::~LoadedModule() {
  // Never unloaded: CUDA modules register kernels with the runtime, and unloading them while a context lives
  // is not safe.
}

void fill_poison(HostArray& a) {
  switch (a.dtype()) {
    case DType::f32:
    case DType::i32:
      return fill(a, kPoison32);
    case DType::f64:
      return fill(a, kPoison64);
    case DType::boolean:
      return fill(a, kPoisonByte);
  }
}

std::int64_t count_poison(const HostArray& a) {
  switch (a.dtype()) {
    case DType::f32:
    case DType::i32:
      return count_equal(a, kPoison32);
    case DType::f64:
      return count_equal(a, kPoison64);
    case DType::boolean:
      return count_equal(a, kPoisonByte);
  }
  return 0;
}

void inspect_outputs(CallReport& report) {
  for (const HostArray& a : report.outputs) {
    if (const std::int64_t n = count_poison(a); n > 0) {
      report.faults.push_back(
          {Fault::unwritten_output,
           fmt::format("output '{}': {} of {} elements were never written", a.name(), n, a.size())});
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

std::vector<FaultReport> diagnose(const Problem& problem, const Arrays& outputs, const Arrays* truth,
                                  const Arrays* earlier) {
  const auto all_zero = [](const HostArray& a) {
    for (std::int64_t i = 0; i < a.size(); ++i) {
      if (a.value(i) != 0) return false;
    }
    return true;
  };
  const auto same_bytes = [](const HostArray& a, const HostArray& b) {
    return a.dtype() == b.dtype() && a.bytes() == b.bytes() &&
           std::memcmp(a.data(), b.data(), a.bytes()) == 0;
  };
  std::vector<FaultReport> found;
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    const HostArray& out = outputs[i];
    const bool truth_is_zero = truth != nullptr && i < truth->size() && all_zero((*truth)[i]);
    if (all_zero(out)) {
      if (!truth_is_zero)
        found.push_back({Fault::zero_output, fmt::format("output '{}' is zero everywhere", out.name())});
      continue;
    }
    if (earlier != nullptr && i < earlier->size() && same_bytes(out, (*earlier)[i])) {
      found.push_back({Fault::stale_output,
                       fmt::format("output '{}' is bitwise that of the previous call, which had other inputs",
                                   out.name())});
    }
    for (const HostArray& in : problem.inputs) {
      if (same_bytes(out, in)) {
        found.push_back(
            {Fault::copied_input, fmt::format("output '{}' is bitwise input '{}'", out.name(), in.name())});
      }
    }
  }
  return found;
}

std::unique_ptr<Backend> make_host_backend() {
  return std::make_unique<HostBackend>();
}

std::unique_ptr<Backend> make_backend(const LoadedModule& module) {
  return module.on_device() ? make_device_backend() : make_host_backend();
}

}  // namespace gpuphys
