// Input sets and checks of mc_r (specification: cases/global_solve/mc_r.md).
#include "cases/global_solve/mc_r.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "cases/global_solve/mac_fluid_inputs.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::mc_r {
namespace {

using mac_fluid::Extents;
using mac_fluid::Open;

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

struct Law {
  double dx, dt, tol;
};
constexpr Law kLaw{0x1p-8, 0x1p-6, 1e-4};  // two cells per half step at 1 m/s

InputSet paper_set(const std::string& name, SetKind kind, Size size, Extents n, double radius,
                   mac_fluid::Modes modes) {
  return mac_fluid::cylinder_set(name, kind, size, contract(), n, radius, modes,
                                 {{"dx", kLaw.dx}, {"dt", kLaw.dt}, {"tol", kLaw.tol}});
}

std::vector<Check> tight(double tolerance) {
  std::vector<Check> all;
  for (const std::string u : {"ux", "uy", "uz"}) {
    all.push_back(
        as_invariant(relative_l2_of_change(u, u, 0, ""), u + "_change_tight", tolerance,
                     "the error of a solve is about its residual, a tenth of the paper's set's and less"));
  }
  return all;
}

// A face whose departure point is within rounding of a plane of samples may be limited by those beyond it,
// and differs by its correction then. Few are; what is wrong anywhere shows at many faces.
Check faces_off(const std::string& array) {
  constexpr double bound = 1e-2;
  return {
      array + "_local",
      CheckKind::local,
      array,
      "share of faces that differ by more than 1e-2 rms",
      2e-4,
      "stops at tol move departure points by 2e-4 cells, so that about one face in a thousand has a plane of "
      "samples that near, and few of those are limited by as much as this",
      true,
      [array](const Judged& j) {
        const HostArray& got = output(j, array);
        Measured m = count_above(got, truth(j, array), bound);
        m.error /= static_cast<double>(got.size());
        return m;
      }};
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, Extents n, Open open, Law law,
                       std::uint64_t seed, double size, std::vector<Check> also = {}, bool smooth = false,
                       bool compared = true) {
    sets.push_back(hard_case(
        stress, about,
        [=] {
          Problem p = mac_fluid::make_fluid(contract(), n, open);
          p.set_scalar("dx", law.dx);
          p.set_scalar("dt", law.dt);
          p.set_scalar("tol", law.tol);
          if (smooth) {
            mac_fluid::set_taylor_green(p, {seed, 10, 3});
            mac_fluid::scale_velocity(p, size);
          } else {
            mac_fluid::set_noise(p, seed, size);
          }
          return p;
        },
        std::move(also), compared));
  };
  const Extents odd{37, 34, 29}, small{15, 18, 21};
  const auto zero = [](const std::string& why) {
    return std::vector<Check>{exactly_zero("ux", why), exactly_zero("uy", why), exactly_zero("uz", why)};
  };
  add("ball", "a ball off the centre, solves to 1e-5", odd, mac_fluid::ball({14.3, 19.2, 15.7}, 8.6),
      {0x1p-8, 0x1p-7, 1e-5}, 3, 1, tight(1e-4), true);
  add("no_time", "dt = 0: two projections of the start", small, mac_fluid::ball({9.3, 8.2, 10.7}, 4.3),
      {0.1, 0, 1e-5}, 4, 1, tight(1e-4));
  // Chaotic: correct codes differ.
  add("cfl_30", "30 cells per half step", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), {0.1, 6, 1e-5}, 6, 1,
      {mac_fluid::divergence_check("divergence_small", CheckKind::invariant, 3e-5,
                                   "what the tolerance gives"),
       mac_fluid::closed_faces_check()},
      false, false);
  add("maze", "a fifth of the faces closed at random, the others open by any amount", {17, 16, 19},
      mac_fluid::random_faces({17, 16, 19}, 8, 0.2), {0.1, 0.004, 1e-5}, 8, 1, tight(1e-4));
  add(
      "two_rooms", "a wall without an opening, and a pocket of two cells in it", {19, 13, 12},
      [](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        // Cells 8 and 9 along x are solid but for (8..9, 6, 5), which see only each other.
        if (axis == 0) return i == 9 ? (j == 6 && k == 5 ? 0.5 : 0.0) : i == 8 || i == 10 ? 0.0 : 1.0;
        return i == 8 || i == 9 ? 0.0 : 1.0;
      },
      {0.1, 0.004, 1e-5}, 9, 1, tight(1e-4));
  // What flows through a sliver matters to nobody, and no solver has to find it.
  sets.push_back(hard_case(
      "slivers", "a third of the faces open by 2^-20",
      [=] {
        Problem p = mac_fluid::make_fluid(
            contract(), small, [](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
              return (i + 2 * j + 3 * k + axis) % 3 == 0 ? mac_fluid::kLeastOpen : 1.0;
            });
        p.set_scalar("dx", 0.1);
        p.set_scalar("dt", 0.1);
        p.set_scalar("tol", 1e-4);
        mac_fluid::set_noise(p, 10, 1);
        return p;
      },
      {mac_fluid::divergence_check("divergence_small", CheckKind::invariant, 3e-4,
                                   "what the tolerance gives"),
       mac_fluid::closed_faces_check()},
      false));
  add("fast", "velocities of 1e15 m/s", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), {1, 1e-15, 1e-5}, 11,
      1e15, tight(1e-4), true);
  add("slow", "velocities of 1e-15 m/s", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), {1, 1e15, 1e-5}, 12,
      1e-15, tight(1e-4), true);
  add("at_rest", "u = 0", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), kLaw, 13, 0, zero("nothing moves"));
  add(
      "all_closed", "no open face", {5, 6, 7}, [](auto...) { return 0.0; }, kLaw, 14, 1,
      zero("no face is open"));
  add("one_face", "two cells and one open face: whatever flows is projected away", {2, 1, 1},
      mac_fluid::all_open(), {0.5, 0, 1e-6}, 15, 1,
      {within("ux", -2e-6, 2e-6, "no flow without divergence can pass the face")});
  for (const Extents n :
       {Extents{1, 1, 1}, Extents{1, 5, 33}, Extents{7, 1, 9}, Extents{4, 3, 48}, Extents{5, 3, 20},
        Extents{48, 16, 20}, Extents{3, 7, 16}, Extents{130, 1, 2}, Extents{1, 130, 2}, Extents{2, 1, 131}}) {
    add(fmt::format("grid_{}x{}x{}", n[0], n[1], n[2]),
        "thin, odd and long boxes; a twentieth of the faces closed", n, mac_fluid::random_faces(n, 16, 0.05),
        {0.1, 0.004, 1e-5}, 16, 1);
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Advection-reflection step on a MAC grid: two MacCormack half steps, two projections";
  t.paper_number = 9;
  t.contract = contract();
  t.sets = {
      paper_set("public", SetKind::open, Size::paper, {256, 256, 256}, 0.18, {1, 48}),
      paper_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, 0.21, {2, 56}),
      paper_set("public_smoke", SetKind::open, Size::smoke, {50, 54, 45}, 0.18, {1, 24, 4}),
      paper_set("hidden_smoke", SetKind::hidden, Size::smoke, {54, 48, 50}, 0.21, {2, 28, 4}),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  for (const std::string u : {"ux", "uy", "uz"})
    t.checks.push_back(relative_l2_of_change(u, u, 1e-3, "the paper's table of inputs and checks"));
  for (const std::string u : {"ux", "uy", "uz"}) t.checks.push_back(faces_off(u));
  t.checks.push_back(mac_fluid::divergence_check("divergence", CheckKind::local, 4e-5,
                                                 "the projection stops at tol of the divergence before it, "
                                                 "which is a quarter of the velocity after it and less"));
  t.checks.push_back(mac_fluid::closed_faces_check());
  t.knob = AccuracyKnob{"tol", {1e-1, 1e-2, 1e-3, 3e-4, 1e-4, 1e-5}};
  t.target_floor_multiple = 56;
  return t;
}

}  // namespace gpuphys::mc_r
