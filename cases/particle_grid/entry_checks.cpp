#include "cases/particle_grid/entry_checks.hpp"

#include <fmt/format.h>

#include <utility>

#include "core/base/parallel.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::entry_checks {
namespace {

// One entry of every item, in the element type of the array.
HostArray entry_of(const HostArray& array, std::int64_t entry, const std::string& label) {
  const std::int64_t n = array.shape()[0];
  const std::int64_t stride = n > 0 ? array.size() / n : 1;
  HostArray one(label, array.dtype(), {n}, array.unit());
  const auto copy = [&]<class T>(T) {
    const auto from = array.as<T>();
    const auto to = one.as<T>();
    parallel_pieces(n, [&](std::int64_t, std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i)
        to[static_cast<std::size_t>(i)] = from[static_cast<std::size_t>(stride * i + entry)];
    });
  };
  array.dtype() == DType::f64 ? copy(0.0) : copy(0.0f);
  return one;
}

using Measure = Measured (*)(const HostArray&, const HostArray&);

Check entry_check(const std::string& array, std::int64_t entry, const std::string& label, CheckKind kind,
                  const char* suffix, const char* norm, double tolerance, const std::string& why,
                  Measure measure) {
  return {label + suffix,
          kind,
          fmt::format("{} (entry {} of each item of {})", label, entry, array),
          norm,
          tolerance,
          why,
          true,
          [=](const Judged& j) {
            return measure(entry_of(output(j, array), entry, label), entry_of(truth(j, array), entry, label));
          }};
}

}  // namespace

Check relative_l2_of_entry(const std::string& array, std::int64_t entry, const std::string& label,
                           double tolerance, const std::string& why) {
  return entry_check(array, entry, label, CheckKind::paper, "_rel_l2", "relative L2", tolerance, why,
                     relative_l2);
}

Check local_error_of_entry(const std::string& array, std::int64_t entry, const std::string& label,
                           double tolerance, const std::string& why) {
  return entry_check(array, entry, label, CheckKind::local, "_local", "largest error / rms", tolerance, why,
                     max_error_over_rms);
}

}  // namespace gpuphys::entry_checks
