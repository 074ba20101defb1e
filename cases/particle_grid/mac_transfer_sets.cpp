#include "cases/particle_grid/mac_transfer_sets.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/generators/random.hpp"

namespace gpuphys::mac_particles {

const std::array<std::string, 3> kNames{"ux", "uy", "uz"};

namespace {

std::function<Vec3(std::uint64_t)> random_velocity(std::uint64_t seed, double scale = 1) {
  return [=](std::uint64_t q) {
    Vec3 v = random_vector(seed, 4, q);
    for (double& c : v) c *= scale;
    return v;
  };
}

/// Places in a box of cells, off whole and half cells by an odd multiple of step / 2.
std::function<Vec3(std::uint64_t)> in_box(std::uint64_t seed, const Vec3& low, const Vec3& high,
                                          double step) {
  return [=](std::uint64_t q) { return off_planes(seed, q, low, high, step); };
}

Vec3 drift(std::uint64_t) {
  return kDrift;
}

/// Places in a row of 70,000 cells along `axis`: in 64 groups of a dozen cells from one end to the other.
std::function<Vec3(std::uint64_t)> in_row(std::uint64_t seed, std::size_t axis, Vec3 high) {
  return [=](std::uint64_t q) {
    Vec3 from{-1, -1, -1}, to = high;
    from[axis] = -1 + 69990.0 * static_cast<double>(q % 64) / 63;
    to[axis] = from[axis] + 12;
    return off_planes(seed, q, from, to, 0x1p-5);
  };
}

}  // namespace

const std::vector<Placement>& placements() {
  static const std::vector<Placement> all{
      {.stress = "one_cell_1e5",
       .about = "100,003 particles in one cell: sums of 1e5 terms, one list",
       .cells = {9, 10, 11},
       .n = 100003,
       .at = in_box(41, {3, 4, 5}, {4, 5, 6}, 0x1p-12),
       .v = random_velocity(41),
       .use_task_checks = false},
      {.stress = "one_tile",
       .about = "131,101 particles in a corner of 4 x 4 x 4 cells at the array's upper end",
       .cells = {8, 12, 12},
       .n = 131101,
       .at = in_box(42, {4, 8, 8}, {8, 12, 12}, 0x1p-12),
       .v = random_velocity(42),
       .use_task_checks = false},
      {.stress = "every_cell",
       .about = "about three particles a cell in the whole box: every border cell, nothing outside",
       .cells = {21, 18, 23},
       .n = 26083,
       .at = in_box(43, {0, 0, 0}, {21, 18, 23}, 0x1p-10),
       .v = random_velocity(43)},
      {.stress = "planes",
       .about = "every particle on whole or half multiples of dx: weights that are exactly 0, ties of floor",
       .cells = {19, 13, 16},
       .n = 1025,
       .at =
           [](std::uint64_t q) {
             Vec3 x = off_planes(44, q, {-1, -1, -1}, {20, 14, 17}, 0.5);
             for (double& c : x) c = std::floor(2 * c) / 2;
             return x;
           },
       .v = random_velocity(44)},
      {.stress = "walls",
       .about = "particles up to three cells outside on every side, some at 1e6 and at 1e30 cells",
       .cells = {17, 9, 13},
       .n = 20011,
       .at =
           [](std::uint64_t q) {
             Vec3 x = off_planes(45, q, {-3, -3, -3}, {20, 12, 16}, 0.25);
             constexpr std::array<double, 4> far{-1e30, 1e30, 1e6, -1e6};
             if (q % 16 == 0) x[q / 16 % 3] = far[q / 48 % 4];
             return x;
           },
       .v = random_velocity(45)},
      {.stress = "all_outside",
       .about = "every particle beyond the reach of the array, by 1.75 cells to 1e30",
       .cells = {8, 6, 7},
       .n = 257,
       .at =
           [](std::uint64_t q) {
             constexpr std::array<double, 6> far{-1.75, 1e6, -3e6, 1e30, -1e30, 9.75};
             Vec3 x{3.25, 2.25, 3.75};
             x[q % 3] = far[q / 3 % 6];
             return x;
           },
       .v = random_velocity(46)},
      {.stress = "near_planes",
       .about =
           "sparse particles 2^-20 of a cell above or below whole and half multiples of dx: faces that own "
           "nothing but such weights",
       .cells = {26, 29, 31},
       .n = 601,
       .at =
           [](std::uint64_t q) {
             Vec3 x = off_planes(47, q, {-1, -1, -1}, {27, 30, 32}, 0.5);
             // One axis, or all three at 2^-12: the product of the weights stays above 2^-100. Beyond one
             // cell float32 has no 2^-20 of a cell: there as near as it has.
             for (std::size_t d = 0; d < 3; ++d) {
               if (q % 4 != 3 && q % 4 != d) continue;
               const double plane = std::floor(2 * x[d]) / 2, side = (q / 4 >> d) % 2 == 0 ? 1 : -1;
               const double least = q % 4 == 3 ? 0x1p-12 : 0x1p-20;
               x[d] =
                   plane + side * std::max(least, std::exp2(std::floor(std::log2(std::abs(plane) + 1)) - 20));
             }
             return x;
           },
       .v = random_velocity(47)},
      {.stress = "one_particle",
       .about = "a single particle in a box of one cell along y: every face it reaches moves with it",
       .cells = {5, 1, 3},
       .n = 1,
       .at =
           [](std::uint64_t) {
             return Vec3{2.25, 0.125, 0.875};
           },
       .v = drift},
      {.stress = "one_cell_box",
       .about = "a box of one cell, 31 particles in and around it",
       .cells = {1, 1, 1},
       .n = 31,
       .at = in_box(49, {-1, -1, -1}, {2, 2, 2}, 0x1p-8),
       .v = random_velocity(49)},
      {.stress = "drift",
       .about = "dx = 0.1, no power of two, cells up to number 211: all particles move alike, and so must "
                "every face",
       .cells = {211, 5, 6},
       .dx = static_cast<double>(0.1f),
       .n = 7001,
       .at = in_box(50, {-1, -1, -1}, {212, 6, 7}, 0x1p-7),
       .v = drift},
      {.stress = "dx_tenth",
       .about = "dx = 0.1, cells up to number 333: fractions of x/dx to more digits than the quotient has",
       .cells = {7, 333, 6},
       .dx = static_cast<double>(0.1f),
       .n = 30011,
       .at = in_box(51, {-1, -1, -1}, {8, 334, 7}, 0x1p-7),
       .v = random_velocity(51)},
      {.stress = "dx_320th",
       .about = "dx = 1/320, cells up to number 301",
       .cells = {6, 7, 301},
       .dx = static_cast<double>(1.0f / 320),
       .n = 30013,
       .at = in_box(52, {-1, -1, -1}, {7, 8, 302}, 0x1p-7),
       .v = random_velocity(52)},
      {.stress = "dx_three",
       .about = "dx = 3",
       .cells = {20, 16, 48},
       .dx = 3,
       .n = 40009,
       .at = in_box(53, {0, 0, 0}, {20, 16, 48}, 0x1p-7),
       .v = random_velocity(53, 1e-3)},
      {.stress = "smallest",
       .about = "dx = 2^-30 m, velocities up to 1e30 m/s, some of them 0 and -0",
       .cells = {13, 16, 10},
       .dx = 0x1p-30,
       .n = 5003,
       .at = in_box(54, {-1, -1, -1}, {14, 17, 11}, 0x1p-10),
       .v =
           [](std::uint64_t q) {
             Vec3 v = random_vector(54, 4, q);
             for (double& c : v) c *= q % 5 == 0 ? 0.0 : 1e30;
             return v;
           }},
      {.stress = "largest",
       .about = "dx = 2^30 m, velocities of 1e-20 m/s",
       .cells = {10, 13, 17},
       .dx = 0x1p30,
       .n = 5009,
       .at = in_box(55, {-1, -1, -1}, {11, 14, 18}, 0x1p-10),
       .v = random_velocity(55, 1e-20)},
      {.stress = "long_x",
       .about = "70,000 x 1 x 2 cells",
       .cells = {70000, 1, 2},
       .n = 2021,
       .at = in_row(56, 0, {0, 2, 3}),
       .v = random_velocity(56)},
      {.stress = "long_y",
       .about = "1 x 70,000 x 2 cells",
       .cells = {1, 70000, 2},
       .n = 2023,
       .at = in_row(57, 1, {2, 0, 3}),
       .v = random_velocity(57)},
      {.stress = "long_z",
       .about = "2 x 1 x 70,000 cells",
       .cells = {2, 1, 70000},
       .n = 2029,
       .at = in_row(58, 2, {3, 2, 0}),
       .v = random_velocity(58)},
  };
  return all;
}

Problem placed_problem(const Contract& contract, const Placement& s) {
  Problem p =
      make_problem(contract, {{"n", s.n}, {"nx", s.cells[0]}, {"ny", s.cells[1]}, {"nz", s.cells[2]}});
  p.set_scalar("dx", s.dx);
  const auto x = p.inputs[0].as<float>(), v = p.inputs[1].as<float>();
  for (std::int64_t q = 0; q < s.n; ++q) {
    const Vec3 at = s.at(static_cast<std::uint64_t>(q)), velocity = s.v(static_cast<std::uint64_t>(q));
    for (std::size_t d = 0; d < 3; ++d) {
      x[3 * static_cast<std::size_t>(q) + d] = static_cast<float>(at[d] * s.dx);
      v[3 * static_cast<std::size_t>(q) + d] = static_cast<float>(velocity[d]);
    }
  }
  return p;
}

Check same_support(int component) {
  const std::string name = kNames[static_cast<std::size_t>(component)];
  return count_where(
      {.name = name + "_support",
       .kind = CheckKind::invariant,
       .array = name,
       .quantity = "faces that are exactly 0 in one of truth and result only",
       .tolerance = 0,
       .why = "whether a particle reaches a face follows from exact positions or from positions well "
              "away from where weights vanish"},
      [name](const Judged& j) {
        const HostArray &u = output(j, name), &t = truth(j, name);
        return Items{u.size(), [&](std::int64_t i) { return (u.value(i) == 0) == (t.value(i) == 0) ? 0 : 1; },
                     [&](std::int64_t i) { return index_text(u, i); }};
      });
}

Check moves_with(int component, double velocity, double tolerance, const std::string& why) {
  const std::string name = kNames[static_cast<std::size_t>(component)];
  return worst_over({.name = name + "_uniform",
                     .kind = CheckKind::invariant,
                     .array = name,
                     .quantity = "largest |u - v| / |v| over faces that are not exactly 0",
                     .tolerance = tolerance,
                     .why = why,
                     .needs_truth = false},
                    [name, velocity](const Judged& j) {
                      const HostArray& u = output(j, name);
                      return Items{u.size(),
                                   [&, velocity](std::int64_t i) {
                                     return u.value(i) == 0 ? 0.0 : (u.value(i) - velocity) / velocity;
                                   },
                                   [&](std::int64_t i) { return index_text(u, i); }};
                    });
}

Check error_over_largest(int component, double tolerance, const std::string& why) {
  const std::string name = kNames[static_cast<std::size_t>(component)];
  return worst_over(
      {.name = name + "_error_over_largest",
       .kind = CheckKind::invariant,
       .array = name,
       .quantity = "largest error / largest |u| of the truth",
       .tolerance = tolerance,
       .why = why},
      [name](const Judged& j) {
        const HostArray &u = output(j, name), &t = truth(j, name);
        double largest = 0;
        for (std::int64_t i = 0; i < t.size(); ++i) largest = std::max(largest, std::abs(t.value(i)));
        return Items{u.size(), [&, largest](std::int64_t i) { return (u.value(i) - t.value(i)) / largest; },
                     [&](std::int64_t i) { return index_text(u, i); }};
      });
}

}  // namespace gpuphys::mac_particles
