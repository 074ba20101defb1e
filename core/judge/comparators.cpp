#include "core/judge/comparators.hpp"

#include <fmt/format.h>

#include <cmath>
#include <limits>
#include <vector>

#include "core/base/parallel.hpp"

namespace gpuphys {
namespace {

void require_same_shape(const HostArray& got, const HostArray& truth) {
  if (got.shape() != truth.shape()) {
    throw Error(ExitCode::internal,
                fmt::format("comparing '{}' of shape {} with truth of shape {}", got.name(),
                            to_string(got.shape()), to_string(truth.shape())));
  }
  if (got.size() == 0) throw Error(ExitCode::bad_input, fmt::format("array '{}' is empty", got.name()));
}

// Truth as a correct FP32 implementation could at best deliver it: rounded to float32 once.
double rounded(const HostArray& truth, std::int64_t i) {
  return static_cast<double>(static_cast<float>(truth.value(i)));
}

// Sum of squares over blocks, so that 10^8 terms lose no digits that matter.
template <class F>
double sum_of_squares(std::int64_t n, F&& value) {
  std::vector<double> sums(static_cast<std::size_t>(pieces_of(n)), 0.0);
  parallel_pieces(n, [&](std::int64_t piece, std::int64_t from, std::int64_t to) {
    double& sum = sums[static_cast<std::size_t>(piece)];
    for (std::int64_t begin = from; begin < to; begin += 4096) {
      double block = 0;
      const std::int64_t end = std::min<std::int64_t>(to, begin + 4096);
      for (std::int64_t i = begin; i < end; ++i) {
        const double v = value(i);
        block += v * v;
      }
      sum += block;
    }
  });
  double total = 0;
  for (const double sum : sums) total += sum;
  return total;
}

}  // namespace

bool passes(double error, double tolerance) {
  return std::isfinite(error) && error <= tolerance;
}

std::string index_text(const HostArray& a, std::int64_t flat) {
  std::string text;
  for (std::size_t d = a.shape().size(); d-- > 0;) {
    text = fmt::format("{}{}{}", flat % a.shape()[d], text.empty() ? "" : ",", text);
    flat /= a.shape()[d];
  }
  return fmt::format("{}[{}]", a.name(), text);
}

Measured relative_l2(const HostArray& got, const HostArray& truth) {
  require_same_shape(got, truth);
  const double difference =
      sum_of_squares(got.size(), [&](std::int64_t i) { return got.value(i) - rounded(truth, i); });
  const double reference = sum_of_squares(got.size(), [&](std::int64_t i) { return rounded(truth, i); });
  Measured m;
  m.error = reference == 0 ? std::sqrt(difference) : std::sqrt(difference / reference);
  if (!std::isfinite(difference) || !std::isfinite(reference)) {
    m.error = std::numeric_limits<double>::quiet_NaN();
    m.detail = "non-finite values";
  }
  return m;
}

double truth_gap(const HostArray& got, const HostArray& truth) {
  require_same_shape(got, truth);
  const double difference =
      sum_of_squares(got.size(), [&](std::int64_t i) { return got.value(i) - truth.value(i); });
  const double reference = sum_of_squares(got.size(), [&](std::int64_t i) { return truth.value(i); });
  return reference == 0 ? std::sqrt(difference) : std::sqrt(difference / reference);
}

Measured max_error_over_rms(const HostArray& got, const HostArray& truth) {
  require_same_shape(got, truth);
  const double square = sum_of_squares(got.size(), [&](std::int64_t i) { return rounded(truth, i); });
  double rms = std::sqrt(square / static_cast<double>(got.size()));
  if (rms == 0) rms = 1;
  struct Worst {
    double error = -1;
    std::int64_t at = 0;
  };
  std::vector<Worst> found(static_cast<std::size_t>(pieces_of(got.size())));
  parallel_pieces(got.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
    Worst& here = found[static_cast<std::size_t>(piece)];
    for (std::int64_t i = begin; i < end; ++i) {
      const double e = std::abs(got.value(i) - rounded(truth, i));
      if (!(e <= here.error)) {  // true for NaN as well
        here = {e, i};
        if (!std::isfinite(e)) break;
      }
    }
  });
  double worst = -1;
  std::int64_t at = 0;
  for (const Worst& here : found) {
    if (here.error <= worst) continue;
    worst = here.error;
    at = here.at;
    if (!std::isfinite(worst)) break;
  }
  return {worst / rms, fmt::format("worst at {}: got {:.9g}, expected {:.9g}", index_text(got, at),
                                   got.value(at), rounded(truth, at))};
}

Measured count_above(const HostArray& got, const HostArray& truth, double bound) {
  require_same_shape(got, truth);
  const double square = sum_of_squares(got.size(), [&](std::int64_t i) { return rounded(truth, i); });
  double rms = std::sqrt(square / static_cast<double>(got.size()));
  if (rms == 0) rms = 1;
  std::int64_t count = 0, first = -1;
  for (std::int64_t i = 0; i < got.size(); ++i) {
    if (!(std::abs(got.value(i) - rounded(truth, i)) <= bound * rms)) {
      if (first < 0) first = i;
      ++count;
    }
  }
  Measured m{static_cast<double>(count), ""};
  if (first >= 0)
    m.detail = fmt::format("{} of {} elements, first at {}", count, got.size(), index_text(got, first));
  return m;
}

Check relative_l2_check(const std::string& array, double tolerance, const std::string& why) {
  return {array + "_rel_l2",
          CheckKind::paper,
          array,
          "relative L2",
          tolerance,
          why,
          true,
          [array](const Judged& j) {
            return relative_l2(find(j.outputs, array, "outputs"), find(*j.truth, array, "truth"));
          }};
}

Check local_error_check(const std::string& array, double tolerance, const std::string& why) {
  return {array + "_local",
          CheckKind::local,
          array,
          "largest error / rms",
          tolerance,
          why,
          true,
          [array](const Judged& j) {
            return max_error_over_rms(find(j.outputs, array, "outputs"), find(*j.truth, array, "truth"));
          }};
}

}  // namespace gpuphys
