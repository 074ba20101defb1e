// The serial baseline of advect_rk2, validated on its own: by hand, by closed forms, and by its order of
// accuracy.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "cases/grid_lattice/mac_advection_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys {
namespace {

using mac_advection::problem_from;
using testing::run_module;

const Task& task() {
  return find_task("advect_rk2");
}

double at(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return u.value((i * u.shape()[1] + j) * u.shape()[2] + k);
}

TEST(AdvectRk2Baseline, TinyGridByHand) {
  // ux falls linearly along x and is the only component: u(x) = (4 - x/dx) m/s with s = dt/dx cells per m/s.
  // From the face at x = i the midpoint is i - s/2 u_i, and so on; with s = 1/4 every number below is exact.
  Problem p = problem_from({4, 1, 1}, [](int c, std::int64_t i, std::int64_t, std::int64_t) {
    return c == 0 ? 4.0 - static_cast<double>(i) : 0.0;
  });
  p.set_scalar("dt", 0x1p-10);
  p.set_scalar("dx", 0x1p-8);
  const Arrays out = run_module(task(), "baseline_f64", p);
  const HostArray& ux = find(out, "ux", "outputs");
  // i = 4: at rest. i = 3: k1 = 1, midpoint 2.875 with k2 = 1.125, departure 2.71875 with value 1.28125.
  EXPECT_EQ(at(ux, 4, 0, 0), 0);
  EXPECT_EQ(at(ux, 3, 0, 0), 1.28125);
  // i = 2: k1 = 2, midpoint 1.75 with k2 = 2.25, departure 1.4375 with value 2.5625.
  EXPECT_EQ(at(ux, 2, 0, 0), 2.5625);
  // i = 0: k1 = 4, midpoint -0.5, beyond the last sample: k2 = 4, departure -1: value 4.
  EXPECT_EQ(at(ux, 0, 0, 0), 4);
}

TEST(AdvectRk2Baseline, UniformFlowIsUnchanged) {
  const Problem p =
      problem_from({5, 6, 7}, [](int c, std::int64_t, std::int64_t, std::int64_t) { return 1.25 * (c + 1); });
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t i = 0; i < out[c].size(); ++i)
      EXPECT_NEAR(out[c].value(i), p.inputs[c].value(i), 1e-14);
  }
}

TEST(AdvectRk2Baseline, AnInterchangeOfAxesInterchangesTheResult) {
  // The field of the transposed problem is u'_x(x,y,z) = u_y(y,x,z) and so on: any mix-up of axes breaks the
  // identity.
  const auto wave = [](int c, double x, double y, double z) {
    const double s =
        std::sin(0.31 * x + 0.2 * c) * std::cos(0.17 * y - 0.4 * c) + 0.3 * std::sin(0.23 * z + c);
    return 1.5 * s;
  };
  const auto sample = [&](int c, std::int64_t i, std::int64_t j, std::int64_t k) {
    return wave(c, static_cast<double>(i) + (c == 0 ? 0 : 0.5), static_cast<double>(j) + (c == 1 ? 0 : 0.5),
                static_cast<double>(k) + (c == 2 ? 0 : 0.5));
  };
  const auto swapped = [](int c) { return c == 2 ? 2 : 1 - c; };
  const Arrays a = run_module(task(), "baseline_f64", problem_from({8, 6, 7}, sample));
  const Arrays b = run_module(
      task(), "baseline_f64",
      problem_from({6, 8, 7}, [&](int c, auto i, auto j, auto k) { return sample(swapped(c), j, i, k); }));
  for (int c = 0; c < 3; ++c) {
    const HostArray& u = a[static_cast<std::size_t>(c)];
    const HostArray& w = b[static_cast<std::size_t>(swapped(c))];
    for (std::int64_t i = 0; i < u.shape()[0]; ++i) {
      for (std::int64_t j = 0; j < u.shape()[1]; ++j) {
        for (std::int64_t k = 0; k < u.shape()[2]; ++k) ASSERT_NEAR(at(u, i, j, k), at(w, j, i, k), 1e-14);
      }
    }
  }
}

// Error of the trace at the centre of a rigid rotation about z, where trilinear interpolation is exact and
// the exact departure point is known: u = w x r, so u'(x) = w x (R(-w dt) x).
double rotation_error(double angle) {
  constexpr std::int64_t n = 24;
  const double dx = 0x1p-8, dt = 0x1p-7, w = angle / dt;
  const auto position = [&](std::int64_t index, bool staggered) {
    return (static_cast<double>(index) + (staggered ? 0.0 : 0.5) - 0.5 * n) * dx;
  };
  const Problem p = problem_from({n, n, 1}, [&](int c, std::int64_t i, std::int64_t j, std::int64_t) {
    if (c == 0) return -w * position(j, false);
    if (c == 1) return w * position(i, false);
    return 0.0;
  });
  const Arrays out = run_module(task(), "baseline_f64", p);
  double worst = 0;
  for (std::int64_t i = n / 3; i <= n - n / 3; ++i) {
    for (std::int64_t j = n / 3; j < n - n / 3; ++j) {
      const double x = position(i, true), y = position(j, false);
      const double y_departure = -std::sin(angle) * x + std::cos(angle) * y;
      worst = std::max(worst, std::abs(at(out[0], i, j, 0) + w * y_departure) / (w * dx * n / 6));
    }
  }
  return worst;
}

TEST(AdvectRk2Baseline, TheTraceIsOfSecondOrder) {
  // The error of one step of a second-order trace is of third order in the step.
  const double coarse = rotation_error(0.2), fine = rotation_error(0.1);
  EXPECT_NEAR(std::log2(coarse / fine), 3.0, 0.2) << coarse << " " << fine;
}

TEST(AdvectRk2Baseline, OutputsStayWithinTheRangeOfTheInput) {
  const Problem p = task().set("hard_cfl60").make();
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::size_t c = 0; c < 3; ++c) {
    const auto in = p.inputs[c].as<float>();
    const auto [low, high] = std::minmax_element(in.begin(), in.end());
    for (std::int64_t i = 0; i < out[c].size(); ++i) {
      ASSERT_GE(out[c].value(i), static_cast<double>(*low) - 1e-12);
      ASSERT_LE(out[c].value(i), static_cast<double>(*high) + 1e-12);
    }
  }
}

}  // namespace
}  // namespace gpuphys
