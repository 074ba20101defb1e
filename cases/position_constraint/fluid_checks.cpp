#include "cases/position_constraint/fluid_checks.hpp"

#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "core/judge/checks.hpp"

namespace gpuphys::fluid {
namespace {

std::function<Problem()> maker(Contract contract, std::function<Particles()> make, Scalars scalars) {
  std::vector<std::pair<std::string, double>> values(scalars.begin(), scalars.end());
  return [contract = std::move(contract), make = std::move(make), values = std::move(values)] {
    Problem p = problem_of(contract, make());
    for (const auto& [name, value] : values) p.set_scalar(name, value);
    return p;
  };
}

std::array<double, 3> change(const HostArray& after, const HostArray& before, std::int64_t i) {
  std::array<double, 3> d{};
  for (std::int64_t c = 0; c < 3; ++c)
    d[static_cast<std::size_t>(c)] = after.value(3 * i + c) - before.value(3 * i + c);
  return d;
}

}  // namespace

InputSet block_set(const Contract& contract, const std::string& name, SetKind kind, Size size, const Block& b,
                   Scalars scalars) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format(
      "{}x{}x{} lattice from {} m, density wave {} of {} m, jitter {} m, ABC flow of {} m/s and {} m, noise "
      "{} m/s, seed {}",
      b.lattice[0], b.lattice[1], b.lattice[2], b.corner[0], b.wave, b.wave_length, b.jitter, b.flow,
      b.flow_length, b.noise, b.seed);
  s.make = maker(
      contract, [b] { return block(b); }, scalars);
  return s;
}

InputSet hard_set(const Contract& contract, const std::string& stress, const std::string& about,
                  std::function<Particles()> make, Scalars scalars, std::vector<Check> invariants) {
  return hard_case(stress, about, maker(contract, std::move(make), scalars), std::move(invariants));
}

Check momentum_kept(const std::string& output_name, const std::string& input_name) {
  return conserved_sum(
      {.name = "momentum",
       .kind = CheckKind::local,
       .array = output_name,
       .quantity = fmt::format("|sum of ({} - {})| / sum of |{}|", output_name, input_name, output_name),
       .tolerance = 0x1p-23,
       .why = "what a pair exchanges is opposite, so the sum is zero up to the rounding of "
              "the output, half a unit in the last place of each component",
       .needs_truth = false},
      [=](const Judged& j) {
        const HostArray &after = output(j, output_name), &before = input(j, input_name);
        const std::int64_t n = after.shape()[0];
        double scale = 0;
        for (std::int64_t k = 0; k < after.size(); ++k) scale += std::abs(after.value(k));
        return Terms{n, [&](std::int64_t i) { return change(after, before, i); }, {}, scale};
      });
}

Check unchanged(const std::string& output_name, const std::string& input_name, const std::string& why) {
  return worst_over(
      {.name = output_name + "_unchanged",
       .kind = CheckKind::invariant,
       .array = output_name,
       .quantity = fmt::format("|{} - {}| of a component", output_name, input_name),
       .tolerance = 0,
       .why = why,
       .needs_truth = false},
      [=](const Judged& j) {
        const HostArray &after = output(j, output_name), &before = input(j, input_name);
        return Items{after.size(), [&](std::int64_t k) { return after.value(k) - before.value(k); }};
      });
}

Check equal_or_next(const std::string& output_name) {
  return count_where(
      {.name = output_name + "_equal_or_next",
       .kind = CheckKind::invariant,
       .array = output_name,
       .quantity =
           "components that are neither the truth's float32 nor a neighbour of it, nor within 2^-21 h",
       .tolerance = 0,
       .why =
           "the result is rounded once; the displacement is uncertain by a few units in the last place of h"},
      [=](const Judged& j) {
        const HostArray &got = output(j, output_name), &expected = truth(j, output_name);
        const double near = 0x1p-21 * j.problem.scalar("h");
        return Items{got.size(), [&got, &expected, near](std::int64_t k) {
                       constexpr float inf = std::numeric_limits<float>::infinity();
                       const auto middle = static_cast<float>(expected.value(k));
                       const auto g = static_cast<float>(got.value(k));
                       const bool next =
                           g >= std::nextafter(middle, -inf) && g <= std::nextafter(middle, inf);
                       return next || std::abs(got.value(k) - expected.value(k)) <= near ? 0.0 : 1.0;
                     }};
      });
}

std::vector<Check> tight(const std::string& output_name, const std::string& input_name, double rel_l2,
                         double local) {
  const std::string why = "small sets are held to ten times less than the paper's size or better";
  std::vector<Check> checks;
  checks.push_back(as_invariant(relative_l2_of_change(output_name, input_name, 1, ""),
                                output_name + "_tight_rel_l2", rel_l2, why));
  checks.push_back(as_invariant(local_error_of_change(output_name, input_name, 1, ""),
                                output_name + "_tight_local", local, why));
  return checks;
}

}  // namespace gpuphys::fluid
