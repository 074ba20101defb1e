#include "core/measure/timing.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace gpuphys {
namespace {

// How much the two measured bandwidths may lie below what the memory can do.
constexpr double kCeilingNoise = 0.02;

// smallest_detectable_slowdown(): fitted to the simulation in tests/test_timing_gate.cpp, which asserts it
// from both sides.
constexpr double kSeenOverFraction = 2.1;
constexpr double kSeenLinear = 9.6;
constexpr double kSeenQuadratic = 12;

bool positive(double x) {
  return std::isfinite(x) && x > 0;
}

void require_positive(double x, const char* what) {
  if (!positive(x))
    throw Error(ExitCode::bad_input, fmt::format("timing: {} is {}, not a positive number", what, x));
}

std::vector<double> sorted_times(std::vector<double> times) {
  if (times.size() < 3)
    throw Error(ExitCode::bad_input, fmt::format("timing: {} timed calls are too few", times.size()));
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (!positive(times[i])) {
      throw Error(ExitCode::bad_input, fmt::format("timing: call {} of {} took {} ms, not a positive number",
                                                   i + 1, times.size(), times[i]));
    }
  }
  std::sort(times.begin(), times.end());
  return times;
}

// Of sorted values, interpolating linearly between neighbours.
double quantile(const std::vector<double>& sorted, double q) {
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (at - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

}  // namespace

double median_of(const std::vector<double>& times_ms) {
  return quantile(sorted_times(times_ms), 0.5);
}

double full_range(const std::vector<double>& times_ms) {
  const std::vector<double> t = sorted_times(times_ms);
  return (t.back() - t.front()) / t.front();
}

double noise_spread(const std::vector<double>& times_ms) {
  const std::vector<double> t = sorted_times(times_ms);
  return (quantile(t, 0.75) - quantile(t, 0.25)) / quantile(t, 0.5);
}

double floor_ms(double compulsory_bytes, const Ceilings& c) {
  require_positive(c.copy_GBps, "the copy bandwidth");
  return compulsory_bytes / (c.copy_GBps * 1e6);
}

double fastest_possible_ms(double compulsory_bytes, const Ceilings& c) {
  require_positive(c.copy_GBps, "the copy bandwidth");
  const double from_memory = std::max(0.0, compulsory_bytes - c.l2_MiB * 1048576.0);
  return (1 - kCeilingNoise) * from_memory / (std::max(c.copy_GBps, c.read_GBps) * 1e6);
}

std::string to_string(GateState state) {
  switch (state) {
    case GateState::ok:
      return "OK";
    case GateState::slow:
      return "SLOW";
    case GateState::noisy:
      return "NOISY";
    case GateState::unbaselined:
      return "UNBASELINED";
    case GateState::below_floor:
      return "BELOW_FLOOR";
  }
  return "unknown";
}

GateState gate_state_from(const std::string& text) {
  for (const GateState s :
       {GateState::ok, GateState::slow, GateState::noisy, GateState::unbaselined, GateState::below_floor}) {
    if (text == to_string(s)) return s;
  }
  throw Error(ExitCode::bad_input, fmt::format("timing: unknown state '{}'", text));
}

GateAnswer judge_gate(const GateQuestion& q) {
  require_positive(q.floor_ms, "the floor");
  if (!std::isfinite(q.fastest_possible_ms))
    throw Error(ExitCode::bad_input, "timing: the fastest possible time is not a number");
  GateAnswer a;
  a.multiple = median_of(q.times_ms) / q.floor_ms;
  a.spread = noise_spread(q.times_ms);
  a.baseline_multiple = a.limit = std::numeric_limits<double>::quiet_NaN();
  if (q.baseline) {
    require_positive(q.baseline->multiple, "the recorded multiple");
    if (!std::isfinite(q.baseline->spread) || q.baseline->spread < 0)
      throw Error(ExitCode::bad_input, "timing: the recorded spread is not a number");
    a.baseline_multiple = q.baseline->multiple;
    a.spread = std::max(a.spread, q.baseline->spread);
    a.limit = std::max(q.baseline->multiple * (1 + std::max(kSlowFraction, kSlowSpreads * a.spread)),
                       q.baseline->multiple + kSlowMilliseconds / q.floor_ms);
    a.state = a.multiple > a.limit ? GateState::slow : GateState::ok;
  }
  // Where calls scatter like this, a pass would say nothing. Slower than the noise allows is SLOW all the
  // same.
  if (a.state != GateState::slow && noise_spread(q.times_ms) > kNoisySpread) a.state = GateState::noisy;
  // One impossible call is enough: it did not do the work.
  const double fastest = *std::min_element(q.times_ms.begin(), q.times_ms.end());
  if (fastest < q.fastest_possible_ms) a.state = GateState::below_floor;
  return a;
}

GateState confirmed_state(GateState first, GateState second) {
  if (first == GateState::below_floor || second == GateState::below_floor) return GateState::below_floor;
  if (first == GateState::slow && second == GateState::slow) return GateState::slow;
  // The quieter of two runs decides.
  if (first == GateState::slow || first == GateState::noisy) return second;
  return first;
}

double smallest_detectable_slowdown(double sigma) {
  return 1 +
         std::max(kSlowFraction + kSeenOverFraction * sigma, (kSeenLinear + kSeenQuadratic * sigma) * sigma);
}

std::map<std::string, double> ceilings_map(const Ceilings& c) {
  return {{"copy_GBps", c.copy_GBps},
          {"read_GBps", c.read_GBps},
          {"fp32_TFLOPs", c.fp32_TFLOPs},
          {"launch_us", c.launch_us},
          {"l2_MiB", c.l2_MiB}};
}

TimingResult timing_result(const std::string& task, const std::string& label, const std::string& set,
                           const std::vector<double>& times_ms, double bytes, double target_multiple,
                           const Ceilings& ceilings, const GpuIdentity& gpu) {
  TimingResult r;
  r.task = task;
  r.label = label;
  r.set = set;
  r.times_ms = times_ms;
  r.median_ms = median_of(times_ms);
  r.min_ms = *std::min_element(times_ms.begin(), times_ms.end());
  r.spread = full_range(times_ms);
  r.compulsory_bytes = bytes;
  r.floor_ms = floor_ms(bytes, ceilings);
  r.multiple = r.median_ms / r.floor_ms;
  r.target_multiple = target_multiple;
  r.ceilings = ceilings_map(ceilings);
  r.device = gpu.device;
  r.driver = gpu.driver;
  r.toolkit = gpu.toolkit;
  return r;
}

GateAnswer apply_gate(TimingResult& result, const Ceilings& ceilings, const HistoryEntry* best) {
  GateQuestion q;
  q.times_ms = result.times_ms;
  q.floor_ms = result.floor_ms;
  q.fastest_possible_ms = fastest_possible_ms(result.compulsory_bytes, ceilings);
  if (best != nullptr) q.baseline = GateBaseline{best->multiple, best->spread};
  const GateAnswer answer = judge_gate(q);
  result.gate.state = to_string(answer.state);
  result.gate.baseline_multiple = answer.baseline_multiple;
  result.gate.limit = answer.limit;
  return answer;
}

}  // namespace gpuphys
