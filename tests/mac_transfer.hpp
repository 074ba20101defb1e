// Small problems for the baselines of transfers from particles to MAC grids, and sums over faces by the
// definition of the kernels.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "cases/particle_grid/mac_particles.hpp"
#include "cases/particle_grid/mac_transfer_sets.hpp"
#include "core/generators/random.hpp"
#include "tests/run_module.hpp"

namespace gpuphys::testing::mac {

using Vec3 = std::array<double, 3>;
using Mat3 = std::array<Vec3, 3>;
using mac_particles::Cells;

struct Particle {
  Vec3 x, v;  ///< in cells; m/s
  Mat3 b{};   ///< APIC
};

/// dx as given; positions in cells.
inline Problem problem(const Task& task, const Cells& cells, const std::vector<Particle>& particles,
                       double dx = 1) {
  Problem p = make_problem(task.contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                           {"nx", cells[0]},
                                           {"ny", cells[1]},
                                           {"nz", cells[2]}});
  p.set_scalar("dx", dx);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(particles[q].x[d] * dx);
      p.inputs[1].as<float>()[3 * q + d] = static_cast<float>(particles[q].v[d]);
      for (std::size_t e = 0; e < 3 && p.inputs.size() > 2; ++e)
        p.inputs[2].as<float>()[9 * q + 3 * d + e] = static_cast<float>(particles[q].b[d][e]);
    }
  }
  return p;
}

inline double hat(double r) {
  return std::max(0.0, 1 - std::abs(r));
}
inline double quadratic(double r) {
  const double a = std::abs(r);
  return a < 0.5 ? 0.75 - a * a : a < 1.5 ? 0.5 * (1.5 - a) * (1.5 - a) : 0;
}

/// Calls body(flat index, place of the face in cells) for every face of component c.
inline void each_face(const HostArray& u, std::size_t c,
                      const std::function<void(std::int64_t, const Vec3&)>& body) {
  const Shape& n = u.shape();
  for (std::int64_t i = 0; i < u.size(); ++i) {
    Vec3 at{static_cast<double>(i / n[2] / n[1]), static_cast<double>(i / n[2] % n[1]),
            static_cast<double>(i % n[2])};
    for (std::size_t d = 0; d < 3; ++d) at[d] += d == c ? 0 : 0.5;
    body(i, at);
  }
}

/// The mass of a face: a sum over all particles of a problem.
inline double mass(const Problem& p, const Vec3& face, double (*kernel)(double)) {
  double m = 0;
  for (std::int64_t q = 0; q < p.inputs[0].shape()[0]; ++q) {
    double w = 1;
    for (std::int64_t d = 0; d < 3; ++d)
      w *= kernel(p.inputs[0].value(3 * q + d) / p.scalar("dx") - face[static_cast<std::size_t>(d)]);
    m += w;
  }
  return m;
}

/// Random particles in a box of cells, so far inside that nothing falls outside the array.
inline std::vector<Particle> inside(const Cells& cells, std::size_t n, std::uint64_t seed) {
  std::vector<Particle> all(n);
  for (std::size_t q = 0; q < n; ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      all[q].x[d] =
          static_cast<float>(2 + (static_cast<double>(cells[d]) - 4) * uniform01(seed, 0, 3 * q + d));
      all[q].v[d] = static_cast<float>(uniform11(seed, 1, 3 * q + d));
      for (std::size_t e = 0; e < 3; ++e)
        all[q].b[d][e] = static_cast<float>(uniform11(seed, 2, 9 * q + 3 * d + e));
    }
  }
  return all;
}

/// An interchange of x and y interchanges ux and uy.
inline void expect_axes_alike(const Task& task) {
  std::vector<Particle> a = inside({8, 8, 8}, 50, 81), b = a;
  for (Particle& p : a) {
    for (double& x : p.x) x = 1.6 * x - 3;  // over all walls
  }
  b = a;
  for (Particle& p : b) {
    std::swap(p.x[0], p.x[1]);
    std::swap(p.v[0], p.v[1]);
    std::swap(p.b[0], p.b[1]);
    for (Vec3& row : p.b) std::swap(row[0], row[1]);
  }
  const Arrays u = run_module(task, "baseline_f64", problem(task, {5, 6, 7}, a));
  const Arrays w = run_module(task, "baseline_f64", problem(task, {6, 5, 7}, b));
  for (std::size_t c = 0; c < 3; ++c) {
    const HostArray& other = w[c == 2 ? 2 : 1 - c];
    const Shape& n = u[c].shape();
    ASSERT_EQ(other.shape(), (Shape{n[1], n[0], n[2]}));
    for (std::int64_t i = 0; i < u[c].size(); ++i) {
      const std::int64_t x = i / n[2] / n[1], y = i / n[2] % n[1], z = i % n[2];
      ASSERT_NEAR(u[c].value(i), other.value((y * n[0] + x) * n[2] + z), 1e-11) << c << " " << i;
    }
  }
}

/// The input sets are those of the shared specification.
inline void expect_blocks_as_specified(const Task& task) {
  for (const auto& s : mac_particles::block_sets()) {
    EXPECT_LE(s.n, 8 * (s.high[0] - s.low[0]) * (s.high[1] - s.low[1]) * (s.high[2] - s.low[2]));
    EXPECT_NE(s.n % 1024, 0) << "the sparse mutant that loses the last partial block needs one";
    if (s.paper) continue;
    const Problem p = task.set(s.name).make();
    ASSERT_EQ(p.inputs[0].shape()[0], s.n);
    for (std::int64_t i = 0; i < p.inputs[0].size(); ++i) {
      const double cells = p.inputs[0].value(i) / mac_particles::kDx;
      const auto d = static_cast<std::size_t>(i % 3);
      ASSERT_GE(cells, static_cast<double>(s.low[d]));
      ASSERT_LE(cells, static_cast<double>(s.high[d]));
      ASSERT_GE(std::abs(cells - std::round(2 * cells) / 2), s.margin - 1e-5);
    }
  }
}

}  // namespace gpuphys::testing::mac
