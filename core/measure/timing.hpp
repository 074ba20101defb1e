// How fast a module is: the floor, and the gate that compares a run with the history. The calls themselves
// are made by protocol.hpp.
//
// Floor. compulsory bytes (each input read once, each output written once) over the copy bandwidth measured
// in the first process of the timing, before it loads the module. The figure to quote is the multiple: median
// time over floor.
//
// What is physically impossible is a little below the floor: outputs may still lie in the L2 cache when a
// call ends, and reading alone is faster than copying. fastest_possible_ms() takes both off; a call that
// beats it did not do the work, and is BELOW_FLOOR.
//
// Gate. SLOW when the run's multiple exceeds baseline * (1 + max(5 %, 3 spread)) and baseline + 5 us / floor.
// The baseline is the best multiple that was ever accepted on this GPU (ci/history/), so that many small
// steps are seen. The spread is the interquartile range of the timed calls over their median, the larger of
// the baseline's and the run's: with five calls, the distance from the second fastest to the second slowest.
// The full range would let a single hiccup open the gate for any slowdown; the median that is compared does
// not feel that hiccup either. SLOW counts only when a second run says so too (confirmed_state()). A run
// whose spread exceeds 5 % is NOISY, which is not a pass.
//
// What the gate can see is measured by tests/test_timing_gate.cpp; smallest_detectable_slowdown() states it.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/records/record.hpp"
#include "core/records/results.hpp"
#include "core/run/gpu_facts.hpp"

namespace gpuphys {

// ---- statistics ----

/// Throw Error(bad_input) for fewer than three times, or one that is not a positive finite number.
double median_of(const std::vector<double>& times_ms);
double full_range(const std::vector<double>& times_ms);    ///< (max - min) / min
double noise_spread(const std::vector<double>& times_ms);  ///< interquartile range / median

/// Compulsory bytes over the copy bandwidth.
double floor_ms(double compulsory_bytes, const Ceilings&);
/// Below this nobody can have moved the bytes: those beyond the L2 cache, at the faster of the copy and read
/// bandwidths, less 2 % for the noise of measuring both. 0 when everything fits the cache.
double fastest_possible_ms(double compulsory_bytes, const Ceilings&);

// ---- the gate ----

inline constexpr double kSlowFraction = 0.05;
inline constexpr double kSlowSpreads = 3;
inline constexpr double kSlowMilliseconds = 0.005;

inline constexpr double kNoisySpread = 0.05;

enum class GateState { ok, slow, noisy, unbaselined, below_floor };
std::string to_string(GateState);                     ///< "OK", "SLOW", "NOISY", "UNBASELINED", "BELOW_FLOOR"
GateState gate_state_from(const std::string& state);  ///< throws Error(bad_input)

struct GateBaseline {
  double multiple = 0;  ///< median time over floor
  double spread = 0;    ///< noise_spread() of its timed calls
};

struct GateQuestion {
  std::vector<double> times_ms;
  double floor_ms = 0;
  double fastest_possible_ms = 0;
  std::optional<GateBaseline> baseline;  ///< of the same GPU; nothing when there is no record of it
};

struct GateAnswer {
  GateState state = GateState::unbaselined;
  double multiple = 0;
  double baseline_multiple = 0;  ///< NaN when there is none
  double limit = 0;              ///< largest multiple that is accepted; NaN without a baseline
  double spread = 0;             ///< the spread that set the limit
};

/// The verdict of one process. Throws Error(bad_input) for times that are not positive finite numbers, fewer
/// than three of them, a floor or baseline that is not positive and finite: nothing of that is a pass.
GateAnswer judge_gate(const GateQuestion&);

/// SLOW only if both runs say SLOW; BELOW_FLOOR if either does; NOISY if both do.
GateState confirmed_state(GateState first, GateState second);

/// The smallest factor of slowdown that is called SLOW with at least 99 % probability, both processes taken
/// together, when single calls scatter with relative standard deviation `sigma` (independent, log-normal;
/// for small sigma also the mean of noise_spread()) and 5 us are below 5 % of the time:
/// 1 + max(0.05 + 2.1 sigma, 9.6 sigma + 12 sigma^2). Holds for sigma up to 0.1.
double smallest_detectable_slowdown(double sigma);

// ---- results ----

/// Fills everything but the gate. Throws as median_of() does.
TimingResult timing_result(const std::string& task, const std::string& label, const std::string& set,
                           const std::vector<double>& times_ms, double compulsory_bytes,
                           double target_multiple, const Ceilings&, const GpuIdentity&);

/// Judges `result` against the best accepted entry of the same GPU's history for the same task, label and set
/// (null when there is none) and fills its gate. The ceilings must be those of the result.
GateAnswer apply_gate(TimingResult& result, const Ceilings&, const HistoryEntry* best);

/// As the "ceilings" object of a timing result.
std::map<std::string, double> ceilings_map(const Ceilings&);

}  // namespace gpuphys
