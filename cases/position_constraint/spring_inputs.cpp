#include "cases/position_constraint/spring_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/judge/comparators.hpp"

namespace gpuphys::position_constraint {
namespace {

HostArray& array_of(Problem& p, const std::string& name) {
  for (HostArray& a : p.inputs) {
    if (a.name() == name) return a;
  }
  throw Error(ExitCode::internal, fmt::format("the problem has no array '{}'", name));
}

// Displacement of coordinate i from the input, in FP64; truth is rounded to float32 first, as every output
// is.
double displacement(const HostArray& x, const HostArray& moved, std::int64_t i) {
  return static_cast<double>(static_cast<float>(moved.value(i))) - x.value(i);
}

struct Displacements {
  const HostArray &x, &got, &truth;
  explicit Displacements(const Judged& j)
      : x(find(j.problem.inputs, "x", "inputs")),
        got(find(j.outputs, "x_new", "outputs")),
        truth(find(*j.truth, "x_new", "truth")) {
    if (got.shape() != x.shape() || truth.shape() != x.shape()) {
      throw Error(ExitCode::internal, "x_new must have the shape of x");
    }
  }
  double square_of_truth() const {
    double total = 0;
    for (std::int64_t i = 0; i < x.size(); ++i) {
      const double t = displacement(x, truth, i);
      total += t * t;
    }
    return total;
  }
};

// Largest |x_new - x| over the coordinates of the particles for which `counts(particle)` holds.
template <class Counts>
Measured largest_displacement(const Judged& j, Counts&& counts) {
  const HostArray& x = find(j.problem.inputs, "x", "inputs");
  const HostArray& got = find(j.outputs, "x_new", "outputs");
  Measured worst;
  for (std::int64_t i = 0; i < x.size(); ++i) {
    if (!counts(i / 3)) continue;
    const double e = std::abs(displacement(x, got, i));
    if (!(e <= worst.error)) {
      worst = {e, fmt::format("{}: from {:.9g} to {:.9g}", index_text(got, i), x.value(i), got.value(i))};
      if (!std::isfinite(e)) return worst;
    }
  }
  return worst;
}

}  // namespace

void store(const SpringSystem& system, Problem& p) {
  const auto x = array_of(p, "x").as<float>();
  const auto w = array_of(p, "inv_mass").as<float>();
  const auto springs = array_of(p, "springs").as<std::int32_t>();
  const auto rest = array_of(p, "rest").as<float>();
  if (x.size() != 3 * system.position.size() || springs.size() != 2 * system.springs.size() ||
      rest.size() != system.rest.size()) {
    throw Error(ExitCode::internal, "the problem was made for another number of particles or springs");
  }
  for (std::size_t i = 0; i < system.position.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) x[3 * i + d] = static_cast<float>(system.position[i][d]);
    w[i] = system.inv_mass.empty() ? 1.0f : static_cast<float>(system.inv_mass[i]);
  }
  for (std::size_t j = 0; j < system.springs.size(); ++j) {
    springs[2 * j] = system.springs[j][0];
    springs[2 * j + 1] = system.springs[j][1];
    rest[j] = static_cast<float>(system.rest[j]);
  }
}

Check displacement_check(double tolerance, const std::string& why) {
  return {
      "dx_rel_l2", CheckKind::paper, "x_new - x", "relative L2", tolerance, why, true, [](const Judged& j) {
        const Displacements d(j);
        double error = 0;
        for (std::int64_t i = 0; i < d.x.size(); ++i) {
          const double e = displacement(d.x, d.got, i) - displacement(d.x, d.truth, i);
          error += e * e;
        }
        const double square = d.square_of_truth();
        Measured m;
        m.error = square == 0 ? std::sqrt(error) : std::sqrt(error / square);
        m.detail = fmt::format("rms displacement of a coordinate {:.3g} m",
                               std::sqrt(square / static_cast<double>(d.x.size())));
        if (!std::isfinite(error) || !std::isfinite(square)) {
          m = {std::numeric_limits<double>::quiet_NaN(), "non-finite values"};
        }
        return m;
      }};
}

Check local_displacement_check(double tolerance, const std::string& why) {
  return {
      "dx_local",
      CheckKind::local,
      "x_new - x",
      "largest error / rms displacement",
      tolerance,
      why,
      true,
      [](const Judged& j) {
        const Displacements d(j);
        double rms = std::sqrt(d.square_of_truth() / static_cast<double>(d.x.size()));
        if (rms == 0) rms = 1;
        Measured worst;
        for (std::int64_t i = 0; i < d.x.size(); ++i) {
          const double got = displacement(d.x, d.got, i), truth = displacement(d.x, d.truth, i);
          const double e = std::abs(got - truth) / rms;
          if (!(e <= worst.error)) {
            worst = {e, fmt::format("{} moved by {:.9g}, expected {:.9g}", index_text(d.got, i), got, truth)};
            if (!std::isfinite(e)) return worst;
          }
        }
        return worst;
      }};
}

Check free_particles_check(double tolerance, const std::string& why) {
  return {
      "free_unmoved",
      CheckKind::paper,
      "x_new - x of particles without springs",
      "largest absolute value, m",
      tolerance,
      why,
      false,
      [](const Judged& j) {
        std::vector<char> held(static_cast<std::size_t>(find(j.problem.inputs, "x", "inputs").shape()[0]), 0);
        for (const std::int32_t end : find(j.problem.inputs, "springs", "inputs").as<std::int32_t>()) {
          held[static_cast<std::size_t>(end)] = 1;
        }
        return largest_displacement(j, [&](std::int64_t i) { return !held[static_cast<std::size_t>(i)]; });
      }};
}

Check momentum_check() {
  return {"momentum",
          CheckKind::invariant,
          "x_new - x",
          "largest |sum (x_new - x)/w| along an axis / (2^-24 sum (|x_new| + 16 |x_new - x|)/w)",
          4,
          "each spring moves its ends by opposite amounts w n dlambda; what remains is the rounding of every "
          "output "
          "(half a unit, 2^-24 |x_new|) and of some 16 additions to each displacement",
          false,
          [](const Judged& j) {
            const HostArray& x = find(j.problem.inputs, "x", "inputs");
            const HostArray& w = find(j.problem.inputs, "inv_mass", "inputs");
            const HostArray& got = find(j.outputs, "x_new", "outputs");
            Measured worst;
            for (std::int64_t d = 0; d < 3; ++d) {
              double sum = 0, scale = 0;
              for (std::int64_t i = 0; i < w.size(); ++i) {
                const double moved = displacement(x, got, 3 * i + d);
                if (w.value(i) == 0) continue;
                sum += moved / w.value(i);
                scale += (std::abs(got.value(3 * i + d)) + 16 * std::abs(moved)) / w.value(i);
              }
              const double e = scale == 0 ? std::abs(sum) : std::abs(sum) / (0x1p-24 * scale);
              if (!(e <= worst.error)) worst = {e, fmt::format("along axis {}: sum {:.3g} kg m", d, sum)};
            }
            return worst;
          }};
}

Check pinned_check() {
  return {"pinned_unmoved",
          CheckKind::invariant,
          "x_new - x of particles with w = 0",
          "largest absolute value, m",
          0,
          "a displacement is a sum of terms with the factor w = 0, and x + 0 = x in any precision",
          false,
          [](const Judged& j) {
            const HostArray& w = find(j.problem.inputs, "inv_mass", "inputs");
            return largest_displacement(j, [&](std::int64_t i) { return w.value(i) == 0; });
          }};
}

Check unmoved_check(double tolerance, const std::string& why) {
  return {"unmoved",
          CheckKind::invariant,
          "x_new - x",
          "largest absolute value, m",
          tolerance,
          why,
          false,
          [](const Judged& j) { return largest_displacement(j, [](std::int64_t) { return true; }); }};
}

}  // namespace gpuphys::position_constraint
