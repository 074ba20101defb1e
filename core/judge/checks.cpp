#include "core/judge/checks.hpp"

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "core/base/parallel.hpp"

namespace gpuphys {
namespace {

Check check_of(CheckText text, std::string norm, std::function<Measured(const Judged&)> measure) {
  return {.name = std::move(text.name),
          .kind = text.kind,
          .quantity = text.quantity.empty() ? std::move(text.array) : std::move(text.quantity),
          .norm = std::move(norm),
          .tolerance = text.tolerance,
          .why = std::move(text.why),
          .needs_truth = text.needs_truth,
          .measure = std::move(measure)};
}

// The item with the largest |value|, the first non-finite one before all others; at = -1 without items.
struct Worst {
  double error = 0;
  std::int64_t at = -1;
};

template <class Value>
Worst worst_item(std::int64_t count, Value&& value) {
  std::vector<Worst> found(static_cast<std::size_t>(pieces_of(count)));
  parallel_pieces(count, [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
    Worst& here = found[static_cast<std::size_t>(piece)];
    for (std::int64_t i = begin; i < end; ++i) {
      const double e = std::abs(value(i));
      if (here.at >= 0 && e <= here.error) continue;  // not taken for NaN
      here = {e, i};
      if (!std::isfinite(e)) break;
    }
  });
  Worst worst;
  for (const Worst& here : found) {
    if (here.at < 0 || (worst.at >= 0 && here.error <= worst.error)) continue;
    worst = here;
    if (!std::isfinite(worst.error)) break;
  }
  return worst;
}

std::string name_or(const std::string& name, const std::string& array, const char* suffix) {
  return name.empty() ? array + suffix : name;
}

// The change of an output, and what it should be: FP64 differences of the float32 values, the truth rounded
// once.
struct Change {
  const HostArray &got, &expected, &start;
  Change(const Judged& j, const std::string& array, const std::string& from)
      : got(output(j, array)), expected(truth(j, array)), start(input(j, from)) {
    for (const HostArray* a : {&expected, &start}) {
      if (a->shape() != got.shape()) {
        throw Error(ExitCode::internal,
                    fmt::format("change of '{}' {} from '{}' {}: shapes differ", got.name(),
                                to_string(got.shape()), a->name(), to_string(a->shape())));
      }
    }
  }
  double error(std::int64_t i) const {
    return got.value(i) - static_cast<double>(static_cast<float>(expected.value(i)));
  }
  double change(std::int64_t i) const {
    return static_cast<double>(static_cast<float>(expected.value(i))) - start.value(i);
  }
  double rms_change() const { return std::sqrt(square(false) / static_cast<double>(got.size())); }
  double square(bool of_error) const {
    std::vector<double> sums(static_cast<std::size_t>(pieces_of(got.size())), 0.0);
    parallel_pieces(got.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      for (std::int64_t b = begin; b < end; b += 4096) {
        double block = 0;
        for (std::int64_t i = b; i < std::min(end, b + 4096); ++i) {
          const double v = of_error ? error(i) : change(i);
          block += v * v;
        }
        sums[static_cast<std::size_t>(piece)] += block;
      }
    });
    double total = 0;
    for (const double sum : sums) total += sum;
    return total;
  }
};

}  // namespace

const HostArray& output(const Judged& j, const std::string& name) {
  return find(j.outputs, name, "outputs");
}
const HostArray& truth(const Judged& j, const std::string& name) {
  if (j.truth == nullptr) throw Error(ExitCode::internal, "a check looks at the truth without asking for it");
  return find(*j.truth, name, "truth");
}
const HostArray& input(const Judged& j, const std::string& name) {
  return find(j.problem.inputs, name, "inputs");
}

Check worst_over(CheckText text, ItemsOf items_of) {
  return check_of(std::move(text), "largest", [items_of = std::move(items_of)](const Judged& j) {
    const Items items = items_of(j);
    const Worst worst = worst_item(items.count, items.value);
    if (worst.at < 0) return Measured{0, "nothing to look at"};
    return Measured{worst.error, items.describe ? items.describe(worst.at)
                                                : fmt::format("item {}: {:.9g}", worst.at, worst.error)};
  });
}

Check count_where(CheckText text, ItemsOf items_of) {
  return check_of(std::move(text), "count", [items_of = std::move(items_of)](const Judged& j) {
    const Items items = items_of(j);
    struct Found {
      std::int64_t n = 0, first = -1;
    };
    std::vector<Found> found(static_cast<std::size_t>(pieces_of(items.count)));
    parallel_pieces(items.count, [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      Found& here = found[static_cast<std::size_t>(piece)];
      for (std::int64_t i = begin; i < end; ++i) {
        if (items.value(i) == 0) continue;
        if (here.first < 0) here.first = i;
        ++here.n;
      }
    });
    std::int64_t n = 0, first = -1;
    for (const Found& here : found) {
      n += here.n;
      if (first < 0) first = here.first;
    }
    Measured m{static_cast<double>(n), ""};
    if (first >= 0) {
      m.detail = fmt::format("{} of {}, first {}", n, items.count,
                             items.describe ? items.describe(first) : fmt::format("item {}", first));
    }
    return m;
  });
}

Check conserved_sum(CheckText text, TermsOf terms_of) {
  return check_of(
      std::move(text), "|sum - expected| / scale", [terms_of = std::move(terms_of)](const Judged& j) {
        const Terms terms = terms_of(j);
        std::array<double, 3> sum{};
        double lengths = 0;
        for (std::int64_t i = 0; i < terms.count; ++i) {
          const std::array<double, 3> t = terms.term(i);
          for (std::size_t c = 0; c < 3; ++c) sum[c] += t[c];
          lengths += std::hypot(t[0], t[1], t[2]);
        }
        const double rest =
            std::hypot(sum[0] - terms.expected[0], sum[1] - terms.expected[1], sum[2] - terms.expected[2]);
        const double scale = terms.scale != 0 ? terms.scale : lengths;
        // A sum of which a term is not finite is not finite either, but hypot() takes infinity before NaN:
        // both fail.
        return Measured{
            scale == 0 ? rest : rest / scale,
            fmt::format("sum ({:.9g}, {:.9g}, {:.9g}), expected ({:.9g}, {:.9g}, {:.9g}), scale {:.6g}",
                        sum[0], sum[1], sum[2], terms.expected[0], terms.expected[1], terms.expected[2],
                        scale)};
      });
}

Check exactly_zero(const std::string& array, const std::string& why, const std::string& name) {
  return worst_over({.name = name_or(name, array, "_exactly_zero"),
                     .kind = CheckKind::invariant,
                     .array = array,
                     .quantity = "largest |" + array + "|",
                     .tolerance = 0,
                     .why = why,
                     .needs_truth = false},
                    [array](const Judged& j) {
                      const HostArray& a = output(j, array);
                      return Items{a.size(), [&a](std::int64_t i) { return a.value(i); },
                                   [&a](std::int64_t i) {
                                     return fmt::format("{} = {:.9g}", index_text(a, i), a.value(i));
                                   }};
                    });
}

Check equals_known(CheckText text, std::function<std::vector<double>(const Judged&)> known, double scale) {
  const std::string array = text.array;
  text.needs_truth = false;
  return check_of(std::move(text),
                  scale == 0 ? "largest error / largest known value" : "largest error / scale",
                  [array, known = std::move(known), scale](const Judged& j) {
                    const HostArray& a = output(j, array);
                    const std::vector<double> values = known(j);
                    if (static_cast<std::int64_t>(values.size()) != a.size()) {
                      throw Error(ExitCode::internal, fmt::format("known values of '{}': {} for {} elements",
                                                                  array, values.size(), a.size()));
                    }
                    double unit = scale;
                    if (unit == 0) {
                      for (const double v : values) unit = std::max(unit, std::abs(v));
                      if (unit == 0) unit = 1;
                    }
                    const Worst worst = worst_item(a.size(), [&](std::int64_t i) {
                      return (a.value(i) - values[static_cast<std::size_t>(i)]) / unit;
                    });
                    if (worst.at < 0) return Measured{0, "nothing to look at"};
                    return Measured{worst.error, fmt::format("worst at {}: got {:.9g}, expected {:.9g}",
                                                             index_text(a, worst.at), a.value(worst.at),
                                                             values[static_cast<std::size_t>(worst.at)])};
                  });
}

Check within(const std::string& array, double low, double high, const std::string& why,
             const std::string& name) {
  return worst_over({.name = name_or(name, array, "_within"),
                     .kind = CheckKind::invariant,
                     .array = array,
                     .quantity = fmt::format("distance of {} to [{:.9g}, {:.9g}]", array, low, high),
                     .tolerance = 0,
                     .why = why,
                     .needs_truth = false},
                    [array, low, high](const Judged& j) {
                      const HostArray& a = output(j, array);
                      return Items{a.size(),
                                   [&a, low, high](std::int64_t i) {
                                     const double v = a.value(i);
                                     if (std::isnan(v)) return v;
                                     return v < low ? low - v : v > high ? v - high : 0.0;
                                   },
                                   [&a](std::int64_t i) {
                                     return fmt::format("{} = {:.9g}", index_text(a, i), a.value(i));
                                   }};
                    });
}

Check relative_l2_of_change(const std::string& array, const std::string& start, double tolerance,
                            const std::string& why) {
  return check_of({.name = array + "_change_rel_l2",
                   .kind = CheckKind::paper,
                   .array = array,
                   .quantity = fmt::format("change of {} from {}", array, start),
                   .tolerance = tolerance,
                   .why = why},
                  "relative L2 of the change", [array, start](const Judged& j) {
                    const Change c(j, array, start);
                    const double error = c.square(true), change = c.square(false);
                    Measured m{change == 0 ? std::sqrt(error) : std::sqrt(error / change), ""};
                    if (!std::isfinite(error) || !std::isfinite(change)) {
                      m = {std::numeric_limits<double>::quiet_NaN(), "non-finite values"};
                    }
                    return m;
                  });
}

Check local_error_of_change(const std::string& array, const std::string& start, double tolerance,
                            const std::string& why) {
  return check_of(
      {.name = array + "_change_local",
       .kind = CheckKind::local,
       .array = array,
       .quantity = fmt::format("change of {} from {}", array, start),
       .tolerance = tolerance,
       .why = why},
      "largest error / rms of the change", [array, start](const Judged& j) {
        const Change c(j, array, start);
        double rms = c.got.size() > 0 ? c.rms_change() : 0;
        if (rms == 0) rms = 1;
        const Worst worst = worst_item(c.got.size(), [&](std::int64_t i) { return c.error(i) / rms; });
        if (worst.at < 0) return Measured{0, "nothing to look at"};
        return Measured{worst.error, fmt::format("worst at {}: got {:.9g}, expected {:.9g}, from {:.9g}",
                                                 index_text(c.got, worst.at), c.got.value(worst.at),
                                                 c.expected.value(worst.at), c.start.value(worst.at))};
      });
}

Check as_invariant(Check check, const std::string& name, double tolerance, const std::string& why) {
  check.name = name;
  check.kind = CheckKind::invariant;
  check.tolerance = tolerance;
  check.why = why;
  return check;
}

}  // namespace gpuphys
