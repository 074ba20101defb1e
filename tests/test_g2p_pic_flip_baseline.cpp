// The serial baseline of g2p_pic_flip, validated on its own: by hand, by linear fields, at the walls, and
// against the transfer the other way.
#include <gtest/gtest.h>

#include "tests/mac_transfer.hpp"

namespace gpuphys {
namespace {

using testing::run_module;
using namespace testing::mac;

const Task& task() {
  return find_task("g2p_pic_flip");
}

using Field = std::function<double(std::size_t c, const Vec3& place_in_cells)>;

Problem blend(const Cells& cells, const std::vector<Particle>& particles, double flip, const Field& before,
              const Field& after, double dx = 1) {
  Problem p = make_problem(task().contract, {{"n", static_cast<std::int64_t>(particles.size())},
                                             {"nx", cells[0]},
                                             {"ny", cells[1]},
                                             {"nz", cells[2]}});
  p.set_scalar("dx", dx);
  p.set_scalar("flip", flip);
  for (std::size_t q = 0; q < particles.size(); ++q) {
    for (std::size_t d = 0; d < 3; ++d) {
      p.inputs[0].as<float>()[3 * q + d] = static_cast<float>(particles[q].x[d] * dx);
      p.inputs[1].as<float>()[3 * q + d] = static_cast<float>(particles[q].v[d]);
    }
  }
  for (std::size_t c = 0; c < 3; ++c) {
    each_face(p.inputs[2 + c], c, [&](std::int64_t i, const Vec3& at) {
      p.inputs[2 + c].as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(before(c, at));
      p.inputs[5 + c].as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(after(c, at));
    });
  }
  return p;
}

const Field kZero = [](std::size_t, const Vec3&) { return 0.0; };

double linear(std::size_t c, const Vec3& g) {
  return c == 0 ? 1 + g[0] - 2 * g[1] : c == 1 ? g[2] + 0.5 * g[0] : 3 * g[1] - g[2] - 4;
}

double noise(std::size_t c, const Vec3& g) {
  return uniform11(91, c, static_cast<std::uint64_t>(((2 * g[0]) * 64 + 2 * g[1]) * 64 + 2 * g[2]));
}

TEST(G2pPicFlipBaseline, OneFaceByHand) {
  // Only the face of uy at (1.5, 2, 1.5) moves, with 64. At (1.75, 2.5, 1.25) its weight is 3/4 x 1/2 x 3/4 =
  // 9/32, so P = 18.
  const Field one = [](std::size_t c, const Vec3& g) {
    return c == 1 && g == Vec3{1.5, 2, 1.5} ? 64.0 : 0.0;
  };
  const std::vector<Particle> particle{{{1.75, 2.5, 1.25}, {1, 2, 3}, {}}};
  // PIC alone, FLIP alone from rest of the field, and half of each.
  EXPECT_DOUBLE_EQ(run_module(task(), "baseline_f64", blend({4, 4, 4}, particle, 0, kZero, one))[0].value(1),
                   18);
  EXPECT_DOUBLE_EQ(run_module(task(), "baseline_f64", blend({4, 4, 4}, particle, 1, kZero, one))[0].value(1),
                   20);
  EXPECT_DOUBLE_EQ(run_module(task(), "baseline_f64", blend({4, 4, 4}, particle, 1, one, kZero))[0].value(1),
                   -16);
  const Arrays half = run_module(task(), "baseline_f64", blend({4, 4, 4}, particle, 0.5, one, one));
  EXPECT_DOUBLE_EQ(half[0].value(1), 0.5 * 18 + 0.5 * 2);
  EXPECT_DOUBLE_EQ(half[0].value(0), 0.5);  // no x component in the field
  EXPECT_DOUBLE_EQ(half[0].value(2), 1.5);
}

TEST(G2pPicFlipBaseline, LinearFieldsAreExactForAnySpacing) {
  const auto particles = inside({8, 7, 9}, 50, 92);
  for (const double dx : {0x1p-8, static_cast<double>(0.1f), 3.0}) {
    const Problem p = blend({8, 7, 9}, particles, 0, kZero, linear, dx);
    const Arrays out = run_module(task(), "baseline_f64", p);
    for (std::int64_t i = 0; i < out[0].size(); ++i) {
      const std::int64_t c = i % 3;
      const Vec3 g{p.inputs[0].value(i - c) / dx, p.inputs[0].value(i - c + 1) / dx,
                   p.inputs[0].value(i - c + 2) / dx};
      EXPECT_NEAR(out[0].value(i), linear(static_cast<std::size_t>(c), g), 1e-12);
    }
  }
}

TEST(G2pPicFlipBaseline, BlendsPicAndFlip) {
  // v' is linear in flip: at 1/4 three quarters of the value at 0 and a quarter of that at 1.
  const auto particles = inside({8, 7, 9}, 20, 93);
  const Field other = [](std::size_t c, const Vec3& g) { return noise(c, {g[2], g[0], g[1]}); };
  const auto at = [&](double flip) {
    return run_module(task(), "baseline_f64", blend({8, 7, 9}, particles, flip, noise, other));
  };
  const Arrays pic = at(0), flip = at(1), quarter = at(0.25);
  for (std::int64_t i = 0; i < pic[0].size(); ++i)
    EXPECT_NEAR(quarter[0].value(i), 0.75 * pic[0].value(i) + 0.25 * flip[0].value(i), 1e-13);
}

TEST(G2pPicFlipBaseline, OutsideTheFieldIsThatOfTheWall) {
  const Cells cells{4, 3, 5};
  const std::vector<Particle> particles{{{0, 1.25, 2.25}, {}, {}},     {{-7, 1.25, 2.25}, {}, {}},
                                        {{-1e30, 1.25, 2.25}, {}, {}}, {{4.5, 3.5, 5.5}, {}, {}},
                                        {{1e30, 1e30, 1e30}, {}, {}},  {{0.25, 1.25, 2.25}, {}, {}}};
  const Arrays out = run_module(task(), "baseline_f64", blend(cells, particles, 0, kZero, noise));
  for (std::int64_t c = 0; c < 3; ++c) {
    EXPECT_EQ(out[0].value(3 + c), out[0].value(c));  // ux sits on the wall, uy and uz half a cell inside
    EXPECT_EQ(out[0].value(6 + c), out[0].value(c));
    EXPECT_EQ(out[0].value(12 + c), out[0].value(9 + c));
  }
  // Last faces: ux (4, 2.5, 4.5), uy (3.5, 3, 4.5), uz (3.5, 2.5, 5).
  EXPECT_DOUBLE_EQ(out[0].value(9), static_cast<double>(static_cast<float>(noise(0, {4, 2.5, 4.5}))));
  EXPECT_DOUBLE_EQ(out[0].value(10), static_cast<double>(static_cast<float>(noise(1, {3.5, 3, 4.5}))));
  EXPECT_DOUBLE_EQ(out[0].value(11), static_cast<double>(static_cast<float>(noise(2, {3.5, 2.5, 5}))));
  EXPECT_NE(out[0].value(15), out[0].value(0));  // a quarter of a cell inside ux changes,
  EXPECT_EQ(out[0].value(16), out[0].value(1));  // uy does not yet
}

TEST(G2pPicFlipBaseline, IsTheTransposeOfP2gPicFlip) {
  // sum_faces m u w = sum_particles v P(w) for any face field w, u the velocities that p2g_pic_flip makes of
  // v.
  const Cells cells{7, 8, 6};
  const auto particles = inside(cells, 60, 94);
  const Task& there = find_task("p2g_pic_flip");
  const Problem p = problem(there, cells, particles);
  const Arrays u = run_module(there, "baseline_f64", p);
  const Problem back = blend(cells, particles, 0, kZero, noise);
  const Arrays gathered = run_module(task(), "baseline_f64", back);
  for (std::size_t c = 0; c < 3; ++c) {
    double on_faces = 0, on_particles = 0;
    each_face(u[c], c, [&](std::int64_t i, const Vec3& face) {
      on_faces += mass(p, face, hat) * u[c].value(i) * back.inputs[5 + c].value(i);
    });
    for (std::int64_t q = 0; q < back.inputs[0].shape()[0]; ++q)
      on_particles += back.inputs[1].value(3 * q + static_cast<std::int64_t>(c)) *
                      gathered[0].value(3 * q + static_cast<std::int64_t>(c));
    EXPECT_NEAR(on_faces, on_particles, 1e-11);
  }
}

}  // namespace
}  // namespace gpuphys
