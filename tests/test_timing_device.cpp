// The whole timing path on the GPU with slowdowns of known size: the unchanged module timed again is OK, the
// ones with 1.1, 1.25 and 2 times the work are SLOW. GPUPHYS_SLOWDOWN_MODULES holds x1.00.so, x1.00_again.so,
// x1.10.so, x1.25.so and x2.00.so. Exit code 77 without a GPU.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"
#include "core/measure/protocol.hpp"
#include "core/measure/timing.hpp"
#include "tests/slowdown_modules/target.hpp"

namespace {

using namespace gpuphys;
using slowdown_target::Inputs;
using slowdown_target::Outputs;

// 256 MiB in, 256 MiB out: far beyond the cache, and 10 % of the time are well over 5 us.
constexpr std::int64_t kSize = std::int64_t{1} << 26;
constexpr std::int64_t kBlock = 1 << 20;
constexpr int kRepeatsOfUnchanged = 5;

Problem make_inputs(std::uint64_t seed) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"n", kSize}});
  const std::span<float> u = p.inputs[0].as<float>();
  parallel_for(kSize / kBlock, [&](std::int64_t block) {
    for (std::int64_t i = block * kBlock; i < (block + 1) * kBlock; ++i) {
      u[static_cast<std::size_t>(i)] =
          static_cast<float>(random_bits(seed, 0, static_cast<std::uint64_t>(i)) % 4096) / 4096.0f;
    }
  });
  return p;
}

std::vector<std::string> judge(const Problem& p, const CallReport& report) {
  const std::span<const float> u = p.inputs[0].as<float>();
  const std::span<const float> v = report.outputs[0].as<float>();
  std::vector<char> wrong(static_cast<std::size_t>(kSize / kBlock), 0);
  parallel_for(kSize / kBlock, [&](std::int64_t block) {
    for (std::int64_t i = block * kBlock; i < (block + 1) * kBlock; ++i) {
      const auto at = static_cast<std::size_t>(i);
      if (!(v[at] == u[at] + 1)) wrong[static_cast<std::size_t>(block)] = 1;
    }
  });
  for (const char w : wrong) {
    if (w != 0) return {"wrong values"};
  }
  return {};
}

struct Bench {
  GpuIdentity gpu;
  Ceilings ceilings;
  Problem timed = make_inputs(1), other = make_inputs(2);

  static std::unique_ptr<Runner> start(const std::string& name) {
    const RunnerOptions options{.program = GPUPHYS_RUNNER_PROGRAM,
                                .timeout_s = 60,
                                .under_tool = false,
                                .build_root = GPUPHYS_BUILD_ROOT};
    return std::make_unique<Runner>(options, std::string(GPUPHYS_SLOWDOWN_MODULES) + "/" + name + ".so");
  }
  Bench() {
    const auto runner = start("x1.00");
    gpu = runner->identify();
    ceilings = runner->ceilings();
  }

  TimingResult time(const std::string& name) {
    const TimedSide one{&timed, [&](const CallReport& r, const Arrays*) { return judge(timed, r); }};
    const TimedSide two{&other, nullptr};
    const auto loaded = [&] {
      auto runner = start(name);
      runner->load(GpuUse::needed);
      return runner;
    };
    const std::vector<double> times =
        time_module(loaded, describe<Inputs, Outputs<float>>(), one, two).milliseconds;
    return timing_result("slowdown_target", name, "public", times, 8.0 * kSize, 0, ceilings, gpu);
  }
};

// One verdict: two timings where the first says SLOW, as `gpuphys time` makes them.
GateState verdict(Bench& bench, const std::string& name, const HistoryEntry& record) {
  TimingResult first = bench.time(name);
  GateState state = apply_gate(first, bench.ceilings, &record).state;
  std::printf("%-12s %.4f ms, %.3f x record, limit %.3f: %s", name.c_str(), first.median_ms,
              first.multiple / record.multiple, first.gate.limit / record.multiple, first.gate.state.c_str());
  if (state == GateState::slow || state == GateState::noisy) {
    TimingResult second = bench.time(name);
    state = confirmed_state(state, apply_gate(second, bench.ceilings, &record).state);
    std::printf("; again %.4f ms: %s", second.median_ms, second.gate.state.c_str());
  }
  std::printf("\n");
  std::fflush(stdout);
  return state;
}

int run() {
  Bench bench;
  const Ceilings& c = bench.ceilings;
  std::printf(
      "%s, driver %s, %s: copy %.0f GB/s, read %.0f GB/s, FP32 %.1f TFLOP/s, launch %.2f us, L2 %.0f MiB\n",
      bench.gpu.device.c_str(), bench.gpu.driver.c_str(), bench.gpu.toolkit.c_str(), c.copy_GBps, c.read_GBps,
      c.fp32_TFLOPs, c.launch_us, c.l2_MiB);
  const TimingResult first = bench.time("x1.00");
  HistoryEntry record;
  record.median_ms = first.median_ms;
  record.multiple = first.multiple;
  record.spread = noise_spread(first.times_ms);
  std::printf("record       %.4f ms, %.2f x floor, spread %.2f %% (middle half %.2f %%)\n", record.median_ms,
              record.multiple, 100 * first.spread, 100 * record.spread);
  int failures = 0;
  const auto expect = [&](const std::string& name, GateState wanted) {
    const GateState found = verdict(bench, name, record);
    if (found == wanted) return;
    std::fprintf(stderr, "%s: the gate says %s, expected %s\n", name.c_str(), to_string(found).c_str(),
                 to_string(wanted).c_str());
    ++failures;
  };
  for (int i = 0; i < kRepeatsOfUnchanged; ++i) expect("x1.00_again", GateState::ok);
  for (const char* name : {"x1.10", "x1.25", "x2.00"}) expect(name, GateState::slow);
  return failures == 0 ? 0 : 1;
}

}  // namespace

int main() {
  try {
    return run();
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    if (error.code() == ExitCode::skipped && std::getenv("GPUPHYS_REQUIRE_GPU") == nullptr) return 77;
    return 1;
  }
}
