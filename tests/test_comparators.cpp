// The measures that judge, tried before anything relies on them.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys {
namespace {

constexpr std::int64_t kN = 20000;
constexpr double kTolerance = 1e-3;

HostArray truth() {
  HostArray t("u", DType::f64, {20, 1000});
  for (std::int64_t i = 0; i < kN; ++i)
    t.as<double>()[static_cast<std::size_t>(i)] = uniform11(5, 0, static_cast<std::uint64_t>(i));
  return t;
}

// float32 truth plus a perturbation of the given relative L2 size.
HostArray perturbed(const HostArray& t, double relative) {
  HostArray g("u", DType::f32, t.shape());
  for (std::int64_t i = 0; i < kN; ++i) {
    // Alternating signs around values rounded first: the L2 error is `relative` up to float32 rounding.
    const double r = static_cast<double>(static_cast<float>(t.value(i)));
    g.as<float>()[static_cast<std::size_t>(i)] =
        static_cast<float>(r * (1 + (i % 2 == 0 ? relative : -relative)));
  }
  return g;
}

bool accepted(const Check& check, const HostArray& got, const HostArray& t) {
  const Problem none;
  Arrays outputs, truths;
  outputs.push_back(got.clone());
  truths.push_back(t.clone());
  return passes(check.measure({none, outputs, &truths}).error, check.tolerance);
}

TEST(Comparators, HalfTheTolerancePassesAndTwiceFails) {
  const HostArray t = truth();
  const Check check = relative_l2_check("u", kTolerance, "test");
  EXPECT_TRUE(accepted(check, perturbed(t, 0.5 * kTolerance), t));
  EXPECT_FALSE(accepted(check, perturbed(t, 2 * kTolerance), t));
  EXPECT_NEAR(relative_l2(perturbed(t, 0.5 * kTolerance), t).error, 0.5 * kTolerance, 1e-3 * kTolerance);
}

TEST(Comparators, LocalCheckHalfPassesAndTwiceFails) {
  const HostArray t = truth();
  const Check check = local_error_check("u", kTolerance, "test");
  const double rms = std::sqrt(1.0 / 3);
  for (const auto& [factor, expected] : {std::pair{0.5, true}, std::pair{2.0, false}}) {
    HostArray g = perturbed(t, 0);
    g.as<float>()[777] += static_cast<float>(factor * kTolerance * rms);
    EXPECT_EQ(accepted(check, g, t), expected) << factor;
  }
}

TEST(Comparators, OneBadCellIsFoundAndLocated) {
  const HostArray t = truth();
  HostArray g = perturbed(t, 0);
  g.as<float>()[12345] += 0.5f;
  const Measured m = max_error_over_rms(g, t);
  EXPECT_NEAR(m.error, 0.5 / std::sqrt(1.0 / 3), 0.01);
  EXPECT_NE(m.detail.find("u[12,345]"), std::string::npos) << m.detail;
  const Measured count = count_above(g, t, 0.1);
  EXPECT_EQ(count.error, 1);
  EXPECT_NE(count.detail.find("u[12,345]"), std::string::npos) << count.detail;
}

TEST(Comparators, ASmallErrorThatTheGlobalNormForgivesFailsTheLocalCheck) {
  const HostArray t = truth();
  HostArray g = perturbed(t, 0);
  g.as<float>()[5] += 0.02f;
  EXPECT_TRUE(accepted(relative_l2_check("u", kTolerance, "test"), g, t));
  EXPECT_FALSE(accepted(local_error_check("u", kTolerance, "test"), g, t));
}

TEST(Comparators, NonFiniteOutputsFailEveryMeasure) {
  const HostArray t = truth();
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
                          -std::numeric_limits<float>::infinity()}) {
    HostArray g = perturbed(t, 0);
    g.as<float>()[19999] = bad;
    EXPECT_FALSE(accepted(relative_l2_check("u", kTolerance, "test"), g, t)) << bad;
    EXPECT_FALSE(accepted(local_error_check("u", kTolerance, "test"), g, t)) << bad;
    EXPECT_EQ(count_above(g, t, 0.1).error, 1) << bad;
  }
}

TEST(Comparators, NonFiniteTruthFails) {
  HostArray t = truth();
  const HostArray g = perturbed(t, 0);
  t.as<double>()[3] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(accepted(relative_l2_check("u", kTolerance, "test"), g, t));
  EXPECT_FALSE(accepted(local_error_check("u", kTolerance, "test"), g, t));
}

TEST(Comparators, ZeroTruthTurnsRelativeIntoAbsolute) {
  HostArray t("u", DType::f64, {4});
  HostArray g("u", DType::f32, {4});
  EXPECT_EQ(relative_l2(g, t).error, 0);
  EXPECT_EQ(max_error_over_rms(g, t).error, 0);
  g.as<float>()[2] = 0.25f;
  EXPECT_EQ(relative_l2(g, t).error, 0.25);
  EXPECT_EQ(max_error_over_rms(g, t).error, 0.25);
}

TEST(Comparators, TruthIsRoundedOnceBeforeItIsCompared) {
  HostArray t("u", DType::f64, {1});
  t.as<double>()[0] = 1.0 + 0x1p-30;
  HostArray g("u", DType::f32, {1});
  g.as<float>()[0] = 1.0f;
  EXPECT_EQ(relative_l2(g, t).error, 0);
  EXPECT_NEAR(truth_gap(g, t), 0x1p-30, 0x1p-50);
}

TEST(Comparators, ShapesMustAgreeAndEmptyArraysAreErrors) {
  const HostArray t("u", DType::f64, {4, 5}), g("u", DType::f32, {5, 4}), none("u", DType::f32, {0}),
      no_truth("u", DType::f64, {0});
  EXPECT_THROW(relative_l2(g, t), Error);
  EXPECT_THROW(max_error_over_rms(g, t), Error);
  EXPECT_THROW(count_above(g, t, 1), Error);
  EXPECT_THROW(relative_l2(none, no_truth), Error);
}

TEST(Comparators, OnlyFiniteErrorsUpToTheTolerancePass) {
  EXPECT_TRUE(passes(0, 0));
  EXPECT_TRUE(passes(1e-6, 1e-6));
  EXPECT_FALSE(passes(std::nextafter(1e-6, 1), 1e-6));
  EXPECT_FALSE(passes(std::numeric_limits<double>::quiet_NaN(), 1));
  EXPECT_FALSE(passes(std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()));
}

}  // namespace
}  // namespace gpuphys
