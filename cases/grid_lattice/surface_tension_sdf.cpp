// Input sets and checks of surface_tension_sdf (specification: cases/grid_lattice/surface_tension_sdf.md).
#include "cases/grid_lattice/surface_tension_sdf.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>

#include "cases/grid_lattice/force_checks.hpp"
#include "cases/grid_lattice/lattice_inputs.hpp"
#include "core/base/parallel.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::surface_tension_sdf {
namespace {

using lattice::Grid;
using Point = std::array<double, 3>;

constexpr double kWater = 0.0728;  // N/m

struct Scalars {
  double sigma, dx;
};

/// phi(i, j, k) of every cell, rounded once.
Problem problem_of(Grid g, Scalars s, const std::function<double(double, double, double)>& phi) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(), {{"nx", g.nx}, {"ny", g.ny}, {"nz", g.nz}});
  p.set_scalar("sigma", s.sigma);
  p.set_scalar("dx", s.dx);
  const auto out = p.inputs[0].as<float>();
  parallel_for(g.nx * g.ny, [&](std::int64_t row) {
    for (std::int64_t k = 0; k < g.nz; ++k) {
      out[static_cast<std::size_t>(row * g.nz + k)] = static_cast<float>(
          phi(static_cast<double>(row / g.ny), static_cast<double>(row % g.ny), static_cast<double>(k)));
    }
  });
  return p;
}

/// An ellipsoid with half axes a, turned by `about_z`, then by `about_x` (radians), in metres.
struct Ellipsoid {
  Point centre, a;
  double about_z, about_x;

  /// |q/a| (|q/a| - 1) / |q/a^2|: a distance to first order near the surface; q has the ellipsoid's own axes.
  double distance(const Point& at) const {
    const double x = at[0] - centre[0], y = at[1] - centre[1], z = at[2] - centre[2];
    const double cx = std::cos(about_x), sx = std::sin(about_x), cz = std::cos(about_z),
                 sz = std::sin(about_z);
    const double level = cx * y + sx * z;  // the turn about x is undone first
    const Point q{cz * x + sz * level, -sz * x + cz * level, -sx * y + cx * z};
    double scaled = 0, twice = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      const double r = q[d] / a[d];
      scaled += r * r;
      twice += r * r / (a[d] * a[d]);
    }
    if (twice == 0) return -*std::min_element(a.begin(), a.end());
    return std::sqrt(scaled) * (std::sqrt(scaled) - 1) / std::sqrt(twice);
  }
};

constexpr Ellipsoid kPublic{{0.52, 0.47, 0.505}, {0.32, 0.25, 0.20}, 0.5, 0.3};
constexpr Ellipsoid kHidden{{0.475, 0.525, 0.49}, {0.37, 0.31, 0.25}, 0.9, -0.4};

InputSet ellipsoid_set(std::string name, SetKind kind, Size size, Grid g, double dx, const Ellipsoid& e) {
  InputSet s;
  s.name = std::move(name);
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "{}x{}x{} cells of {} m, ellipsoid of half axes {}, {}, {} m about ({}, {}, {}), turned "
      "by {} and {}",
      g.nx, g.ny, g.nz, dx, e.a[0], e.a[1], e.a[2], e.centre[0], e.centre[1], e.centre[2], e.about_z,
      e.about_x);
  s.make = [=] {
    return problem_of(g, {kWater, dx}, [&](double i, double j, double k) {
      return e.distance({(i + 0.5) * dx, (j + 0.5) * dx, (k + 0.5) * dx});
    });
  };
  return s;
}

// ---- checks ----

Check outside_band() {
  return count_where(
      {.name = "outside_band",
       .kind = CheckKind::local,
       .array = "fx, fy, fz",
       .quantity = "cells beyond 1.5 dx (1 + 1e-6) with a force",
       .tolerance = 0,
       .why =
           "the force is exactly zero there; the margin is what rounding 1.5 dx can shift the band's edge by",
       .needs_truth = false},
      [](const Judged& j) {
        const HostArray &phi = input(j, "phi"), &fx = output(j, "fx"), &fy = output(j, "fy"),
                        &fz = output(j, "fz");
        const double edge = 1.5 * j.problem.scalar("dx") * (1 + 1e-6);
        return Items{phi.size(),
                     [&phi, &fx, &fy, &fz, edge](std::int64_t c) {
                       return std::abs(phi.value(c)) > edge &&
                                      !(fx.value(c) == 0 && fy.value(c) == 0 && fz.value(c) == 0)
                                  ? 1.0
                                  : 0.0;
                     },
                     [&fx](std::int64_t c) { return index_text(fx, c); }};
      });
}

// Small sets: fifty times tighter than the paper's norm.
std::vector<Check> tight(double rarity = 1) {
  return {as_invariant(
              force::relative_l2(0, ""), "force_rel_l2_tight", 2e-6,
              "the interfaces of small sets are curved, so that second differences are not small against "
              "what they are the differences of: FP32 shows 2e-7"),
          as_invariant(force::local(0, ""), "force_local_tight", rarity * 2e-5,
                       "FP32 shows 5e-6 of the rms; more by how rare the cells of the band are")};
}

// phi = (i - a) + ((j - b)^2 + (k - c)^2)/16 in cells of 1 m: every difference is exact, so the law can be
// written out. Border cells, whose differences are one-sided, are left to the truth.
constexpr Grid kBowl{14, 12, 13};
constexpr Point kBowlAt{6, 5.5, 5};

double bowl(double i, double j, double k) {
  const double y = j - kBowlAt[1], z = k - kBowlAt[2];
  return i - kBowlAt[0] + (y * y + z * z) / 16;
}

Check bowl_closed_form() {
  return worst_over(
      {.name = "closed_form",
       .kind = CheckKind::invariant,
       .array = "fx, fy, fz",
       .quantity = "largest error of a component in inner cells, N/m^3",
       .tolerance = 3e-8,
       .why =
           "the law written out for a paraboloid, of which all differences are exact; forces reach 0.1 and "
           "rounding costs some units of 2^-24 of that",
       .needs_truth = false},
      [](const Judged& j) {
        const double sigma = j.problem.scalar("sigma");
        const std::array<const HostArray*, 3> f{&output(j, "fx"), &output(j, "fy"), &output(j, "fz")};
        return Items{
            3 * kBowl.nx * kBowl.ny * kBowl.nz,
            [=](std::int64_t item) {
              const std::int64_t cell = item / 3, i = cell / (kBowl.ny * kBowl.nz),
                                 jj = cell / kBowl.nz % kBowl.ny, k = cell % kBowl.nz;
              const auto inner = [](std::int64_t at, std::int64_t n) { return at > 0 && at + 1 < n; };
              const double got = f[static_cast<std::size_t>(item % 3)]->value(cell);
              if (!inner(i, kBowl.nx) || !inner(jj, kBowl.ny) || !inner(k, kBowl.nz))
                return std::isfinite(got) ? 0.0 : got;
              const double phi =
                  bowl(static_cast<double>(i), static_cast<double>(jj), static_cast<double>(k));
              if (!(std::abs(phi) < 1.5)) return got;
              const double gy = (static_cast<double>(jj) - kBowlAt[1]) / 8,
                           gz = (static_cast<double>(k) - kBowlAt[2]) / 8;
              // Hessian diag(0, 1/8, 1/8): the bracket is (2 + gy^2 + gz^2)/8.
              const double square = gy * gy + gz * gz, steep = 1 + square + 0x1p-40;
              const double curvature = std::min(1.0, (2 + square) / 8 / (steep * std::sqrt(steep)));
              const double delta = (1 + std::cos(std::numbers::pi * phi / 1.5)) / 3;
              const Point g{1, gy, gz};
              return got + sigma * curvature * delta * g[static_cast<std::size_t>(item % 3)];
            },
            [=](std::int64_t item) { return index_text(*f[static_cast<std::size_t>(item % 3)], item / 3); }};
      });
}

// ---- hard cases ----

double sphere(double i, double j, double k, const Point& centre, double radius) {
  return std::sqrt((i - centre[0]) * (i - centre[0]) + (j - centre[1]) * (j - centre[1]) +
                   (k - centre[2]) * (k - centre[2])) -
         radius;
}

// A smooth field of a few waves with |grad| near `slope`, in cells: crosses zero all over the box.
double waves(double i, double j, double k, double slope) {
  return slope * 2.2 *
         (std::sin(0.41 * i + 0.2 * j + 1) + std::sin(0.37 * j - 0.24 * k + 2) +
          std::sin(0.43 * k + 0.17 * i + 3));
}

double noise(const Grid& g, std::uint64_t seed, double i, double j, double k) {
  const auto cell =
      static_cast<std::int64_t>((i * static_cast<double>(g.ny) + j) * static_cast<double>(g.nz) + k);
  return uniform11(seed, 0, static_cast<std::uint64_t>(cell));
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, Grid g, Scalars s,
                       std::function<double(double, double, double)> phi_in_cells,
                       std::vector<Check> also = {}, double rarity = 1) {
    for (Check& c : tight(rarity)) also.push_back(std::move(c));
    sets.push_back(hard_case(
        stress, about,
        [=] {
          // dx as the float32 that modules are given.
          const double dx = static_cast<float>(s.dx);
          return problem_of(g, s, [&](double i, double j, double k) { return dx * phi_in_cells(i, j, k); });
        },
        std::move(also)));
  };
  const auto no_force = [](const std::string& why) {
    return std::vector<Check>{exactly_zero("fx", why), exactly_zero("fy", why), exactly_zero("fz", why)};
  };

  add("paraboloid", "a paraboloid whose differences are all exact", kBowl, {0.5, 1}, bowl,
      {bowl_closed_form()});
  for (const int axis : {0, 1, 2}) {
    add(
        fmt::format("plane_{}", "xyz"[axis]), "phi = (index - 5) dx along one axis: no curvature",
        {11, 13, 12}, {kWater, 0.25},
        [axis](double i, double j, double k) {
          return (axis == 0 ? i : axis == 1 ? j : k) - 5;
        },
        no_force("all second differences are exactly zero"));
  }
  add(
      "all_zero", "phi is 0 or -0 everywhere: the gradient is zero in the middle of the band", {9, 10, 20},
      {1, 3}, [](double i, double, double) { return std::fmod(i, 2) == 0 ? 0.0 : -0.0; },
      no_force("the gradient is zero"));
  add(
      "far", "every cell 2^20 dx away, on either side", {6, 7, 16}, {kWater, 0x1p-9},
      [](double i, double, double) { return i < 3 ? 0x1p20 : -0x1p20; }, no_force("no cell is in the band"));
  add("cliff", "gradients of 2^19 beside cells of the band", {12, 9, 17}, {kWater, 0x1p-9},
      [](double i, double j, double k) {
        return std::fmod(3 * i + 5 * j + 7 * k, 11) < 4 ? 0.3 * std::sin(i + 2 * j + 3 * k)
               : std::fmod(i + j, 2) < 1                ? 0x1p20
                                                        : -0x1p20;
      });
  add("walls", "an interface that crosses all walls, edges and corners of the box: one-sided differences",
      {23, 25, 27}, {kWater, 0x1p-9}, [](double i, double j, double k) { return waves(i, j, k, 0.5); });
  add("corner_sphere", "a sphere about the first corner of the box, with the last cells of each axis inside",
      {18, 16, 17}, {-0.5, 0.1}, [](double i, double j, double k) {
        return sphere(i, j, k, {0, 0, 0}, 15.25);
      });
  add("far_corner_sphere", "the same about the last corner", {16, 18, 17}, {1, 3},
      [](double i, double j, double k) {
        return sphere(i, j, k, {15, 17, 16}, 14.75);
      });
  add("touching_spheres", "two spheres of radius 7 dx that touch: a kink where kappa is clamped",
      {31, 17, 18}, {kWater, 0.1}, [](double i, double j, double k) {
        return std::min(sphere(i, j, k, {8, 8.25, 8.5}, 7), sphere(i, j, k, {22, 8.25, 8.5}, 7));
      });
  add("small_sphere", "a sphere of radius dx: kappa at its limit", {9, 10, 11}, {kWater, 0x1p-9},
      [](double i, double j, double k) {
        return sphere(i, j, k, {4.25, 4.5, 5.1}, 1);
      });
  add("box", "the distance to a box: edges and corners, and equidistant faces inside", {17, 18, 19},
      {kWater, 3}, [](double i, double j, double k) {
        return std::max({std::abs(i - 8) - 4.4, std::abs(j - 8) - 5.3, std::abs(k - 9) - 6.2});
      });
  add("film", "a film 1.4 dx thick: two interfaces in one stencil, oblique", {19, 21, 22}, {kWater, 0x1p-9},
      [](double i, double j, double k) {
        return std::abs(0.6 * i + 0.64 * j + 0.48 * k - 17 + 0.8 * std::sin(0.5 * i - 0.4 * k)) - 0.7;
      });
  add("saddle", "a saddle: the gradient vanishes in the band", {17, 18, 16}, {kWater, 0x1p-9},
      [](double i, double j, double k) {
        return ((i - 8) * (i - 8) - (j - 8.5) * (j - 8.5)) / 16 + 0.03 * (k - 7);
      });
  add("flat", "all of the box in the band, with gradients near 1e-6, of the size of the regulariser",
      {15, 16, 21}, {1, 1}, [](double i, double j, double k) { return waves(i, j, k, 1e-6); });
  add(
      "steep", "gradients near 1000: few cells in the band", {26, 27, 28}, {kWater, 0x1p-9},
      [](double i, double j, double k) { return waves(i, j, k, 1000); }, {}, 10);
  add("cells_of_nanometres", "dx = 2^-30 m, sigma 2^20 N/m", {14, 15, 16}, {0x1p20, 0x1p-30},
      [](double i, double j, double k) {
        return sphere(i, j, k, {6.5, 7.1, 7.7}, 5);
      });
  add("cells_of_gigametres", "dx = 2^30 m, sigma -2^20 N/m", {14, 15, 16}, {-0x1p20, 0x1p30},
      [](double i, double j, double k) {
        return sphere(i, j, k, {6.5, 7.1, 7.7}, 5);
      });
  // A rough field shows every wrong index; extents at and below the reach of a difference, rows of every
  // remainder, more than 65,535 cells along each axis.
  for (const Grid g : {Grid{1, 1, 1}, Grid{2, 2, 2}, Grid{1, 5, 33}, Grid{7, 1, 9}, Grid{2, 3, 1201},
                       Grid{3, 5, 16}, Grid{5, 3, 20}, Grid{4, 3, 48}, Grid{3, 4, 45}, Grid{70000, 1, 2},
                       Grid{1, 70000, 2}, Grid{2, 1, 70000}}) {
    add(fmt::format("grid_{}x{}x{}", g.nx, g.ny, g.nz), "rough noise in 2 dx about the interface", g,
        {0.3, 0.1}, [g](double i, double j, double k) { return 2 * noise(g, 7, i, j, k); });
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Surface-tension force of a level set";
  t.paper_number = 27;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      ellipsoid_set("public", SetKind::open, Size::paper, {512, 512, 512}, 0x1p-9, kPublic),
      ellipsoid_set("hidden", SetKind::hidden, Size::paper, {512, 512, 512}, 0x1p-9, kHidden),
      ellipsoid_set("public_smoke", SetKind::open, Size::smoke, {116, 125, 131}, 0x1p-7, kPublic),
      ellipsoid_set("hidden_smoke", SetKind::hidden, Size::smoke, {131, 122, 119}, 0x1p-7, kHidden),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      force::relative_l2(1e-4, "the paper's table of inputs and checks"),
      force::local(2e-3,
                   "rounding of second differences shows 2.4e-4 of the rms at paper size; a cell left out is "
                   "ten rms or more"),
      outside_band(),
  };
  t.target_floor_multiple = 1.08;
  return t;
}

}  // namespace gpuphys::surface_tension_sdf
