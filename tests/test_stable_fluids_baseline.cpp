// The serial baseline of stable_fluids, validated on its own: projection by hand, idempotent and orthogonal;
// the decay of a vortex; energy over many steps.
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/time_loops/mc_r.hpp"
#include "tests/time_loops/stable_fluids.hpp"

namespace gpuphys {
namespace {

using mac_fluid::Extents;
using testing::face;

Arrays run(const Problem& p) {
  return testing::run_module(find_task("stable_fluids"), "baseline_f64", p);
}

// No time passes: the step is a projection.
Problem projection(Extents n, const mac_fluid::Open& open) {
  return testing::fluid_at_rest("stable_fluids", n, open, {{"dx", 1}, {"dt", 0}, {"nu", 1}, {"tol", 1e-6}});
}

// A ring of four cells, with a flow of 1 through one of its four faces of w = 1: a quarter goes around.
TEST(StableFluidsBaseline, ARingOfFourCellsByHand) {
  Problem p = projection({2, 2, 1}, mac_fluid::all_open());
  p.inputs[0].as<float>()[static_cast<std::size_t>(face(p.inputs[0], 1, 0, 0))] = 1;
  const Arrays out = run(p);
  EXPECT_NEAR(out[0].value(face(out[0], 1, 0, 0)), 0.25, 1e-12);
  EXPECT_NEAR(out[0].value(face(out[0], 1, 1, 0)), -0.25, 1e-12);
  EXPECT_NEAR(out[1].value(face(out[1], 0, 1, 0)), -0.25, 1e-12);
  EXPECT_NEAR(out[1].value(face(out[1], 1, 1, 0)), 0.25, 1e-12);
}

// With fractions w the circulation g = sum u is kept, and w u is the same all around: u = g / w / sum(1/w).
TEST(StableFluidsBaseline, OpenFractionsWeighTheFlow) {
  Problem p = projection({2, 2, 1}, [](int axis, std::int64_t, std::int64_t j, std::int64_t) {
    return axis == 0 ? (j == 0 ? 0.5 : 1) : 1.0;
  });
  p.inputs[0].as<float>()[static_cast<std::size_t>(face(p.inputs[0], 1, 0, 0))] = 1;
  const Arrays out = run(p);
  EXPECT_NEAR(out[0].value(face(out[0], 1, 0, 0)), 1 / 0.5 / 5, 1e-12);
  EXPECT_NEAR(out[0].value(face(out[0], 1, 1, 0)), -1.0 / 5, 1e-12);
}

TEST(StableFluidsBaseline, AProjectedVelocityStays) {
  const Extents n{9, 8, 7};
  Problem p = projection(n, mac_fluid::random_faces(n, 3, 0.2));
  mac_fluid::set_noise(p, 4, 1);
  testing::feed_velocity(run(p), p);
  const Arrays again = run(p);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < again[c].size(); ++f)
      ASSERT_NEAR(again[c].value(f), p.inputs[c].value(f), 1e-6);
  }
}

// What is taken out is orthogonal to what is left, over the open fractions.
TEST(StableFluidsBaseline, WhatIsTakenOutIsOrthogonalToWhatIsLeft) {
  const Extents n{9, 8, 7};
  Problem p = projection(n, mac_fluid::random_faces(n, 5, 0.2));
  mac_fluid::set_noise(p, 6, 1);
  const Arrays out = run(p);
  double product = 0, size = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t f = 0; f < out[c].size(); ++f) {
      const double w = p.inputs[3 + c].value(f), u = p.inputs[c].value(f);
      product += w * (u - out[c].value(f)) * out[c].value(f);
      size += w * u * u;
    }
  }
  EXPECT_NEAR(product / size, 0, 1e-12);
}

// A vortex of half wave numbers (1,1) in a closed box that slips is steady but for viscosity: its energy
// falls by exp(-2 nu |k|^2 t) and by what advection loses.
TEST(StableFluidsBaseline, AVortexDecaysWithItsViscosity) {
  const double nu = 0.4, dt = 0.25;
  Problem p = testing::closed_vortex("stable_fluids", {{"dx", 1}, {"dt", dt}, {"nu", nu}, {"tol", 1e-6}});
  // Slow, so that advection does next to nothing.
  mac_fluid::scale_velocity(p, 1e-3);
  Arrays start;
  for (std::size_t c = 0; c < 3; ++c) start.push_back(p.inputs[c].clone());
  const double before = testing::kinetic_energy(p, start);
  double after = 0;
  for (int step = 0; step < 20; ++step) {
    const Arrays out = run(p);
    after = testing::kinetic_energy(p, out);
    testing::feed_velocity(out, p);
  }
  const double k = std::numbers::pi / 16;
  EXPECT_NEAR(std::log(before / after) / (2 * nu * 2 * k * k * dt * 20), 1, 0.03);
}

TEST(StableFluidsBaseline, TimeLoop) {
  testing::time_loop_stable_fluids("baseline_f64");
}

}  // namespace
}  // namespace gpuphys
