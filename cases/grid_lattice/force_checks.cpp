#include "cases/grid_lattice/force_checks.hpp"

#include <array>
#include <cmath>
#include <vector>

#include "core/base/parallel.hpp"

namespace gpuphys::force {
namespace {

constexpr std::array kComponents = {"fx", "fy", "fz"};

// Sum of squares of a truth rounded to float32.
double square_of(const HostArray& expected) {
  std::vector<double> sums(static_cast<std::size_t>(pieces_of(expected.size())), 0.0);
  parallel_pieces(expected.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const double v = static_cast<float>(expected.value(i));
      sums[static_cast<std::size_t>(piece)] += v * v;
    }
  });
  double total = 0;
  for (const double sum : sums) total += sum;
  return total;
}

// One component as the comparators see it: its error, which they divide by its own norm unless that is zero.
struct Component {
  Measured measured;
  double square;
};

template <class Compare>
std::array<Component, 3> components(const Judged& j, Compare compare) {
  std::array<Component, 3> all;
  for (std::size_t c = 0; c < 3; ++c) {
    const HostArray& expected = truth(j, kComponents[c]);
    all[c] = {compare(output(j, kComponents[c]), expected), square_of(expected)};
  }
  return all;
}

}  // namespace

Check relative_l2(double tolerance, const std::string& why) {
  return {"force_rel_l2",
          CheckKind::paper,
          "fx, fy, fz as one vector",
          "relative L2",
          tolerance,
          why,
          true,
          [](const Judged& j) {
            double error = 0, square = 0;
            for (const Component& c : components(j, gpuphys::relative_l2)) {
              const double e = c.measured.error;
              error += c.square > 0 ? e * e * c.square : e * e;
              square += c.square;
            }
            return Measured{std::sqrt(square > 0 ? error / square : error), ""};
          }};
}

Check local(double tolerance, const std::string& why) {
  return {"force_local",
          CheckKind::local,
          "fx, fy, fz",
          "largest error / rms of a component",
          tolerance,
          why,
          true,
          [](const Judged& j) {
            const std::array<Component, 3> all = components(j, max_error_over_rms);
            const double size = static_cast<double>(output(j, kComponents[0]).size());
            double square = 0;
            for (const Component& c : all) square += c.square;
            const double rms = square > 0 ? std::sqrt(square / (3 * size)) : 1;
            Measured worst;
            for (const Component& c : all) {
              const double own = c.square > 0 ? std::sqrt(c.square / size) : 1;
              const double e = c.measured.error * own / rms;
              if (e <= worst.error) continue;  // not taken for NaN
              worst = {e, c.measured.detail};
              if (!std::isfinite(e)) break;
            }
            return worst;
          }};
}

}  // namespace gpuphys::force
