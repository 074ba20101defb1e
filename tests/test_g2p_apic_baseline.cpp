// The serial baseline of g2p_apic, validated on its own: by hand, by linear fields, at the walls, and against
// the transfer the other way.
#include <gtest/gtest.h>

#include "tests/mac_transfer.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using namespace testing::mac;

const Task& task() {
  return find_task("g2p_apic");
}

using Field = std::function<double(std::size_t c, const Vec3& place_in_cells)>;

Problem gather(const Cells& cells, const std::vector<Particle>& particles, const Field& field,
               double dx = 1) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                             {"nx", cells[0]},
                                             {"ny", cells[1]},
                                             {"nz", cells[2]}});
  p.set_scalar("dx", dx);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d)
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(particles[q].x[d] * dx);
  }
  for (std::size_t c = 0; c < 3; ++c) {
    each_face(p.inputs[1 + c], c, [&](std::int64_t i, const Vec3& at) {
      p.inputs[1 + c].as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(field(c, at));
    });
  }
  return p;
}

double noise(std::size_t c, const Vec3& g) {
  return uniform11(95, c, static_cast<std::uint64_t>(((2 * g[0]) * 64 + 2 * g[1]) * 64 + 2 * g[2]));
}

TEST(G2pApicBaseline, OneFaceByHand) {
  // Only the face of uz at (2.5, 1.5, 3) moves, with 128. A particle one cell below it along y, (2.5, 0.5,
  // 3), gives it the weight 3/4 x 1/8 x 3/4 = 9/128: v_z = 9, and B_zy = 9 x 1 (face minus particle, dx = 1),
  // B_zx = B_zz = 0.
  const Problem p = gather({5, 4, 6}, {{{2.5, 0.5, 3}, {}, {}}}, [](std::size_t c, const Vec3& g) {
    return c == 2 && g == Vec3{2.5, 1.5, 3} ? 128.0 : 0.0;
  });
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t c = 0; c < 3; ++c) EXPECT_DOUBLE_EQ(out[0].value(c), c == 2 ? 9 : 0);
  for (std::int64_t e = 0; e < 9; ++e) EXPECT_DOUBLE_EQ(out[1].value(e), e == 7 ? 9 : 0) << e;
}

TEST(G2pApicBaseline, LinearFieldsAreExactForAnySpacing) {
  const Mat3 rate{{{1, -2, 0.5}, {0.25, 3, -1}, {-0.5, 2, 0.75}}};
  const Field linear = [&](std::size_t c, const Vec3& g) {
    return 2 - static_cast<double>(c) + rate[c][0] * g[0] + rate[c][1] * g[1] + rate[c][2] * g[2];
  };
  const auto particles = inside({8, 7, 9}, 50, 96);
  for (const double dx : {0x1p-8, static_cast<double>(0.1f), 3.0}) {
    const Problem p = gather({8, 7, 9}, particles, linear, dx);
    const Arrays out = run_module(task(), "baseline_f64", p);
    for (std::int64_t i = 0; i < out[0].size(); ++i) {
      const std::int64_t c = i % 3;
      const Vec3 g{p.inputs[0].value(i - c) / dx, p.inputs[0].value(i - c + 1) / dx,
                   p.inputs[0].value(i - c + 2) / dx};
      EXPECT_NEAR(out[0].value(i), linear(static_cast<std::size_t>(c), g), 1e-12);
      // B = dx^2/4 A, and A is `rate` per cell: rate / dx per metre.
      for (std::int64_t b = 0; b < 3; ++b)
        EXPECT_NEAR(out[1].value(3 * i + b),
                    dx / 4 * rate[static_cast<std::size_t>(c)][static_cast<std::size_t>(b)], 1e-12);
    }
  }
}

TEST(G2pApicBaseline, AConstantFieldHasNoAffineState) {
  const Problem p = gather(
      {5, 6, 4}, inside({5, 6, 4}, 20, 97), [](std::size_t c, const Vec3&) { return c == 0 ? 1000.1 : -0.3; },
      0x1p-8);
  const Arrays out = run_module(task(), "baseline_f32", p);
  for (std::int64_t e = 0; e < out[1].size(); ++e) EXPECT_EQ(out[1].value(e), 0);
}

TEST(G2pApicBaseline, OutsideTheFieldIsThatOfTheWall) {
  const std::vector<Particle> particles{{{-1.5, 1.25, 2.25}, {}, {}},
                                        {{-1e30, 1.25, 2.25}, {}, {}},
                                        {{1e30, 1e30, 1e30}, {}, {}},
                                        {{-0.25, 1.5, 2.5}, {}, {}}};
  const Problem p = gather({4, 3, 5}, particles, noise);
  const Arrays out = run_module(task(), "baseline_f64", p);
  for (std::int64_t c = 0; c < 3; ++c) {
    EXPECT_DOUBLE_EQ(out[0].value(c), out[0].value(3 + c));
    EXPECT_NEAR(out[1].value(3 * c), 0, 1e-15);  // no change along x
  }
  EXPECT_DOUBLE_EQ(out[0].value(6), static_cast<double>(static_cast<float>(noise(0, {4, 2.5, 4.5}))));
  // At x = -1/4 the faces of ux at -1, 0, 1 have weights 9/32, 22/32, 1/32 and distances -3/4, 1/4, 5/4;
  // those at -1 have the values of those at 0. Along y and z the particle is on a face: 1/8, 3/4, 1/8.
  double v = 0, moment = 0;
  for (int j = -1; j <= 1; ++j) {
    for (int k = -1; k <= 1; ++k) {
      const double w = (j == 0 ? 0.75 : 0.125) * (k == 0 ? 0.75 : 0.125);
      const auto face = [&](double i) {
        return static_cast<double>(static_cast<float>(noise(0, {i, 1.5 + j, 2.5 + k})));
      };
      v += w * (31.0 / 32 * face(0) + 1.0 / 32 * face(1));
      moment += w * (face(0) * (9.0 / 32 * -0.75 + 22.0 / 32 * 0.25) + face(1) * 1.0 / 32 * 1.25);
    }
  }
  EXPECT_NEAR(out[0].value(9), v, 1e-14);
  EXPECT_NEAR(out[1].value(27), moment, 1e-14);
}

TEST(G2pApicBaseline, IsTheTransposeOfP2gApic) {
  // sum_faces m u w = sum_particles (v . v(w) + 4/dx^2 B : B(w)) for any face field w: u the velocities that
  // p2g_apic makes of v and B, v(w) and B(w) what g2p_apic makes of w.
  const Cells cells{7, 8, 6};
  const double dx = 0.5;
  const auto particles = inside(cells, 60, 98);
  const Task& there = find_task("p2g_apic");
  const Problem p = problem(there, cells, particles, dx);
  const Arrays u = run_module(there, "baseline_f64", p);
  const Problem back = gather(cells, particles, noise, dx);
  const Arrays gathered = run_module(task(), "baseline_f64", back);
  for (std::size_t c = 0; c < 3; ++c) {
    double on_faces = 0, on_particles = 0;
    each_face(u[c], c, [&](std::int64_t i, const Vec3& face) {
      on_faces += mass(p, face, quadratic) * u[c].value(i) * back.inputs[1 + c].value(i);
    });
    for (std::int64_t q = 0; q < p.inputs[0].shape()[0]; ++q) {
      const std::int64_t at = 3 * q + static_cast<std::int64_t>(c);
      on_particles += p.inputs[1].value(at) * gathered[0].value(at);
      for (std::int64_t b = 0; b < 3; ++b)
        on_particles += 4 / dx / dx * p.inputs[2].value(3 * at + b) * gathered[1].value(3 * at + b);
    }
    EXPECT_NEAR(on_faces, on_particles, 1e-10);
  }
}

TEST(G2pApicBaseline, AnAffineFieldSurvivesTheRoundTrip) {
  // Particles fill the box two a cell and axis; p2g_apic of an affine field gives that field on all faces
  // well inside, and g2p_apic gives the particles there their v and B back.
  const Cells cells{8, 8, 8};
  const Mat3 rate{{{0.5, -1, 0.25}, {1, 0.125, -0.5}, {0.25, 2, -0.75}}};
  std::vector<Particle> particles;
  for (int i = 0; i < 16; ++i) {
    for (int j = 0; j < 16; ++j) {
      for (int k = 0; k < 16; ++k) {
        Particle q{{0.25 + 0.5 * i, 0.25 + 0.5 * j, 0.25 + 0.5 * k}, {1, -2, 0.5}, {}};
        for (std::size_t a = 0; a < 3; ++a) {
          for (std::size_t b = 0; b < 3; ++b) {
            q.v[a] += rate[a][b] * q.x[b];
            q.b[a][b] = rate[a][b] / 4;
          }
        }
        particles.push_back(q);
      }
    }
  }
  const Task& there = find_task("p2g_apic");
  const Arrays u = run_module(there, "baseline_f64", problem(there, cells, particles));
  Problem back = gather(cells, particles, noise);
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::int64_t i = 0; i < u[c].size(); ++i)
      back.inputs[1 + c].as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(u[c].value(i));
  }
  const Arrays out = run_module(task(), "baseline_f64", back);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t a = 0; a < 3; ++a) {
      if (particles[q].x[0] < 2 || particles[q].x[0] > 6 || particles[q].x[1] < 2 || particles[q].x[1] > 6 ||
          particles[q].x[2] < 2 || particles[q].x[2] > 6)
        continue;
      EXPECT_NEAR(out[0].value(static_cast<std::int64_t>(3 * q + a)), particles[q].v[a], 1e-5);
      for (std::size_t b = 0; b < 3; ++b)
        EXPECT_NEAR(out[1].value(static_cast<std::int64_t>(9 * q + 3 * a + b)), particles[q].b[a][b], 1e-5);
    }
  }
}

}  // namespace
}  // namespace gpuphys
