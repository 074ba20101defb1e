// What every advection baseline must satisfy, whatever its scheme: by hand, by closed forms, and by its order
// of accuracy. A task's test instantiates MacAdvection with its scheme.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "cases/grid_lattice/mac_advection_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

struct AdvectionScheme {
  std::string task;
  int order;      ///< of the scheme in time
  double growth;  ///< P(1/4), P being the scheme's polynomial
};

class MacAdvection : public ::testing::TestWithParam<AdvectionScheme> {
 protected:
  const Task& task() const { return find_task(GetParam().task); }
  Arrays run(const Problem& p) const { return run_module(task(), "baseline_f64", p); }
};

inline double at(const HostArray& u, std::int64_t i, std::int64_t j, std::int64_t k) {
  return u.value((i * u.shape()[1] + j) * u.shape()[2] + k);
}

TEST_P(MacAdvection, TinyGridByHand) {
  // ux falls linearly along x and is the only component: u(x) = (4 - x/dx) m/s with s = dt/dx = 1/4 cells per
  // m/s. A trace that stays inside multiplies it by P(1/4).
  Problem p = mac_advection::problem_from({4, 1, 1}, [](int c, std::int64_t i, std::int64_t, std::int64_t) {
    return c == 0 ? 4.0 - static_cast<double>(i) : 0.0;
  });
  p.set_scalar("dt", 0x1p-10);
  p.set_scalar("dx", 0x1p-8);
  const Arrays out = run(p);
  const HostArray& ux = find(out, "ux", "outputs");
  EXPECT_EQ(at(ux, 4, 0, 0), 0);  // at rest
  EXPECT_DOUBLE_EQ(at(ux, 3, 0, 0), GetParam().growth);
  EXPECT_DOUBLE_EQ(at(ux, 2, 0, 0), 2 * GetParam().growth);
  EXPECT_EQ(at(ux, 0, 0, 0), 4);  // from beyond the wall, where 4 is extended
}

TEST_P(MacAdvection, UniformFlowIsUnchanged) {
  const Problem p = mac_advection::problem_from(
      {5, 6, 7}, [](int c, std::int64_t, std::int64_t, std::int64_t) { return 1.25 * (c + 1); });
  const Arrays out = run(p);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t i = 0; i < out[c].size(); ++i)
      EXPECT_NEAR(out[c].value(i), p.inputs[c].value(i), 1e-14);
  }
}

TEST_P(MacAdvection, AnInterchangeOfAxesInterchangesTheResult) {
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
  const Arrays a = run(mac_advection::problem_from({8, 6, 7}, sample));
  const Arrays b = run(mac_advection::problem_from(
      {6, 8, 7}, [&](int c, auto i, auto j, auto k) { return sample(swapped(c), j, i, k); }));
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
inline double rotation_error(const Task& task, double angle) {
  constexpr std::int64_t n = 24;
  const double dx = 0x1p-8, dt = 0x1p-7, w = angle / dt;
  const auto position = [&](std::int64_t index, bool staggered) {
    return (static_cast<double>(index) + (staggered ? 0.0 : 0.5) - 0.5 * n) * dx;
  };
  const Problem p =
      mac_advection::problem_from({n, n, 1}, [&](int c, std::int64_t i, std::int64_t j, std::int64_t) {
        if (c == 0) return -w * position(j, false);
        if (c == 1) return w * position(i, false);
        return 0.0;
      });
  const Arrays out = run_module(task, "baseline_f64", p);
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

TEST_P(MacAdvection, OneStepOfARotationHasTheErrorOfItsOrder) {
  // The error of one step is of one order more than the scheme. Angles for which the field is exact in
  // float32.
  const double coarse = rotation_error(task(), 0.25), fine = rotation_error(task(), 0.125);
  EXPECT_NEAR(std::log2(coarse / fine), GetParam().order + 1, 0.2) << coarse << " " << fine;
}

TEST_P(MacAdvection, OutputsStayWithinTheRangeOfTheInput) {
  const Problem p = task().set("hard_cfl60").make();
  const Arrays out = run(p);
  for (std::size_t c = 0; c < 3; ++c) {
    const auto in = p.inputs[c].as<float>();
    const auto [low, high] = std::minmax_element(in.begin(), in.end());
    for (std::int64_t i = 0; i < out[c].size(); ++i) {
      ASSERT_GE(out[c].value(i), static_cast<double>(*low) - 1e-12);
      ASSERT_LE(out[c].value(i), static_cast<double>(*high) + 1e-12);
    }
  }
}

}  // namespace gpuphys::testing
