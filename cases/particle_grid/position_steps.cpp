#include "cases/particle_grid/position_steps.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/judge/checks.hpp"

namespace gpuphys::position_steps {
namespace {

double spacing_of_floats(double x) {
  const float f = std::abs(static_cast<float>(x));
  return static_cast<double>(std::nextafter(f, std::numeric_limits<float>::infinity())) -
         static_cast<double>(f);
}

}  // namespace

Check steps_check(const std::string& array, const std::string& start, double share, double tolerance,
                  const std::string& why) {
  return worst_over(
      {.name = array + "_steps",
       .kind = CheckKind::local,
       .array = array,
       .quantity = fmt::format(
           "largest |x' - truth| over (one step of float32 at the larger of |x| and |x'|, plus {} "
           "of the rms displacement)",
           share),
       .tolerance = tolerance,
       .why = why},
      [array, start, share](const Judged& j) {
        const HostArray &got = output(j, array), &expected = truth(j, array), &from = input(j, start);
        double square = 0;
        for (std::int64_t i = 0; i < got.size(); ++i) {
          const double change = expected.value(i) - from.value(i);
          square += change * change;
        }
        const double allowed = share * std::sqrt(square / static_cast<double>(got.size()));
        return Items{got.size(),
                     [&got, &expected, &from, allowed](std::int64_t i) {
                       const double rounded = static_cast<double>(static_cast<float>(expected.value(i)));
                       const double step =
                           spacing_of_floats(std::max(std::abs(from.value(i)), std::abs(rounded)));
                       return (got.value(i) - rounded) / (step + allowed);
                     },
                     [&got, &expected, &from](std::int64_t i) {
                       return fmt::format("{}: got {:.9g}, expected {:.9g}, from {:.9g}", index_text(got, i),
                                          got.value(i), expected.value(i), from.value(i));
                     }};
      });
}

}  // namespace gpuphys::position_steps
