// The timing gate without a GPU: what it lets pass, what it stops, how often it is wrong, and the smallest
// slowdown that it can be relied on to see. Noise is drawn from counter-based random numbers, so that every
// rate below is the same on every machine.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>

#include "core/generators/random.hpp"
#include "core/measure/timing.hpp"

namespace gpuphys {
namespace {

constexpr int kDraws = 10000;
constexpr double kPi = 3.14159265358979323846;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

double normal(std::uint64_t seed, std::uint64_t i) {
  const double u = 1 - uniform01(seed, 0, i);
  return std::sqrt(-2 * std::log(u)) * std::cos(2 * kPi * uniform01(seed, 1, i));
}

// How the times of a process scatter.
struct Noise {
  double call = 0;             ///< relative standard deviation of single calls, log-normal
  double process = 0;          ///< of a factor that all calls of one process share
  double hiccup = 0;           ///< probability that a call is disturbed,
  double hiccup_factor = 1.5;  ///< which then takes so many times as long
};

std::vector<double> draw(double mean_ms, const Noise& noise, std::uint64_t process, int trial) {
  const auto first = static_cast<std::uint64_t>(trial) * 5;
  const double shared = std::exp(noise.process * normal(process + 100, static_cast<std::uint64_t>(trial)));
  std::vector<double> times;
  for (std::uint64_t i = first; i < first + 5; ++i) {
    double ms = mean_ms * shared * std::exp(noise.call * normal(process, i));
    if (uniform01(process, 2, i) < noise.hiccup) ms *= noise.hiccup_factor;
    times.push_back(ms);
  }
  return times;
}

GateBaseline baseline_of(const std::vector<double>& times, double floor) {
  return {median_of(times) / floor, noise_spread(times)};
}

// The share of draws in which both of two processes call a module SLOW whose true time is `factor` times the
// recorded one's.
double slow_rate(double factor, const Noise& noise, double mean_ms = 10) {
  int slow = 0;
  for (int trial = 0; trial < kDraws; ++trial) {
    const GateBaseline record = baseline_of(draw(mean_ms, noise, 1, trial), 1);
    const auto verdict = [&](std::uint64_t process) {
      return judge_gate({draw(factor * mean_ms, noise, process, trial), 1, 0, record}).state;
    };
    slow += confirmed_state(verdict(2), verdict(3)) == GateState::slow;
  }
  return static_cast<double>(slow) / kDraws;
}

GateState verdict_of(std::vector<double> times, std::optional<GateBaseline> baseline, double floor = 1,
                     double fastest_possible = 0) {
  return judge_gate({std::move(times), floor, fastest_possible, baseline}).state;
}

TEST(Statistics, OfKnownTimes) {
  const std::vector<double> times{3, 1, 5, 2, 4};
  EXPECT_DOUBLE_EQ(median_of(times), 3);
  EXPECT_DOUBLE_EQ(full_range(times), 4);            // (5 - 1) / 1
  EXPECT_DOUBLE_EQ(noise_spread(times), 2.0 / 3.0);  // (4 - 2) / 3
  EXPECT_DOUBLE_EQ(median_of({1, 2, 4, 8}), 3);
  EXPECT_DOUBLE_EQ(noise_spread({1, 1, 1, 1, 50}), 0) << "one hiccup is not noise of the middle half";
}

TEST(Statistics, RefuseWhatIsNoTime) {
  for (const double bad : {kNan, kInf, -kInf, 0.0, -1.0}) {
    EXPECT_THROW(median_of({1, bad, 1, 1, 1}), Error) << bad;
    EXPECT_THROW(full_range({1, bad, 1, 1, 1}), Error) << bad;
    EXPECT_THROW(noise_spread({1, bad, 1, 1, 1}), Error) << bad;
  }
  EXPECT_THROW(median_of({}), Error);
  EXPECT_THROW(median_of({1, 1}), Error);
}

TEST(Floor, IsBytesOverCopyBandwidth) {
  const Ceilings c{.copy_GBps = 4000, .read_GBps = 4400, .fp32_TFLOPs = 60, .launch_us = 2, .l2_MiB = 50};
  EXPECT_DOUBLE_EQ(floor_ms(400e6, c), 0.1);
  // 400 MB less 52.4288 MB of cache, at the read bandwidth, less 2 %.
  EXPECT_NEAR(fastest_possible_ms(400e6, c), 0.98 * 347.5712e6 / 4.4e9, 1e-12);
  EXPECT_LT(fastest_possible_ms(400e6, c), floor_ms(400e6, c));
  EXPECT_EQ(fastest_possible_ms(40e6, c), 0) << "what fits the cache has no such bound";
  EXPECT_THROW(floor_ms(1e6, {}), Error) << "no bandwidth, no floor";
}

TEST(Gate, SameTimesAreOk) {
  EXPECT_EQ(verdict_of({2, 2, 2, 2, 2}, GateBaseline{2, 0}), GateState::ok);
}

TEST(Gate, FasterThanTheRecordIsOk) {
  EXPECT_EQ(verdict_of({1, 1, 1, 1, 1}, GateBaseline{2, 0}), GateState::ok);
}

TEST(Gate, LimitIsFivePercentWithoutNoise) {
  EXPECT_EQ(verdict_of({2.09, 2.09, 2.09, 2.09, 2.09}, GateBaseline{2, 0}), GateState::ok);
  EXPECT_EQ(verdict_of({2.11, 2.11, 2.11, 2.11, 2.11}, GateBaseline{2, 0}), GateState::slow);
}

TEST(Gate, LimitIsThreeSpreadsOfRecordOrRunWhicheverIsLarger) {
  // A spread of 4 % moves the limit to 12 %, from either side.
  EXPECT_EQ(verdict_of({2.22, 2.22, 2.22, 2.22, 2.22}, GateBaseline{2, 0.04}), GateState::ok);
  EXPECT_EQ(verdict_of({2.26, 2.26, 2.26, 2.26, 2.26}, GateBaseline{2, 0.04}), GateState::slow);
  const std::vector<double> noisy{2.16, 2.16, 2.2, 2.248, 2.248};  // spread 4 %, median 2.2
  EXPECT_NEAR(noise_spread(noisy), 0.04, 1e-12);
  EXPECT_EQ(verdict_of(noisy, GateBaseline{2, 0}), GateState::ok);
  EXPECT_EQ(verdict_of({2.2, 2.2, 2.2, 2.2, 2.2}, GateBaseline{2, 0}), GateState::slow);
}

TEST(Gate, OneHiccupNeitherOpensNorClosesIt) {
  EXPECT_EQ(verdict_of({2, 2, 2, 2, 40}, GateBaseline{2, 0}), GateState::ok);
  EXPECT_EQ(verdict_of({2.5, 2.5, 2.5, 2.5, 40}, GateBaseline{2, 0}), GateState::slow);
}

// Times in ms; the floor makes the recorded time 20 us.
TEST(Gate, ForgivesFiveMicroseconds) {
  const double floor = 0.004;
  const GateBaseline record{5, 0};
  EXPECT_EQ(verdict_of({0.0249, 0.0249, 0.0249, 0.0249, 0.0249}, record, floor), GateState::ok)
      << "24 % slower, but by 4.9 us";
  EXPECT_EQ(verdict_of({0.0251, 0.0251, 0.0251, 0.0251, 0.0251}, record, floor), GateState::slow)
      << "by 5.1 us";
}

TEST(Gate, FiveMicrosecondsDoNotCountAgainstLongTimes) {
  // 1 ms recorded: 5 us are 0.5 %, the limit stays at 5 %.
  EXPECT_EQ(verdict_of({1.04, 1.04, 1.04, 1.04, 1.04}, GateBaseline{1, 0}), GateState::ok);
  EXPECT_EQ(verdict_of({1.06, 1.06, 1.06, 1.06, 1.06}, GateBaseline{1, 0}), GateState::slow);
}

TEST(Gate, UnknownGpuIsUnbaselinedNotOk) {
  const GateAnswer a = judge_gate({{2, 2, 2, 2, 2}, 1, 0, std::nullopt});
  EXPECT_EQ(a.state, GateState::unbaselined);
  EXPECT_TRUE(std::isnan(a.limit));
  EXPECT_TRUE(std::isnan(a.baseline_multiple));
  EXPECT_DOUBLE_EQ(a.multiple, 2);
}

TEST(Gate, FasterThanPossibleIsBelowFloorWithAndWithoutARecord) {
  EXPECT_EQ(verdict_of({0.5, 0.5, 0.5, 0.5, 0.5}, GateBaseline{2, 0}, 1, 0.9), GateState::below_floor);
  EXPECT_EQ(verdict_of({0.5, 0.5, 0.5, 0.5, 0.5}, std::nullopt, 1, 0.9), GateState::below_floor);
}

TEST(Gate, OneImpossibleCallIsEnough) {
  EXPECT_EQ(verdict_of({2, 2, 0.5, 2, 2}, GateBaseline{2, 0}, 1, 0.9), GateState::below_floor);
  EXPECT_EQ(verdict_of({4, 4, 0.5, 4, 4}, GateBaseline{2, 0}, 1, 0.9), GateState::below_floor)
      << "slow in the median as well";
}

TEST(Gate, BetweenTheBoundAndTheFloorIsLegal) {
  EXPECT_EQ(verdict_of({0.95, 0.95, 0.95, 0.95, 0.95}, GateBaseline{1, 0}, 1, 0.9), GateState::ok);
}

TEST(Gate, NothingThatIsNotANumberPasses) {
  for (const double bad : {kNan, kInf, 0.0, -1.0}) {
    EXPECT_THROW(verdict_of({2, 2, bad, 2, 2}, GateBaseline{2, 0}), Error) << bad;
    EXPECT_THROW(verdict_of({2, 2, 2, 2, 2}, GateBaseline{bad, 0}), Error) << bad;
    EXPECT_THROW(verdict_of({2, 2, 2, 2, 2}, GateBaseline{2, 0}, bad), Error) << bad;
  }
  EXPECT_THROW(verdict_of({2, 2, 2, 2, 2}, GateBaseline{2, kNan}), Error);
  EXPECT_THROW(verdict_of({2, 2, 2, 2, 2}, GateBaseline{2, -1}), Error);
  EXPECT_THROW(verdict_of({2, 2, 2, 2, 2}, GateBaseline{2, 0}, 1, kNan), Error);
  EXPECT_THROW(verdict_of({}, GateBaseline{2, 0}), Error);
}

TEST(Confirmation, SlowNeedsTwoProcessesAnImpossibleTimeOne) {
  using enum GateState;
  EXPECT_EQ(confirmed_state(slow, slow), slow);
  EXPECT_EQ(confirmed_state(slow, ok), ok);
  EXPECT_EQ(confirmed_state(slow, below_floor), below_floor);
  EXPECT_EQ(confirmed_state(ok, ok), ok);
  EXPECT_EQ(confirmed_state(unbaselined, unbaselined), unbaselined);
}

TEST(GateStates, SurviveTheirText) {
  for (const GateState s :
       {GateState::ok, GateState::slow, GateState::noisy, GateState::unbaselined, GateState::below_floor}) {
    EXPECT_EQ(gate_state_from(to_string(s)), s);
  }
  EXPECT_THROW(gate_state_from("FINE"), Error);
}

TEST(Results, CarryTimesFloorAndGate) {
  const Ceilings c{.copy_GBps = 4000, .read_GBps = 4400, .fp32_TFLOPs = 60, .launch_us = 2, .l2_MiB = 50};
  const GpuIdentity gpu{"NVIDIA H200", "580", "13.0"};
  TimingResult record =
      timing_result("advect_rk2", "reference", "public", {0.2, 0.2, 0.2, 0.2, 0.2}, 400e6, 3.5, c, gpu);
  EXPECT_DOUBLE_EQ(record.floor_ms, 0.1);
  EXPECT_DOUBLE_EQ(record.multiple, 2);
  apply_gate(record, c, nullptr);
  EXPECT_EQ(record.gate.state, "UNBASELINED");
  TimingResult run =
      timing_result("advect_rk2", "reference", "public", {0.3, 0.3, 0.3, 0.3, 0.3}, 400e6, 3.5, c, gpu);
  HistoryEntry best;
  best.multiple = record.multiple;
  apply_gate(run, c, &best);
  EXPECT_EQ(run.gate.state, "SLOW");
  EXPECT_DOUBLE_EQ(run.gate.baseline_multiple, 2);
  EXPECT_DOUBLE_EQ(run.gate.limit, 2.1);
  // The same slowdown of module and machine is none: the floor takes it up.
  const Ceilings half{.copy_GBps = 2000, .read_GBps = 2200, .fp32_TFLOPs = 30, .launch_us = 2, .l2_MiB = 50};
  TimingResult elsewhere =
      timing_result("advect_rk2", "reference", "public", {0.4, 0.4, 0.4, 0.4, 0.4}, 400e6, 3.5, half, gpu);
  apply_gate(elsewhere, half, &best);
  EXPECT_EQ(elsewhere.gate.state, "OK");
  // A copy that claims 20 TB/s did not happen.
  TimingResult impossible =
      timing_result("advect_rk2", "reference", "public", {0.02, 0.2, 0.2, 0.2, 0.2}, 400e6, 3.5, c, gpu);
  apply_gate(impossible, c, &best);
  EXPECT_EQ(impossible.gate.state, "BELOW_FLOOR");
}

// A/A: nothing changed, so SLOW is a false alarm.
TEST(FalseAlarms, AreRareUnderRealisticNoise) {
  struct Case {
    const char* what;
    Noise noise;
    double at_most;
  };
  const Case cases[] = {
      {"quiet GPU: calls 0.3 %, processes 0.5 %", {0.003, 0.005, 0, 1}, 1e-4},
      {"calls 1 %, processes 1 %", {0.01, 0.01, 0, 1}, 1e-3},
      {"quiet GPU, every twentieth call 1.5 times as long", {0.003, 0.005, 0.05, 1.5}, 1e-3},
      {"every fifth call 3 times as long", {0.003, 0.005, 0.2, 3}, 1e-2},
      {"calls 5 %", {0.05, 0, 0, 1}, 1e-3},
      {"calls 10 %, processes 2 %", {0.1, 0.02, 0, 1}, 1e-2},
  };
  for (const Case& c : cases) {
    const double rate = slow_rate(1, c.noise);
    std::printf("    false alarms, %-50s %.4f of %d\n", c.what, rate, kDraws);
    EXPECT_LE(rate, c.at_most) << c.what;
  }
}

TEST(PlantedSlowdowns, AreSeenOnAQuietGpu) {
  // Two disturbed calls of five widen the middle half and open the gate: at 1 % a call that is one run in a
  // thousand.
  const Noise quiet{0.003, 0.005, 0.01, 1.5};
  for (const double factor : {1.1, 1.25, 2.0}) {
    const double rate = slow_rate(factor, quiet);
    std::printf("    slowdown %.2fx on a quiet GPU: seen in %.4f of %d\n", factor, rate, kDraws);
    EXPECT_GE(rate, 0.99) << factor;
  }
}

TEST(PlantedSlowdowns, OfTwoAreSeenEvenUnderHeavyNoise) {
  EXPECT_GE(slow_rate(2, {0.08, 0.02, 0, 1}), 0.99);
}

// smallest_detectable_slowdown() is what the documentation states: at it, at least 99 % are seen, and it is
// not needlessly pessimistic: with a tenth of the slowdown less, fewer are.
TEST(SmallestDetectableSlowdown, IsAsDocumented) {
  std::printf("    scatter of calls   documented   smallest with 99 %%\n");
  for (const double sigma : {0.0, 0.001, 0.002, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.05, 0.08, 0.1}) {
    const double documented = smallest_detectable_slowdown(sigma);
    double low = 1, high = 3;
    for (int i = 0; i < 12; ++i) {
      const double middle = (low + high) / 2;
      (slow_rate(middle, {sigma}) >= 0.99 ? high : low) = middle;
    }
    std::printf("    %13.2f %%   %10.3f   %20.3f\n", 100 * sigma, documented, high);
    // Without noise, exactly at the limit is not yet beyond it.
    EXPECT_GE(slow_rate(documented + 1e-9, {sigma}), 0.99) << sigma;
    EXPECT_LT(slow_rate(1 + 0.9 * (documented - 1), {sigma}), 0.99) << sigma;
  }
}

}  // namespace
}  // namespace gpuphys
