// Runs modules on the GPU without trusting them. Every buffer a module sees lies between two guard bands in
// one device allocation:
//
//     | guard 4 MiB | data, 256-byte aligned | guard up to the next 256 bytes and 4 MiB more |
//
// The trailing guard begins at the first byte past the data, so that writing one element too many is seen.
//
// Outputs are copied on the device right behind the stop event: what is judged is what was there when the
// clock stopped, not what a thread or a stream that was left running made of it later.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <limits>
#include <list>
#include <string_view>

#include "core/base/error.hpp"
#include "core/base/text.hpp"
#include "core/run/caller.hpp"
#include "core/run/gpu/allocate_watch.hpp"
#include "core/run/gpu/ceilings.hpp"
#include "core/run/gpu/cuda_call.hpp"
#include "core/run/gpu/device_kernels.hpp"
#include "core/run/guarded_call.hpp"

namespace gpuphys {
namespace {

using Clock = std::chrono::steady_clock;

// Wide: an overrun by a row or a plane must not reach the next buffer.
constexpr std::size_t kGuardBytes = std::size_t{4} << 20;
constexpr std::size_t kAlignment = 256;
constexpr unsigned char kGuardByte = 0xC3;

// Device work that outlives compute()'s own stream order by less than this cannot be told from the cost of
// asking, and is not called a fault. What of it exceeds that cost counts in the reported time.
constexpr double kLateMilliseconds = 0.02;
// The same as a fraction of the call, and as a multiple of what waiting for an idle device costs.
constexpr double kLateFraction = 0.02;
constexpr double kLateIdleWaits = 4;

// What module.hpp's adapter puts before the text of an error that a launch left behind.
constexpr std::string_view kAdapterLaunchError = "kernel launch: ";

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

class GuardedBuffer {
 public:
  GuardedBuffer(std::size_t bytes, const std::string& what)
      : bytes_(bytes),
        tail_bytes_((bytes + kAlignment - 1) / kAlignment * kAlignment - bytes + kGuardBytes),
        memory_(kGuardBytes + bytes + tail_bytes_, what) {}

  std::size_t bytes() const { return bytes_; }
  unsigned char* data() const { return memory_.data() + kGuardBytes; }

  void raise_guards() const {
    GPUPHYS_CUDA_CALL(cudaMemsetAsync(memory_.data(), kGuardByte, kGuardBytes));
    GPUPHYS_CUDA_CALL(cudaMemsetAsync(data() + bytes_, kGuardByte, tail_bytes_));
  }
  void count_damage(std::uint64_t* counter) const {
    device::count_other_bytes(memory_.data(), kGuardBytes, kGuardByte, counter);
    device::count_other_bytes(data() + bytes_, tail_bytes_, kGuardByte, counter);
  }
  // Where the changed bytes of damaged guards lie.
  std::string describe_damage() const {
    std::vector<unsigned char> band(std::max(kGuardBytes, tail_bytes_));
    const auto changed = [](unsigned char b) { return b != kGuardByte; };
    std::vector<std::string> places;
    GPUPHYS_CUDA_CALL(cudaMemcpy(band.data(), memory_.data(), kGuardBytes, cudaMemcpyDeviceToHost));
    const auto head_end = band.begin() + static_cast<std::ptrdiff_t>(kGuardBytes);
    if (const auto n = std::count_if(band.begin(), head_end, changed); n > 0) {
      const auto last = std::find_if(std::make_reverse_iterator(head_end), band.rend(), changed);
      places.push_back(fmt::format("{} bytes before its start, the nearest {} bytes away", n,
                                   last - std::make_reverse_iterator(head_end) + 1));
    }
    GPUPHYS_CUDA_CALL(cudaMemcpy(band.data(), data() + bytes_, tail_bytes_, cudaMemcpyDeviceToHost));
    const auto tail_end = band.begin() + static_cast<std::ptrdiff_t>(tail_bytes_);
    if (const auto n = std::count_if(band.begin(), tail_end, changed); n > 0) {
      const auto first = std::find_if(band.begin(), tail_end, changed);
      places.push_back(
          fmt::format("{} bytes past its end, the first at byte {}", n, bytes_ + (first - band.begin())));
    }
    return fmt::format("{}", fmt::join(places, "; "));
  }

 private:
  std::size_t bytes_, tail_bytes_;
  DeviceMemory memory_;
};

// The buffers of one combination of shapes, kept from call to call.
struct Buffers {
  std::vector<std::size_t> key;
  std::vector<GuardedBuffer> inputs, outputs;
  std::vector<DeviceMemory> snapshots;  // of the outputs
  DeviceMemory counters;                // damage of each buffer, then the inputs' hashes before and after
};

// Timing alternates between two input sets, which may differ in shape.
constexpr std::size_t kCachedShapes = 2;

class DeviceCaller final : public Caller {
 public:
  DeviceCaller() {
    int device = 0, l2_bytes = 0;
    GPUPHYS_CUDA_CALL(cudaGetDevice(&device));
    GPUPHYS_CUDA_CALL(cudaDeviceGetAttribute(&l2_bytes, cudaDevAttrL2CacheSize, device));
    flush_bytes_ = std::max<std::size_t>(2 * static_cast<std::size_t>(l2_bytes), std::size_t{64} << 20);
    flush_bytes_ = flush_bytes_ / kAlignment * kAlignment;
    scratch_ = DeviceMemory(2 * flush_bytes_ + kAlignment, "flushing the L2 cache");
    GPUPHYS_CUDA_CALL(cudaMemset(scratch_.data(), 0, scratch_.bytes()));
  }

  CallOutcome call(const LoadedModule& module, const CallProblem& problem,
                   const CallMoments& moments) override {
    CallOutcome outcome = call_once(module, problem, moments);
    const auto late = [](const FaultReport& f) { return f.fault == Fault::asynchronous_return; };
    if (problem.under_tool) std::erase_if(outcome.faults, late);
    if (lost_ || std::none_of(outcome.faults.begin(), outcome.faults.end(), late)) return outcome;
    // A host thread that was suspended at the wrong moment looks like late device work. Not twice in a row.
    const CallOutcome again = call_once(module, problem, {});
    if (!lost_ && std::none_of(again.faults.begin(), again.faults.end(), late))
      std::erase_if(outcome.faults, late);
    return outcome;
  }

 private:
  CallOutcome call_once(const LoadedModule& module, const CallProblem& problem, const CallMoments& moments) {
    if (lost_) {
      throw Error(ExitCode::cuda_error,
                  fmt::format("the GPU cannot be used any more in this process: {}", lost_why_));
    }
    const gpuphys_module& table = module.table();
    CallOutcome outcome;
    const Buffers& buffers = buffers_for(problem);
    (void)cudaGetLastError();

    char message[kMessageSize] = "";
    void* state = nullptr;
    const CallProblem::View shapes = problem.view();
    const gpuphys_problem shape_view = shapes.problem();
    AllocateWatch watch;
    watch.start();
    const int allocated =
        guarded_call(message, [&] { return table.allocate(&state, &shape_view, message, sizeof message); });
    if (const std::string work = watch.stop(); !work.empty())
      outcome.faults.push_back({Fault::work_in_allocate, fmt::format("allocate() called {}", work)});
    note_cuda_error(outcome, "allocate()", allocated != 0);
    if (allocated != 0) {
      outcome.faults.push_back({Fault::returned_error,
                                fmt::format("allocate(): {}", printable(bounded(message, sizeof message)))});
    }
    if (lost_) return outcome;
    if (allocated != 0) {
      if (state != nullptr) release(outcome, table, state);
      return outcome;
    }

    upload(buffers, problem);
    CallProblem::View view = problem.view();
    for (std::size_t i = 0; i < buffers.inputs.size(); ++i) view.inputs[i].data = buffers.inputs[i].data();
    for (std::size_t i = 0; i < buffers.outputs.size(); ++i) view.outputs[i].data = buffers.outputs[i].data();
    const gpuphys_problem data_view = view.problem();

    message[0] = '\0';
    const int computed =
        timed_compute(outcome, table, state, data_view, message, buffers, problem.timed, moments);
    if (computed != 0) {
      const std::string said = printable(bounded(message, sizeof message));
      const bool launch = said.starts_with(kAdapterLaunchError);
      outcome.faults.push_back({launch ? Fault::launch_failed : Fault::returned_error,
                                fmt::format("compute(): {}", said.empty() ? "no message" : said)});
    }
    if (lost_) return outcome;  // the context is gone: nothing can be read, and releasing would only fail

    inspect_buffers(outcome, buffers, problem);
    for (std::size_t i = 0; i < problem.outputs.size(); ++i) {
      const CallArray& a = problem.outputs[i];
      if (a.bytes == 0 || problem.discard) continue;
      GPUPHYS_CUDA_CALL(cudaMemcpy(a.data, buffers.snapshots[i].data(), a.bytes, cudaMemcpyDeviceToHost));
    }
    release(outcome, table, state);
    outcome.delivered = true;
    return outcome;
  }

  // Everything from the start event to the stop event. The caller sees compute()'s own result.
  int timed_compute(CallOutcome& report, const gpuphys_module& table, void* state,
                    const gpuphys_problem& view, char* message, const Buffers& buffers, bool timed,
                    const CallMoments& moments) {
    if (timed) bring_clocks_up();
    // Lines that an earlier call marked as persisting would survive the flush.
    (void)cudaCtxResetPersistingL2Cache();
    (void)cudaGetLastError();
    if (timed) flush_l2();
    const IdleCost idle = idle_cost();

    moments.starting();
    GPUPHYS_CUDA_CALL(cudaEventRecord(start_.get()));
    const int computed =
        guarded_call(message, [&] { return table.compute(state, &view, message, kMessageSize); });
    // The legacy stream waits for every ordinary stream, so this event comes after all work that compute()
    // ordered properly. Whatever still runs afterwards was left on a stream that orders itself before
    // nothing.
    cudaError_t status = cudaEventRecord(ordered_.get());
    if (status == cudaSuccess) status = cudaEventSynchronize(ordered_.get());
    const auto began = Clock::now();
    const cudaError_t drained = cudaDeviceSynchronize();
    const double late = milliseconds_since(began);
    if (status == cudaSuccess) status = drained;
    if (status == cudaSuccess) status = cudaEventRecord(stop_.get());
    if (status == cudaSuccess) take_snapshots(buffers);
    if (status == cudaSuccess) status = cudaEventSynchronize(stop_.get());
    moments.stopped();
    float ordered = 0, after = 0;
    if (status == cudaSuccess) status = cudaEventElapsedTime(&ordered, start_.get(), ordered_.get());
    if (status == cudaSuccess) status = cudaEventElapsedTime(&after, ordered_.get(), stop_.get());
    // The device is idle at the stop event, whatever compute() left running. Asking for that takes the host
    // some ten microseconds, measured beforehand, which are not compute()'s; what goes beyond them is.
    if (status == cudaSuccess) {
      const double beyond = after > idle.largest_gap ? after - idle.smallest_gap : 0;
      report.milliseconds = ordered + beyond;
    }

    note_cuda_error(report, "compute()", computed != 0, status);
    if (status == cudaSuccess && late > std::max({kLateMilliseconds, kLateFraction * report.milliseconds,
                                                  kLateIdleWaits * idle.wait})) {
      report.faults.push_back(
          {Fault::asynchronous_return,
           fmt::format("the device worked for {:.3f} ms more after everything that compute() had ordered "
                       "before the legacy stream (counted in its time)",
                       late)});
    }
    return computed;
  }

  static void take_snapshots(const Buffers& b) {
    for (std::size_t i = 0; i < b.outputs.size(); ++i) {
      if (b.outputs[i].bytes() == 0) continue;
      (void)cudaMemcpyAsync(b.snapshots[i].data(), b.outputs[i].data(), b.outputs[i].bytes(),
                            cudaMemcpyDeviceToDevice);
    }
  }

  // A pending or given CUDA error becomes launch_failed; one that outlives being cleared has destroyed the
  // context. Where the module itself returned an error (`told`), its own message says more than a pending
  // error does.
  void note_cuda_error(CallOutcome& report, const char* where, bool told, cudaError_t given = cudaSuccess) {
    const cudaError_t pending = cudaGetLastError();
    cudaError_t status = given != cudaSuccess ? given : pending;
    const cudaError_t still = cudaDeviceSynchronize();
    if (still != cudaSuccess) {
      if (status == cudaSuccess) status = still;
      // Kernels that failed asynchronously leave every later call failing; others are gone once reported.
      (void)cudaGetLastError();
      lost_ = cudaDeviceSynchronize() != cudaSuccess;
    }
    if (status == cudaSuccess || (told && !lost_)) return;
    lost_why_ = fmt::format("{}: {}", where, cuda_error_text(status));
    report.faults.push_back({Fault::launch_failed, lost_why_ + (lost_ ? " (the CUDA context is lost)" : "")});
  }

  // Inputs and outputs of the call to come leave the cache: dirty lines are forced out by writing more than
  // it holds, and then replaced by clean ones, so that compute() does not pay for writing them back.
  void flush_l2() {
    GPUPHYS_CUDA_CALL(cudaMemsetAsync(scratch_.data(), 0, flush_bytes_));
    device::read_all(scratch_.data() + flush_bytes_, flush_bytes_,
                     reinterpret_cast<std::uint32_t*>(scratch_.data() + 2 * flush_bytes_));
    GPUPHYS_CUDA_CALL(cudaDeviceSynchronize());
  }

  // What the wait for late work costs when there is none: the extremes of a few, in ms.
  struct IdleCost {
    double wait = 0;  // on the host, the largest
    double smallest_gap = std::numeric_limits<double>::infinity(), largest_gap = 0;  // between the two events
  };
  IdleCost idle_cost() {
    IdleCost cost;
    for (int i = 0; i < 5; ++i) {
      GPUPHYS_CUDA_CALL(cudaEventRecord(ordered_.get()));
      GPUPHYS_CUDA_CALL(cudaEventSynchronize(ordered_.get()));
      const auto began = Clock::now();
      GPUPHYS_CUDA_CALL(cudaDeviceSynchronize());
      cost.wait = std::max(cost.wait, milliseconds_since(began));
      GPUPHYS_CUDA_CALL(cudaEventRecord(stop_.get()));
      GPUPHYS_CUDA_CALL(cudaEventSynchronize(stop_.get()));
      float gap = 0;
      GPUPHYS_CUDA_CALL(cudaEventElapsedTime(&gap, ordered_.get(), stop_.get()));
      cost.smallest_gap = std::min<double>(cost.smallest_gap, gap);
      cost.largest_gap = std::max<double>(cost.largest_gap, gap);
    }
    return cost;
  }

  const Buffers& buffers_for(const CallProblem& problem) {
    std::vector<std::size_t> key;
    for (const CallArray& a : problem.inputs) key.push_back(a.bytes);
    key.push_back(~std::size_t{0});
    for (const CallArray& a : problem.outputs) key.push_back(a.bytes);
    const auto found =
        std::find_if(cache_.begin(), cache_.end(), [&](const Buffers& b) { return b.key == key; });
    if (found != cache_.end()) {
      cache_.splice(cache_.begin(), cache_, found);
      return cache_.front();
    }
    while (cache_.size() >= kCachedShapes) cache_.pop_back();
    try {
      cache_.push_front(make_buffers(key, problem));
    } catch (const Error& e) {
      if (e.code() != ExitCode::out_of_memory || cache_.empty()) throw;
      cache_.clear();  // what another shape holds may be what is missing
      cache_.push_front(make_buffers(key, problem));
    }
    return cache_.front();
  }

  static Buffers make_buffers(const std::vector<std::size_t>& key, const CallProblem& problem) {
    Buffers b;
    b.key = key;
    for (const CallArray& a : problem.inputs)
      b.inputs.emplace_back(a.bytes, fmt::format("input '{}'", a.abi.name));
    for (const CallArray& a : problem.outputs) {
      b.outputs.emplace_back(a.bytes, fmt::format("output '{}'", a.abi.name));
      b.snapshots.emplace_back(std::max<std::size_t>(a.bytes, 1),
                               fmt::format("snapshot of output '{}'", a.abi.name));
    }
    b.counters = DeviceMemory(sizeof(std::uint64_t) * (3 * b.inputs.size() + b.outputs.size()), "counters");
    return b;
  }

  static std::uint64_t* counter(const Buffers& b, std::size_t i) {
    return reinterpret_cast<std::uint64_t*>(b.counters.data()) + i;
  }

  static void upload(const Buffers& b, const CallProblem& problem) {
    GPUPHYS_CUDA_CALL(cudaMemset(b.counters.data(), 0, b.counters.bytes()));
    const std::size_t n = b.inputs.size() + b.outputs.size();
    for (std::size_t i = 0; i < b.inputs.size(); ++i) {
      const CallArray& a = problem.inputs[i];
      b.inputs[i].raise_guards();
      if (a.bytes > 0)
        GPUPHYS_CUDA_CALL(cudaMemcpy(b.inputs[i].data(), a.original, a.bytes, cudaMemcpyHostToDevice));
      device::hash(b.inputs[i].data(), a.bytes, counter(b, n + 2 * i));
    }
    for (std::size_t i = 0; i < b.outputs.size(); ++i) {
      const CallArray& a = problem.outputs[i];
      b.outputs[i].raise_guards();
      // One element holds the pattern of its type; the device repeats it.
      std::uint64_t element = 0;
      fill_poison(&element, 1, a.abi.dtype);
      const std::int64_t count = count_of(a);
      if (count > 0)
        device::fill(b.outputs[i].data(), static_cast<std::size_t>(count), &element,
                     a.bytes / static_cast<std::size_t>(count));
    }
    GPUPHYS_CUDA_CALL(cudaDeviceSynchronize());
  }

  static void inspect_buffers(CallOutcome& report, const Buffers& b, const CallProblem& problem) {
    const std::size_t n_in = b.inputs.size(), n_out = b.outputs.size(), n = n_in + n_out;
    for (std::size_t i = 0; i < n_in; ++i) {
      b.inputs[i].count_damage(counter(b, i));
      device::hash(b.inputs[i].data(), b.inputs[i].bytes(), counter(b, n + 2 * i + 1));
    }
    for (std::size_t i = 0; i < n_out; ++i) b.outputs[i].count_damage(counter(b, n_in + i));
    std::vector<std::uint64_t> counters(b.counters.bytes() / sizeof(std::uint64_t));
    GPUPHYS_CUDA_CALL(
        cudaMemcpy(counters.data(), b.counters.data(), b.counters.bytes(), cudaMemcpyDeviceToHost));

    const auto guards = [&](std::size_t i, const char* kind, const CallArray& a,
                            const GuardedBuffer& buffer) {
      if (counters[i] == 0) return;
      report.faults.push_back({Fault::out_of_bounds_write,
                               fmt::format("{} '{}': wrote {}", kind, a.abi.name, buffer.describe_damage())});
    };
    for (std::size_t i = 0; i < n_out; ++i) guards(n_in + i, "output", problem.outputs[i], b.outputs[i]);
    for (std::size_t i = 0; i < n_in; ++i) {
      guards(i, "input", problem.inputs[i], b.inputs[i]);
      if (problem.inputs[i].overwritable || counters[n + 2 * i] == counters[n + 2 * i + 1]) continue;
      std::vector<std::byte> now(b.inputs[i].bytes());
      GPUPHYS_CUDA_CALL(cudaMemcpy(now.data(), b.inputs[i].data(), now.size(), cudaMemcpyDeviceToHost));
      report.faults.push_back({Fault::input_modified, describe_change(problem.inputs[i], now.data())});
    }
  }

  void release(CallOutcome& report, const gpuphys_module& table, void* state) {
    char message[kMessageSize] = "";
    const int released = guarded_call(message, [&] {
      table.release(state);
      return 0;
    });
    if (released != 0)
      report.faults.push_back(
          {Fault::returned_error, fmt::format("release(): {}", printable(bounded(message, sizeof message)))});
    note_cuda_error(report, "release()", false);
  }

  DeviceMemory scratch_;
  std::size_t flush_bytes_ = 0;
  DeviceEvent start_, ordered_, stop_;
  std::list<Buffers> cache_;
  bool lost_ = false;
  std::string lost_why_;
};

}  // namespace

std::unique_ptr<Caller> make_device_caller() {
  require_gpu();  // before any member touches the device
  return std::make_unique<DeviceCaller>();
}

}  // namespace gpuphys
