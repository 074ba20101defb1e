// 100 steps of mpm_explicit around one module: an elastic ball in free flight, a longitudinal wave in a bar;
// and one step against the two operators that it is made of.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "tests/run_module.hpp"
#include "tests/time_loops/p2g_mpm.hpp"

namespace gpuphys::testing {

namespace mpm_explicit_loop {

/// The outputs become the next step's inputs.
inline void advance(const Arrays& out, Problem& p) {
  const auto copy = [&](const char* name, std::size_t input) {
    const HostArray& from = find(out, name, "outputs");
    const auto to = p.inputs[input].as<float>();
    for (std::size_t i = 0; i < to.size(); ++i)
      to[i] = static_cast<float>(from.value(static_cast<std::int64_t>(i)));
  };
  copy("x_new", 0);
  copy("v_new", 1);
  copy("F_new", 2);
}

/// A ball that spins, drifts and is stretched: momentum is kept; nothing does work on it, so the energy only
/// falls (PIC damps) and the elastic part swings between bounds.
inline void ball_in_flight(const Task& task, const std::string& label) {
  Problem p = p2g_mpm_loop::spinning_ball();
  const auto start = p2g_mpm_loop::totals(p);
  const double energy = start.elastic + start.kinetic;
  double before = energy, largest_elastic = 0;
  for (int step = 0; step < 100; ++step) {
    const Arrays out = run_module(task, label, p);
    ASSERT_EQ(out.size(), 3u);
    advance(out, p);
    const auto now = p2g_mpm_loop::totals(p);
    ASSERT_TRUE(std::isfinite(now.elastic + now.kinetic)) << "step " << step;
    // An explicit step of a quarter of the limit pumps the elastic energy by less than PIC takes from the
    // motion.
    ASSERT_LE(now.elastic + now.kinetic, before + 1e-4 * energy) << "step " << step;
    before = now.elastic + now.kinetic;
    largest_elastic = std::max(largest_elastic, now.elastic);
  }
  EXPECT_LT(before, energy);
  const auto end = p2g_mpm_loop::totals(p);
  const double scale =
      std::abs(start.momentum[0]) + std::abs(start.momentum[1]) + std::abs(start.momentum[2]);
  for (std::size_t d = 0; d < 3; ++d) EXPECT_NEAR(end.momentum[d], start.momentum[d], 5e-6 * scale);
  EXPECT_LE(largest_elastic, start.elastic + 0.5 * start.kinetic);
}

/// A bar of particles on the line y = z = 0 of an array of one node along y and z: indices are clamped, so
/// there is no velocity gradient across the bar, and waves along it are those of uniaxial strain,
/// sqrt((lambda + 2 mu) / rho).
inline Problem bar(const Task& task, double amplitude) {
  constexpr std::int64_t cells = 80, first = 6, n = 2 * cells;
  Problem p = make_problem(task.contract, {{"n", n}, {"nx", cells + 2 * first + 1}, {"ny", 1}, {"nz", 1}});
  const Problem like = find_task("p2g_mpm").set("public_smoke").make();
  for (const char* name : {"dx", "dt", "mass_p", "V0", "mu", "lambda"}) p.set_scalar(name, like.scalar(name));
  const double dx = p.scalar("dx");
  for (std::int64_t q = 0; q < n; ++q) {
    const double along = 0.25 + 0.5 * static_cast<double>(q);  // cells from the end
    const auto at = static_cast<std::size_t>(q);
    p.inputs[0].as<float>()[3 * at] = static_cast<float>((static_cast<double>(first) + along) * dx);
    p.inputs[1].as<float>()[3 * at] =
        static_cast<float>(amplitude * std::cos(std::numbers::pi * along / static_cast<double>(cells)));
    for (std::size_t d = 0; d < 3; ++d) p.inputs[2].as<float>()[9 * at + 4 * d] = 1;
  }
  return p;
}

/// The bar's first mode swings with pi c / L. Its amplitude q obeys q(n+1) = a q(n) + b q(n-1), whose
/// coefficients, by least squares over 100 steps, hold frequency and damping.
inline double measured_wave_speed(const Task& task, const std::string& label) {
  Problem p = bar(task, 0.05);
  const std::int64_t n = p.inputs[0].shape()[0];
  const double cells = static_cast<double>(n) / 2;
  p.set_scalar("dt", 1.6 * p.scalar("dt"));  // 0.4 of the time that a wave needs for a cell
  const auto amplitude = [&] {
    double sum = 0;
    for (std::int64_t q = 0; q < n; ++q)
      sum += p.inputs[1].value(3 * q) *
             std::cos(std::numbers::pi * (0.25 + 0.5 * static_cast<double>(q)) / cells);
    return sum / static_cast<double>(n);
  };
  std::vector<double> q{amplitude()};
  for (int step = 0; step < 100; ++step) {
    advance(run_module(task, label, p), p);
    q.push_back(amplitude());
  }
  constexpr std::size_t stride = 8;  // steps between the samples of the fit: rounding weighs less
  double aa = 0, ab = 0, bb = 0, ra = 0, rb = 0;
  for (std::size_t i = stride; i + stride < q.size(); ++i) {
    aa += q[i] * q[i], ab += q[i] * q[i - stride], bb += q[i - stride] * q[i - stride];
    ra += q[i + stride] * q[i], rb += q[i + stride] * q[i - stride];
  }
  const double det = aa * bb - ab * ab, a = (ra * bb - rb * ab) / det, b = (aa * rb - ab * ra) / det;
  const double time = stride * p.scalar("dt");
  const double damping = -0.5 * std::log(-b) / time, swing = std::acos(0.5 * a / std::sqrt(-b)) / time;
  return std::sqrt(swing * swing + damping * damping) * cells * p.scalar("dx") / std::numbers::pi;
}

inline void wave_in_a_bar(const Task& task, const std::string& label) {
  const Problem p = bar(task, 0);
  const double density = p.scalar("mass_p") / p.scalar("V0");
  const double expected = std::sqrt((p.scalar("lambda") + 2 * p.scalar("mu")) / density);
  EXPECT_NEAR(measured_wave_speed(task, label) / expected, 1, 0.03);
}

/// Whether the modules of both operators are there too.
inline bool has_operators(const std::string& label) {
  for (const char* task : {"p2g_mpm", "g2p_mpm"}) {
    if (!std::filesystem::exists(std::string(GPUPHYS_MODULES) + "/" + task + "/" + label + ".so"))
      return false;
  }
  return true;
}

/// One step against p2g_mpm followed by g2p_mpm, which rounds the nodes' velocities to float32.
inline void is_its_operators(const Task& task, const std::string& label, const std::string& set) {
  const Problem p = task.set(set).make();
  const Arrays whole = run_module(task, label, p);
  const Arrays u = run_module(find_task("p2g_mpm"), label, p);
  const Task& back = find_task("g2p_mpm");
  Problem second = make_problem(back.contract, {{"n", p.inputs[0].shape()[0]},
                                                {"nx", u[0].shape()[0]},
                                                {"ny", u[0].shape()[1]},
                                                {"nz", u[0].shape()[2]}});
  second.set_scalar("dx", p.scalar("dx"));
  second.set_scalar("dt", p.scalar("dt"));
  const auto copy = [](const HostArray& from, HostArray& to) {
    const auto values = to.as<float>();
    for (std::size_t i = 0; i < values.size(); ++i)
      values[i] = static_cast<float>(from.value(static_cast<std::int64_t>(i)));
  };
  copy(p.inputs[0], second.inputs[0]);
  copy(p.inputs[2], second.inputs[1]);
  for (std::size_t c = 0; c < 3; ++c) copy(u[c], second.inputs[2 + c]);
  const Arrays parts = run_module(back, label, second);
  const auto compare = [&](const char* one, const char* other, double tolerance) {
    const HostArray &a = find(whole, one, "outputs"), &b = find(parts, other, "outputs");
    double difference = 0, square = 0;
    for (std::int64_t i = 0; i < a.size(); ++i) {
      difference += std::pow(a.value(i) - b.value(i), 2);
      square += b.value(i) * b.value(i);
    }
    EXPECT_LE(std::sqrt(difference), tolerance * std::sqrt(square)) << set << ": " << one;
  };
  compare("v_new", "v", 1e-6);  // some roundings of node velocities
  compare("F_new", "F_new", 1e-6);
  compare("x_new", "x_new", 1e-7);
}

}  // namespace mpm_explicit_loop

inline void time_loop_mpm_explicit(const std::string& label) {
  const Task& task = find_task("mpm_explicit");
  mpm_explicit_loop::ball_in_flight(task, label);
  mpm_explicit_loop::wave_in_a_bar(task, label);
  if (mpm_explicit_loop::has_operators(label)) {
    for (const char* set : {"public_smoke", "hard_edges", "hard_dx_tenth"})
      mpm_explicit_loop::is_its_operators(task, label, set);
  }
}

}  // namespace gpuphys::testing
