// The serial baseline of advect_mc, validated on its own.
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "tests/mac_advection.hpp"

namespace gpuphys::testing {

// P(1/4) by hand: 1 + 1/4 + 1/32 - 1/2048.
INSTANTIATE_TEST_SUITE_P(AdvectMcBaseline, MacAdvection,
                         ::testing::Values(AdvectionScheme{"advect_mc", 2, 1.28125 - 1.0 / 2048}));

// Values of uy along x, carried by a uniform ux of `cells` a step.
Problem carried_along_x(const std::vector<double>& values, double cells) {
  const double per_cell = cells * 0x1p-8 / 0x1p-7;
  return mac_advection::problem_from(
      {static_cast<std::int64_t>(values.size()), 1, 1},
      [&](int c, std::int64_t i, std::int64_t, std::int64_t) {
        return c == 0 ? per_cell : c == 1 ? values[static_cast<std::size_t>(i)] : 0.0;
      });
}

TEST(AdvectMcBaseline, CorrectionAndLimiterByHand) {
  // Half a cell a step: the prediction is 0 0 4 4 0, which the step back turns into 0 2 4 2 0. Half of what
  // that misses of the input makes 0 -1 6 3 0, of which the second lies beyond the two samples, both 0,
  // around its departure point.
  const Arrays out =
      run_module(find_task("advect_mc"), "baseline_f64", carried_along_x({0, 0, 8, 0, 0}, 0.5));
  const HostArray& uy = find(out, "uy", "outputs");
  const std::array<double, 5> expected{0, 0, 6, 3, 0};
  for (std::int64_t i = 0; i < 5; ++i) EXPECT_EQ(at(uy, i, 0, 0), expected[static_cast<std::size_t>(i)]) << i;
}

// Largest error of a sine over n cells, carried by 0.4 cells, on its slopes: at its extrema the limiter holds
// the correction.
double translation_error(const std::string& task, int n) {
  constexpr double cells = 0.4;
  const double k = 2 * std::numbers::pi / n;
  std::vector<double> values;
  for (int i = 0; i < n; ++i) values.push_back(std::sin(k * i));
  const Arrays out = run_module(find_task(task), "baseline_f64", carried_along_x(values, cells));
  double worst = 0;
  for (int i = 4; i < n - 4; ++i) {
    if (std::abs(std::cos(k * i)) < 0.6) continue;
    worst = std::max(worst, std::abs(at(out[1], i, 0, 0) - std::sin(k * (i - cells))));
  }
  return worst;
}

TEST(AdvectMcBaseline, CorrectionGainsAnOrderInSpace) {
  const auto order = [](const std::string& task) {
    return std::log2(translation_error(task, 48) / translation_error(task, 96));
  };
  EXPECT_NEAR(order("advect_rk2"), 2, 0.2);
  EXPECT_NEAR(order("advect_mc"), 3, 0.2);
}

}  // namespace gpuphys::testing
