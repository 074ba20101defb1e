// Shared by the tests of the position-based fluid baselines: problems of a few particles, results as vectors,
// and the kernels of cases/position_constraint/fluid.md written out for all pairs.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "cases/position_constraint/fluid_inputs.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing {

using fluid::Particle, fluid::Particles, fluid::Vec3;

inline Problem fluid_problem(const std::string& task, const Particles& particles,
                             std::initializer_list<std::pair<const char*, double>> scalars) {
  Problem p = fluid::problem_of(find_task(task).contract, particles);
  for (const auto& [name, value] : scalars) p.set_scalar(name, value);
  return p;
}

inline std::vector<Vec3> vectors(const HostArray& array) {
  std::vector<Vec3> all(static_cast<std::size_t>(array.shape()[0]));
  for (std::size_t i = 0; i < all.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) all[i][c] = array.value(static_cast<std::int64_t>(3 * i + c));
  }
  return all;
}

/// The output number `which` of the FP64 baseline.
inline std::vector<Vec3> truth_of(const std::string& task, const Problem& p, std::size_t which = 0) {
  return vectors(run_module(find_task(task), "baseline_f64", p)[which]);
}

inline void expect_vec(const Vec3& got, const Vec3& expected, double tolerance, std::size_t item = 0) {
  for (std::size_t c = 0; c < 3; ++c)
    ASSERT_NEAR(got[c], expected[c], tolerance) << "particle " << item << ", component " << c;
}
inline void expect_all(const std::vector<Vec3>& got, const std::vector<Vec3>& expected, double tolerance) {
  ASSERT_EQ(got.size(), expected.size());
  for (std::size_t i = 0; i < got.size(); ++i) expect_vec(got[i], expected[i], tolerance, i);
}

inline double dot(const Vec3& a, const Vec3& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
inline double length(const Vec3& a) {
  return std::sqrt(dot(a, a));
}
inline Vec3 plus(const Vec3& a, double factor, const Vec3& b) {
  return {a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]};
}
inline Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline double largest(const std::vector<Vec3>& all) {
  double most = 0;
  for (const Vec3& a : all) most = std::max({most, std::abs(a[0]), std::abs(a[1]), std::abs(a[2])});
  return most;
}
inline Vec3 sum(const std::vector<Vec3>& all) {
  Vec3 total{};
  for (const Vec3& a : all) total = plus(total, 1, a);
  return total;
}

inline double poly6(double r, double h) {
  return r < h ? 315 / (64 * std::numbers::pi * std::pow(h, 9)) * std::pow(h * h - r * r, 3) : 0;
}
/// grad W with respect to the first of two points that are `d` apart.
inline Vec3 spiky(const Vec3& d, double h) {
  const double r = length(d);
  if (r == 0 || r >= h) return {0, 0, 0};
  return plus({0, 0, 0}, -45 / (std::numbers::pi * std::pow(h, 6)) * (h - r) * (h - r) / r, d);
}

/// Cyclic permutation of the axes and reversal of the order: what no result may depend on.
inline Particles turned(Particles all) {
  std::reverse(all.begin(), all.end());
  for (Particle& p : all) {
    std::rotate(p.x.begin(), p.x.begin() + 1, p.x.end());
    std::rotate(p.v.begin(), p.v.begin() + 1, p.v.end());
  }
  return all;
}
inline std::vector<Vec3> turned(std::vector<Vec3> all) {
  std::reverse(all.begin(), all.end());
  for (Vec3& a : all) std::rotate(a.begin(), a.begin() + 1, a.end());
  return all;
}

/// A small jittered block, compressed and swirling.
inline fluid::Block test_block() {
  return {.lattice = {7, 6, 8},
          .seed = 5,
          .corner = {-3, 1, 2},
          .jitter = 0.15,
          .wave = 0.2,
          .flow = 1,
          .flow_length = 9,
          .noise = 0.1};
}

}  // namespace gpuphys::testing
