// Input sets and checks of viscosity_implicit (specification: cases/global_solve/viscosity_implicit.md).
#include "cases/global_solve/viscosity_implicit.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "cases/global_solve/mac_fluid_inputs.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::viscosity_implicit {
namespace {

using mac_fluid::Extents;
using mac_fluid::Open;

Contract contract() {
  return describe<Inputs, Outputs<float>>();
}

struct Law {
  double dx, dt, nu, tol;
};
constexpr Law kLaw{0x1p-8, 0x1p-7, 0x1p-5, 3e-4};  // alpha = 16

void set_law(Problem& p, const Law& law) {
  p.set_scalar("dx", law.dx);
  p.set_scalar("dt", law.dt);
  p.set_scalar("nu", law.nu);
  p.set_scalar("tol", law.tol);
}

InputSet paper_set(const std::string& name, SetKind kind, Size size, Extents n, double radius,
                   mac_fluid::Modes modes) {
  return mac_fluid::cylinder_set(name, kind, size, contract(), n, radius, modes,
                                 {{"dx", kLaw.dx}, {"dt", kLaw.dt}, {"nu", kLaw.nu}, {"tol", kLaw.tol}});
}

// Small sets solved to a tighter tolerance are held to it.
std::vector<Check> tight(double tolerance) {
  std::vector<Check> all;
  for (const std::string u : {"ux", "uy", "uz"}) {
    all.push_back(
        as_invariant(relative_l2_check(u, 0, ""), u + "_rel_l2_tight", tolerance,
                     "the smallest eigenvalue of A over the open fractions is 1 or more, so the error is "
                     "about the residual times ||b|| / ||u||"));
  }
  return all;
}

// u = w u* / (w + alpha held) in a single open face; `held` of its six neighbours are at rest, the others lie
// beyond a wall along which fluid slips.
Check single_face(int axis, double held) {
  return worst_over({.name = "by_hand",
                     .kind = CheckKind::invariant,
                     .array = "ux, uy, uz",
                     .quantity = "largest error over the size of the answer",
                     .tolerance = 1e-6,
                     .why = "one equation, some units of 2^-24",
                     .needs_truth = false},
                    [=](const Judged& j) {
                      const auto in = bind_inputs<Inputs>(j.problem);
                      const double alpha = static_cast<double>(in.nu) * static_cast<double>(in.dt) /
                                           (static_cast<double>(in.dx) * static_cast<double>(in.dx));
                      const std::array names{"ux", "uy", "uz"};
                      const HostArray& u = output(j, names[static_cast<std::size_t>(axis)]);
                      const HostArray &w = j.problem.inputs[static_cast<std::size_t>(3 + axis)],
                                      &start = j.problem.inputs[static_cast<std::size_t>(axis)];
                      return Items{u.size(), [=, &u, &w, &start](std::int64_t f) {
                                     const double open = w.value(f);
                                     if (open == 0) return u.value(f);
                                     const double expected = open * start.value(f) / (open + alpha * held);
                                     return u.value(f) / expected - 1;
                                   }};
                    });
}

// Between the smallest and the largest of the start and 0.
Check maximum_principle() {
  return worst_over(
      {.name = "maximum_principle",
       .kind = CheckKind::invariant,
       .array = "ux, uy, uz",
       .quantity = "what exceeds the largest start, over it",
       .tolerance = 1e-4,
       .why = "viscosity makes no new extremes; a solver that stops early may overshoot by its tolerance",
       .needs_truth = false},
      [](const Judged& j) {
        double largest = 0;
        for (std::size_t c = 0; c < 3; ++c) {
          const HostArray& start = j.problem.inputs[c];
          for (std::int64_t f = 0; f < start.size(); ++f)
            largest = std::max(largest, std::abs(start.value(f)));
        }
        const HostArray &ux = j.outputs[0], &uy = j.outputs[1], &uz = j.outputs[2];
        return Items{ux.size() + uy.size() + uz.size(), [=, &ux, &uy, &uz](std::int64_t f) {
                       const double v = f < ux.size()               ? ux.value(f)
                                        : f < ux.size() + uy.size() ? uy.value(f - ux.size())
                                                                    : uz.value(f - ux.size() - uy.size());
                       const double beyond = std::abs(v) / largest - 1;
                       return beyond <= 0 ? 0.0 : beyond;
                     }};
      });
}

std::vector<InputSet> hard_sets() {
  std::vector<InputSet> sets;
  const auto add = [&](const std::string& stress, const std::string& about, Extents n, Open open, Law law,
                       std::uint64_t seed, double size, std::vector<Check> also = {}) {
    sets.push_back(hard_case(
        stress, about,
        [=] {
          Problem p = mac_fluid::make_fluid(contract(), n, open);
          set_law(p, law);
          mac_fluid::set_noise(p, seed, size);
          return p;
        },
        std::move(also)));
  };
  const Extents odd{37, 34, 45}, small{15, 18, 21};
  add("ball", "a ball off the centre: obstacles vary along every axis", odd,
      mac_fluid::ball({14.3, 19.2, 25.7}, 8.6), {0x1p-8, 0x1p-7, 0x1p-5, 1e-5}, 3, 1, tight(1e-4));
  add("little_viscosity", "alpha = 1/2, solved to 1e-6", odd, mac_fluid::ball({21.3, 15.2, 20.7}, 9.1),
      {0.1, 0.05, 0.1, 1e-6}, 4, 1, tight(1e-5));
  // The paper's bound on the error is not meant for a stop as early as this.
  {
    std::vector<Check> also{mac_fluid::viscous_residual_check(), mac_fluid::closed_faces_check()};
    for (Check& c : tight(0.1)) also.push_back(std::move(c));
    sets.push_back(hard_case(
        "loose", "tol = 1e-2: no more is asked for",
        [=] {
          Problem p = mac_fluid::make_fluid(contract(), small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1));
          set_law(p, {0x1p-8, 0x1p-8, 0x1p-4, 1e-2});
          mac_fluid::set_noise(p, 5, 1);
          return p;
        },
        std::move(also), false));
  }
  add("thick", "alpha = 1e5: nothing is left but what the slipping walls let pass", small,
      mac_fluid::all_open(), {0.01, 1, 10, 1e-5}, 6, 1, {maximum_principle()});
  add("no_viscosity", "nu = 0: the velocity stays, on every open face", small,
      mac_fluid::random_faces(small, 7, 0.3), {0.1, 0.1, 0, 1e-6}, 7, 1, tight(1e-5));
  add("maze", "a third of the faces closed at random, the others open by any amount", {17, 16, 19},
      mac_fluid::random_faces({17, 16, 19}, 8, 0.35), {0.1, 0.5, 0.06, 1e-6}, 8, 1, tight(1e-5));
  add(
      "slivers", "all faces open by 2^-20 or 1", small,
      [](int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
        return (i + 2 * j + 3 * k + axis) % 3 == 0 ? mac_fluid::kLeastOpen : 1.0;
      },
      {0.1, 0.1, 0.2, 1e-6}, 9, 1, tight(1e-5));
  add("fast", "velocities of 1e15 m/s", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), {1, 1, 0.7, 1e-6}, 10,
      1e15, tight(1e-5));
  add("slow", "velocities of 1e-15 m/s", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), {1, 1, 0.7, 1e-6}, 11,
      1e-15, tight(1e-5));
  add("at_rest", "u = 0", small, mac_fluid::ball({7.3, 8.2, 10.7}, 4.1), kLaw, 12, 0,
      {exactly_zero("ux", "nothing moves"), exactly_zero("uy", "nothing moves"),
       exactly_zero("uz", "nothing moves")});
  add("all_closed", "no open face", {5, 6, 7}, [](auto...) { return 0.0; }, kLaw, 13, 1,
      {exactly_zero("ux", "no face is open"), exactly_zero("uy", "no face is open"),
       exactly_zero("uz", "no face is open")});
  // One open face: at a slipping wall or two, or inside.
  for (int axis = 0; axis < 3; ++axis) {
    for (const int where : {0, 1, 2, 3, 4}) {
      const Extents n{5, 6, 7};
      // Indices across the face: inside, at the lower or upper end of the next axis, of the one after.
      std::array<std::int64_t, 3> at{2, 3, 3};
      const auto first = static_cast<std::size_t>((axis + 1) % 3),
                 second = static_cast<std::size_t>((axis + 2) % 3);
      if (where == 1) at[first] = 0;
      if (where == 2) at[first] = n[first] - 1;
      if (where == 3) at[second] = 0;
      if (where == 4) at[first] = 0, at[second] = n[second] - 1;
      const double held = where == 0 ? 6 : where == 4 ? 4 : 5;
      const char* const names[] = {"inside", "lower", "upper", "side", "edge"};
      sets.push_back(
          hard_case(fmt::format("one_face_{}_{}", "xyz"[axis], names[where]),
                    "one open face among closed ones: u by hand",
                    [=] {
                      Problem p = mac_fluid::make_fluid(
                          contract(), n, [=](int a, std::int64_t i, std::int64_t j, std::int64_t k) {
                            return a == axis && std::array<std::int64_t, 3>{i, j, k} == at ? 0.375 : 0.0;
                          });
                      set_law(p, {0.25, 0.5, 0.375, 1e-6});
                      mac_fluid::set_noise(p, 14, 1);
                      return p;
                    },
                    {single_face(axis, held)}));
    }
  }
  for (const Extents n : {Extents{1, 1, 1}, Extents{2, 1, 1}, Extents{1, 5, 33}, Extents{7, 1, 9},
                          Extents{4, 3, 48}, Extents{5, 3, 20}, Extents{3, 7, 16}, Extents{70000, 1, 2},
                          Extents{1, 70000, 2}, Extents{2, 1, 70000}}) {
    add(fmt::format("grid_{}x{}x{}", n[0], n[1], n[2]),
        "thin, odd and long boxes; a tenth of the faces closed", n, mac_fluid::random_faces(n, 15, 0.1),
        {0.1, 0.2, 0.07, 1e-6}, 15, 1, tight(1e-5));
  }
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "Implicit viscosity of a velocity on a MAC grid with cut cells";
  t.paper_number = 3;
  t.contract = contract();
  t.sets = {
      paper_set("public", SetKind::open, Size::paper, {256, 256, 256}, 0.18, {1, 48}),
      paper_set("hidden", SetKind::hidden, Size::paper, {256, 256, 256}, 0.21, {2, 56}),
      paper_set("public_smoke", SetKind::open, Size::smoke, {50, 54, 45}, 0.18, {1, 24, 4}),
      paper_set("hidden_smoke", SetKind::hidden, Size::smoke, {54, 48, 50}, 0.21, {2, 28, 4}),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  const std::string table = "the paper's table of inputs and checks";
  for (const std::string u : {"ux", "uy", "uz"}) t.checks.push_back(relative_l2_check(u, 2.5e-3, table));
  for (const std::string u : {"ux", "uy", "uz"}) {
    t.checks.push_back(
        local_error_check(u, 2.5e-2,
                          "a stop at tol leaves some units of it at single faces; a face with a wrong "
                          "equation is off by its own size"));
  }
  t.checks.push_back(mac_fluid::viscous_residual_check());
  t.checks.push_back(mac_fluid::closed_faces_check());
  t.knob = AccuracyKnob{"tol", {1e-1, 3e-2, 1e-2, 1e-3, 3e-4, 1e-4, 1e-5}};
  t.target_floor_multiple = 25;
  return t;
}

}  // namespace gpuphys::viscosity_implicit
