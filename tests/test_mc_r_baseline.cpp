// The serial baseline of mc_r, validated on its own: what the step is without time, on a field without
// divergence, and over many steps, against stable_fluids.
#include <gtest/gtest.h>

#include <cmath>

#include "tests/time_loops/mc_r.hpp"

namespace gpuphys {
namespace {

using mac_fluid::Extents;

Arrays run(const Problem& p) {
  return testing::run_module(find_task("mc_r"), "baseline_f64", p);
}

// Without time: P (2 P u - u) = P u, the projection of stable_fluids.
TEST(McRBaseline, WithoutTimeItIsAProjection) {
  const Extents n{9, 8, 7};
  const mac_fluid::Open open = mac_fluid::random_faces(n, 3, 0.2);
  Problem p = testing::fluid_at_rest("mc_r", n, open, {{"dx", 1}, {"dt", 0}, {"tol", 1e-6}});
  Problem q =
      testing::fluid_at_rest("stable_fluids", n, open, {{"dx", 1}, {"dt", 0}, {"nu", 0}, {"tol", 1e-6}});
  mac_fluid::set_noise(p, 4, 1);
  mac_fluid::set_noise(q, 4, 1);
  const Arrays a = run(p), b = testing::run_module(find_task("stable_fluids"), "baseline_f64", q);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < a[c].size(); ++f) ASSERT_NEAR(a[c].value(f), b[c].value(f), 1e-10);
  }
}

// Halving the step of a steady vortex divides its error by four: second order in time.
TEST(McRBaseline, IsOfSecondOrderInTime) {
  const auto after = [](double dt, int steps) {
    Problem p = testing::closed_vortex("mc_r", {{"dx", 1}, {"dt", dt}, {"tol", 1e-6}});
    // A second, smaller vortex makes the flow unsteady.
    const Problem steady = p.clone();
    mac_fluid::set_velocity(p, [&steady](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
      const HostArray& u = steady.inputs[static_cast<std::size_t>(axis)];
      const double x = static_cast<double>(i), y = static_cast<double>(j), w = std::acos(-1.0) / 16;
      const double more = axis == 0   ? std::sin(2 * w * x) * std::cos(w * (y + 0.5))
                          : axis == 1 ? -2 * std::cos(2 * w * (x + 0.5)) * std::sin(w * y)
                                      : 0;
      return u.value(testing::face(u, i, j, k)) + 0.3 * more;
    });
    Arrays out;
    for (int step = 0; step < steps; ++step) {
      out = run(p);
      testing::feed_velocity(out, p);
    }
    return out;
  };
  const auto distance = [](const Arrays& a, const Arrays& b) {
    double sum = 0;
    for (std::size_t c = 0; c < 2; ++c) {
      for (std::int64_t f = 0; f < a[c].size(); ++f)
        sum += (a[c].value(f) - b[c].value(f)) * (a[c].value(f) - b[c].value(f));
    }
    return std::sqrt(sum);
  };
  const Arrays coarse = after(2, 2), middle = after(1, 4), fine = after(0.5, 8);
  // Errors of interpolation, which grow with the number of steps, are part of both differences.
  EXPECT_GT(distance(coarse, middle), 1.5 * distance(middle, fine));
}

TEST(McRBaseline, KeepsMoreEnergyThanStableFluids) {
  const double reflected = testing::energy_left(
      "mc_r", "baseline_f64", testing::closed_vortex("mc_r", {{"dx", 1}, {"dt", 1}, {"tol", 1e-5}}));
  const double plain = testing::energy_left(
      "stable_fluids", "baseline_f64",
      testing::closed_vortex("stable_fluids", {{"dx", 1}, {"dt", 1}, {"nu", 0}, {"tol", 1e-5}}));
  EXPECT_GT(1 - plain, 3 * (1 - reflected));
}

TEST(McRBaseline, TimeLoop) {
  testing::time_loop_mc_r("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
