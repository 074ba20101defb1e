// Input sets, checks and hard cases of solve_constraint_xpbd (specification:
// cases/position_constraint/solve_constraint_xpbd.md).
#include "cases/position_constraint/solve_constraint_xpbd.hpp"

#include <fmt/format.h>

#include <cmath>
#include <utility>

#include "cases/position_constraint/cloth_inputs.hpp"
#include "cases/position_constraint/spring_inputs.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::solve_constraint_xpbd {
namespace {

namespace pc = position_constraint;
using pc::SpringSystem;

constexpr double kCompliance = 0.005, kDt = 0.1;  // alpha~ = 0.5
constexpr int kIterations = 8;

Problem problem_of(const SpringSystem& system, double compliance = kCompliance, int iterations = kIterations,
                   double dt = kDt) {
  Problem p = make_problem(describe<Inputs, Outputs<float>>(),
                           {{"n", static_cast<std::int64_t>(system.position.size())},
                            {"m", static_cast<std::int64_t>(system.springs.size())}});
  pc::store(system, p);
  p.set_scalar("compliance", compliance);
  p.set_scalar("dt", dt);
  p.set_scalar("iters", iterations);
  return p;
}

// The rolled cloth after a free flight of one time step.
SpringSystem predicted(const pc::RolledCloth& parameters) {
  pc::Cloth cloth = pc::make_rolled_cloth(parameters);
  for (std::size_t i = 0; i < cloth.position.size(); ++i) {
    for (std::size_t d = 0; d < 3; ++d) cloth.position[i][d] += kDt * cloth.velocity[i][d];
  }
  return {std::move(cloth.position), {}, std::move(cloth.springs), std::move(cloth.rest)};
}

pc::RolledCloth roll(std::int64_t rows, std::int64_t columns, std::int64_t free_side, bool hidden) {
  pc::RolledCloth c;
  c.rows = rows;
  c.columns = columns;
  c.free_side = free_side;
  if (hidden) {
    c.start_radius = 6;
    c.turn_gap = 0.42;
    c.strain = 0.006;
    c.periods = 5;
    c.jitter = 0.004;
    c.noise = 0.12;
    c.seed = 2;
  }
  return c;
}

InputSet roll_set(const std::string& name, SetKind kind, Size size, const pc::RolledCloth& c) {
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about =
      fmt::format("sheet of {} x {} rolled up from radius {} with a gap of {}, {}^3 free particles, seed {}",
                  c.rows, c.columns, c.start_radius, c.turn_gap, c.free_side, c.seed);
  s.make = [c] { return problem_of(predicted(c)); };
  return s;
}

// ---- hard cases ----

constexpr std::int64_t kRows = 37, kColumns = 29;

SpringSystem small_cloth(std::uint64_t seed) {
  pc::RolledCloth c = roll(kRows, kColumns, 3, false);
  c.seed = seed;
  return predicted(c);
}

Problem zero_length() {
  SpringSystem s = small_cloth(21);
  const auto n = static_cast<std::int32_t>(s.position.size());
  // Pairs that nothing else holds stay where they are; a second end put on top of the first in the cloth does
  // not.
  for (std::int32_t pair = 0; pair < 40; ++pair) {
    const std::array<double, 3> at{80.0 + pair, -3.5, 0.25 * pair};
    s.position.insert(s.position.end(), {at, at});
    s.springs.push_back({n + 2 * pair, n + 2 * pair + 1});
    s.rest.push_back(pair % 2 ? 1 : 0);
  }
  for (std::size_t j = 0; j < 300; j += 30) {
    s.position[static_cast<std::size_t>(s.springs[j][1])] =
        s.position[static_cast<std::size_t>(s.springs[j][0])];
  }
  return problem_of(s);
}

// Largest |x_new - x| of the isolated coincident pairs: the last 80 particles.
Check coincident_pairs_unmoved() {
  return {"coincident_unmoved",
          CheckKind::invariant,
          "x_new - x of the isolated coincident pairs",
          "largest absolute value, m",
          0,
          "a spring of zero length has no direction and is skipped",
          false,
          [](const Judged& j) {
            const HostArray& x = find(j.problem.inputs, "x", "inputs");
            const HostArray& got = find(j.outputs, "x_new", "outputs");
            Measured worst;
            for (std::int64_t i = x.size() - 240; i < x.size(); ++i) {
              const double e = std::abs(got.value(i) - x.value(i));
              if (!(e <= worst.error)) worst = {e, index_text(got, i)};
            }
            return worst;
          }};
}

Problem pinned() {
  SpringSystem s = small_cloth(22);
  for (std::size_t i = 0; i < s.position.size(); ++i) {
    const double u = uniform01(22, 50, i);
    s.inv_mass.push_back(u < 0.2 ? 0.0 : std::pow(10.0, 4 * u - 2.4));
  }
  return problem_of(s, 0);
}

Problem star() {
  constexpr std::int32_t kArms = 1000;
  SpringSystem s;
  s.position.push_back({0.1, -0.2, 0.3});
  for (std::int32_t i = 1; i <= kArms; ++i) {
    // Points of a spiral on the sphere of radius 1.25 about the hub, each off by up to 0.1.
    const double z = 1 - (2.0 * i - 1) / kArms, angle = 2.4 * i, r = std::sqrt(1 - z * z);
    const auto item = static_cast<std::uint64_t>(i);
    const double reach = 1.25 + 0.1 * uniform11(23, 50, item);
    s.position.push_back(
        {0.1 + reach * r * std::cos(angle), -0.2 + reach * r * std::sin(angle), 0.3 + reach * z});
    s.springs.push_back(i % 2 ? std::array<std::int32_t, 2>{0, i} : std::array<std::int32_t, 2>{i, 0});
    s.rest.push_back(1);
  }
  return problem_of(s, 0);
}

// Sum over all springs of (length - rest)^2, after over before.
Check violation_falls() {
  return {"violation_falls",
          CheckKind::invariant,
          "length - rest of the springs",
          "sum of squares after / before",
          0.9925,
          "for w = 1 and no compliance each iteration moves an arm by C / 2000, so that eight leave "
          "(1 - 1/2000)^16 = 0.99203 of the squares, whatever the hub does besides",
          false,
          [](const Judged& j) {
            const HostArray& rest = find(j.problem.inputs, "rest", "inputs");
            const auto ends = find(j.problem.inputs, "springs", "inputs").as<std::int32_t>();
            const auto violation = [&](const HostArray& x) {
              double total = 0;
              for (std::int64_t s = 0; s < rest.size(); ++s) {
                const std::int64_t a = ends[static_cast<std::size_t>(2 * s)];
                const std::int64_t b = ends[static_cast<std::size_t>(2 * s + 1)];
                double square = 0;
                for (std::int64_t d = 0; d < 3; ++d) {
                  const double e = x.value(3 * a + d) - x.value(3 * b + d);
                  square += e * e;
                }
                const double c = std::sqrt(square) - rest.value(s);
                total += c * c;
              }
              return total;
            };
            const double before = violation(find(j.problem.inputs, "x", "inputs"));
            return Measured{violation(find(j.outputs, "x_new", "outputs")) / before, ""};
          }};
}

Problem rest_state() {
  SpringSystem s;
  constexpr std::int64_t rows = 23, columns = 31;
  for (std::int64_t a = 0; a < rows; ++a) {
    for (std::int64_t b = 0; b < columns; ++b) {
      s.position.push_back({static_cast<double>(a) - 11, static_cast<double>(b) - 15, 0.5});
    }
  }
  for (const auto& ends : pc::sheet_springs(rows, columns)) {
    const std::int64_t da = ends[1] / columns - ends[0] / columns, db = ends[1] % columns - ends[0] % columns;
    if (da * db != 0) continue;  // sqrt(2) is not a float32
    s.springs.push_back(ends);
    s.rest.push_back(static_cast<double>(da + db));
  }
  return problem_of(s, 0);
}

Problem repeated_springs() {
  SpringSystem s = small_cloth(25);
  const std::size_t m = s.springs.size();
  for (std::size_t j = 0; j < m; ++j) {
    if (j % 3 == 0) continue;
    const auto [a, b] = s.springs[j];
    s.springs.push_back({b, a});
    s.rest.push_back(s.rest[j]);
    if (j % 3 == 2) {  // a spring from a particle to itself
      s.springs.push_back({a, a});
      s.rest.push_back(0.5);
    }
  }
  return problem_of(s);
}

Problem far_away() {
  SpringSystem s = small_cloth(26);
  for (auto& x : s.position) {
    for (double& c : x) c += 1e4;
  }
  return problem_of(s);
}

// A cloth whose springs are fifty times as long as the distances of their ends: displacements are of the size
// of the cloth, beyond what coordinates relative to it allow for.
Problem crushed() {
  SpringSystem s = small_cloth(31);
  for (auto& x : s.position) {
    for (double& c : x) c *= 0.02;
  }
  return problem_of(s);
}

// A cloth, and a copy of it 2^20 times smaller about the origin, in the middle of the roll: springs of a
// micrometre beside those of a metre. Lengths, displacements and their rounding scale alike.
constexpr double kCopyScale = 0x1p-20;
Problem two_scales() {
  SpringSystem s = small_cloth(30);
  const auto n = static_cast<std::int32_t>(s.position.size());
  const std::size_t m = s.springs.size();
  for (std::int32_t i = 0; i < n; ++i) {
    std::array<double, 3> x = s.position[static_cast<std::size_t>(i)];
    for (double& c : x) c *= kCopyScale;
    s.position.push_back(x);
  }
  for (std::size_t j = 0; j < m; ++j) {
    const auto [a, b] = s.springs[j];
    s.springs.push_back({a + n, b + n});
    s.rest.push_back(s.rest[j] * kCopyScale);
  }
  return problem_of(s);
}

// dx_rel_l2 of the second half of the particles.
Check small_copy_moves() {
  return {"small_copy",
          CheckKind::invariant,
          "x_new - x of the small copy",
          "relative L2",
          4e-3,
          "the paper's tolerance, for particles that the norm over all would not see",
          true,
          [](const Judged& j) {
            const HostArray& x = find(j.problem.inputs, "x", "inputs");
            const HostArray& got = find(j.outputs, "x_new", "outputs");
            const HostArray& truth = find(*j.truth, "x_new", "truth");
            double error = 0, square = 0;
            for (std::int64_t i = x.size() / 2; i < x.size(); ++i) {
              const double expected = static_cast<double>(static_cast<float>(truth.value(i)));
              error += (got.value(i) - expected) * (got.value(i) - expected);
              square += (expected - x.value(i)) * (expected - x.value(i));
            }
            return Measured{std::sqrt(error / square),
                            fmt::format("rms displacement of a coordinate {:.3g} m",
                                        std::sqrt(2 * square / static_cast<double>(x.size())))};
          }};
}

// Particles whose only springs begin and end at the same particle.
Problem self_springs(std::int64_t n) {
  SpringSystem s;
  for (std::int64_t i = 0; i < n; ++i) {
    const auto item = static_cast<std::uint64_t>(3 * i);
    s.position.push_back(
        {10 * uniform11(27, 50, item), 10 * uniform11(27, 50, item + 1), 10 * uniform11(27, 50, item + 2)});
    if (i % 3 != 0) continue;
    s.springs.push_back({static_cast<std::int32_t>(i), static_cast<std::int32_t>(i)});
    s.rest.push_back(1);
  }
  return problem_of(s);
}

// Springs between random neighbours of a lattice about the origin, of which none is near its rest length:
// displacements are of the size of the coordinates, so that float32 outputs keep six digits of them.
SpringSystem loose_net(std::uint64_t seed, double length, double shortest_rest, double longest_rest) {
  SpringSystem s;
  constexpr std::int64_t rows = 11, columns = 7, layers = 5;
  for (std::int64_t i = 0; i < rows * columns * layers; ++i) {
    const auto item = static_cast<std::uint64_t>(i);
    const double place[3] = {static_cast<double>(i / (columns * layers) - rows / 2),
                             static_cast<double>(i / layers % columns - columns / 2),
                             static_cast<double>(i % layers - layers / 2)};
    std::array<double, 3> x;
    for (std::size_t d = 0; d < 3; ++d) x[d] = length * (place[d] + 0.2 * uniform11(seed, 60 + d, item));
    s.position.push_back(x);
    s.inv_mass.push_back(std::pow(4.0, uniform11(seed, 63, item)));
    for (const std::int64_t step : {std::int64_t{1}, layers, columns * layers, columns * layers + 1}) {
      if (i + step >= rows * columns * layers ||
          uniform01(seed, 64, 4 * item + static_cast<std::uint64_t>(step) % 4) < 0.3)
        continue;
      const auto a = static_cast<std::int32_t>(i), b = static_cast<std::int32_t>(i + step);
      s.springs.push_back(step % 2 ? std::array{a, b} : std::array{b, a});
      s.rest.push_back(
          length * (shortest_rest + (longest_rest - shortest_rest) * uniform01(seed, 65, s.springs.size())));
    }
  }
  return s;
}

// Unequal ends that pull each other together: a rest length of zero is a spring like any other.
Problem rest_zero() {
  SpringSystem s = loose_net(32, 1.0, 0.5, 1.5);
  for (std::size_t j = 0; j < s.rest.size(); j += 2) s.rest[j] = 0;
  return problem_of(s, 0.004, 5, 0.05);
}

// Stars of 61 to 66 arms, with single springs beside them: the smallest system there is, too.
Problem stars() {
  SpringSystem s;
  for (std::int32_t arms = 61; arms <= 66; ++arms) {
    const auto hub = static_cast<std::int32_t>(s.position.size());
    const double centre = 3.0 * (arms - 63.5);
    s.position.push_back({centre, -0.0, 0.0});
    for (std::int32_t i = 0; i < arms; ++i) {
      const double z = (2.0 * i + 1.0) / arms - 1.0, angle = 2.4 * i, r = std::sqrt(1 - z * z);
      s.position.push_back({centre + r * std::cos(angle), r * std::sin(angle), z});
      s.springs.push_back({hub, hub + i + 1});
      s.rest.push_back(0.25 + 0.01 * i);
    }
  }
  return problem_of(s, 0.02, 3, 0.25);
}

Problem one_spring() {
  SpringSystem s;
  s.position = {{0.5, -0.25, 0.125}, {0.75, 0.5, -1.0}};
  s.inv_mass = {3.0, 0.7};
  s.springs = {{1, 0}};
  s.rest = {0.4};
  return problem_of(s, 0.001, 1, 0.03);
}

// Triples (a, b, c): c is pinned and pulls b, 1.2 m away from a, next to a in the first iteration. From the
// second on the spring between a and b, some 1e-5 m long then, pushes them apart by its rest length. Spread
// over 80 m, where float32 coordinates resolve 7.6e-6 m.
Problem short_after_first() {
  SpringSystem s;
  const auto grid = [](double x) { return std::round(x * 0x1p17) * 0x1p-17; };
  for (std::int32_t k = 0; k < 330; ++k) {
    const auto item = static_cast<std::uint64_t>(k);
    std::array<double, 3> a, b, c;
    const double centre[3] = {8.0 * (k % 11) - 40, 8.0 * (k / 11 % 6) - 20, 8.0 * (k / 66) - 16};
    const double z = uniform11(33, 70, item), angle = 3.14159265 * uniform11(33, 71, item),
                 r = std::sqrt(1 - z * z);
    const double along[3] = {r * std::cos(angle), r * std::sin(angle), z};
    for (std::size_t d = 0; d < 3; ++d) {
      a[d] = grid(centre[d] + uniform11(33, 72 + d, item));
      c[d] = grid(a[d] - 2.4 * along[d]);
      b[d] = grid(a[d] + 1.2 * along[d]);
    }
    // Where b comes to be next to a, one spacing or two of the coordinates beside it.
    const double target[3] = {a[0] + (k % 3 == 0 ? 1.3e-5 : 0), a[1] + (k % 3 == 1 ? 1.3e-5 : 0),
                              a[2] + (k % 3 == 2 ? 1.3e-5 : 0)};
    // b moves half of C towards c (valence 2, c pinned): put it where that leads to the target.
    double to_target = 0, direction[3];
    for (std::size_t d = 0; d < 3; ++d)
      direction[d] = target[d] - c[d], to_target += direction[d] * direction[d];
    to_target = std::sqrt(to_target);
    for (std::size_t d = 0; d < 3; ++d) b[d] = target[d] + 1.2 * direction[d] / to_target;
    double length = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      b[d] = static_cast<double>(static_cast<float>(b[d]));
      length += (b[d] - c[d]) * (b[d] - c[d]);
    }
    const auto first = static_cast<std::int32_t>(s.position.size());
    s.position.insert(s.position.end(), {a, b, c});
    s.inv_mass.insert(s.inv_mass.end(), {1.0, 1.0, 0.0});
    s.springs.push_back({first, first + 1});
    s.rest.push_back(1.2);
    s.springs.push_back({first + 2, first + 1});
    s.rest.push_back(std::sqrt(length) - 2.4);
  }
  return problem_of(s, 0, 2);
}

// What compliance 1e6 leaves of the motion: nothing that float32 resolves, bounded by the first corrections.
Check barely_moved() {
  return pc::unmoved_check(1e-5,
                           "alpha~ = 1e8 leaves 1e-8 of a violation below 3 m a correction, below 1e-5 m "
                           "even for 12 springs and 8 "
                           "iterations together with half a unit of |x| < 90 m in float32 (3.8e-6)");
}

// With |x| near 1e4 the final rounding of x_new exceeds the local tolerance.
Check within_one_unit() {
  return {"within_one_unit",
          CheckKind::invariant,
          "x_new",
          "largest error / unit in the last place of float32 at 1e4 (2^-10 m)",
          1,
          "displacements are known to far less than a unit in the last place of x_new, so that two correct "
          "results "
          "are the same float32 number or neighbours",
          true,
          [](const Judged& j) {
            const HostArray& got = find(j.outputs, "x_new", "outputs");
            const HostArray& truth = find(*j.truth, "x_new", "truth");
            Measured worst;
            for (std::int64_t i = 0; i < got.size(); ++i) {
              const double expected = static_cast<double>(static_cast<float>(truth.value(i)));
              const double e = std::abs(got.value(i) - expected) * 0x1p10;
              if (!(e <= worst.error)) {
                worst = {e, fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, i), got.value(i),
                                        expected)};
                if (!std::isfinite(e)) return worst;
              }
            }
            return worst;
          }};
}

// What is left of the paper's tolerances where displacements are of the size of the coordinates.
std::vector<Check> tight() {
  const auto renamed = [](Check c, const char* name) {
    c.kind = CheckKind::invariant;
    c.name = name;
    return c;
  };
  return {renamed(pc::displacement_check(1e-5,
                                         "some hundred springs with the rounding of float32: the FP32 "
                                         "baseline stays below 1e-6"),
                  "dx_rel_l2_tight"),
          renamed(pc::local_displacement_check(
                      5e-5, "likewise, of the worst coordinate, which may be rounded to a neighbour"),
                  "dx_local_tight"),
          pc::momentum_check()};
}

InputSet net_set(const std::string& stress, const std::string& about, double length, double compliance,
                 int iterations, double dt, std::uint64_t seed) {
  return hard_case(
      stress, about,
      [=] { return problem_of(loose_net(seed, length, 0.3, 1.7), compliance, iterations, dt); }, tight());
}

std::vector<InputSet> hard_sets() {
  const Check still = pc::unmoved_check(0, "nothing acts on any particle, and x + 0 = x in any precision");
  std::vector<InputSet> sets;
  sets.push_back(hard_case("zero_length_springs", "coincident ends: isolated pairs, and ends inside a cloth",
                           zero_length, {coincident_pairs_unmoved(), pc::momentum_check()}));
  sets.push_back(
      hard_case("pinned_and_heavy",
                "a fifth of the particles pinned, the others with masses over four decades, compliance 0",
                pinned, {pc::pinned_check()}));
  sets.push_back(hard_case("star_1000", "one particle holds 1000 springs, compliance 0", star,
                           {violation_falls(), pc::momentum_check()}));
  sets.push_back(hard_case(
      "compliance_1e6", "springs too soft to move anything", [] { return problem_of(small_cloth(24), 1e6); },
      {barely_moved()}, false));
  sets.push_back(hard_case("compliance_0", "rigid springs", [] { return problem_of(small_cloth(29), 0); },
                           {pc::momentum_check()}));
  sets.push_back(
      hard_case("rest_state", "every spring has its rest length exactly", rest_state,
                {pc::unmoved_check(0x1p-21,
                                   "lengths of 1 and 2 are exact; allows two units in the last place of a "
                                   "length, for inexact square roots")},
                false));
  sets.push_back(hard_case("repeated_springs",
                           "springs given twice in opposite directions, springs from a particle to itself",
                           repeated_springs, {pc::momentum_check()}));
  sets.push_back(hard_case("offset_1e4", "a cloth 1e4 m away from the origin along every axis", far_away,
                           {within_one_unit(), pc::momentum_check()}, false));
  sets.push_back(hard_case("crushed",
                           "a cloth crushed to a fiftieth of its size, springs at their old lengths", crushed,
                           {pc::momentum_check()}));
  sets.push_back(hard_case("two_scales", "a cloth, and a copy 2^20 times smaller in its middle", two_scales,
                           {small_copy_moves(), pc::momentum_check()}));
  sets.push_back(net_set("one_iteration", "one iteration; compliance 0.7, dt 0.5", 1, 0.7, 1, 0.5, 41));
  sets.push_back(net_set("seven_iterations", "an odd number of iterations; compliance 0.05, dt 1/60", 1, 0.05,
                         7, 1.0 / 60, 42));
  sets.push_back(
      net_set("fifteen_iterations", "15 iterations; compliance 3e-4, dt 0.02", 1, 3e-4, 15, 0.02, 43));
  sets.push_back(net_set("nanometre", "springs of 1e-9 m", 1e-9, 0.01, 4, 0.1, 44));
  sets.push_back(net_set("picometre", "springs of 1e-12 m", 1e-12, 0.002, 3, 0.04, 45));
  sets.push_back(net_set("gigametre", "springs of 1e12 m", 1e12, 0.03, 6, 0.3, 46));
  sets.push_back(
      hard_case("rest_zero", "every other rest length is zero, ends of unequal masses", rest_zero, tight()));
  sets.push_back(hard_case("stars", "particles with 61 to 66 springs", stars, tight()));
  sets.push_back(hard_case("one_spring", "one spring, two particles", one_spring, tight()));
  sets.push_back(hard_case("short_after_first",
                           "springs that the first iteration shortens from a metre to 1e-5 m, 80 m apart",
                           short_after_first));
  sets.push_back(hard_case("self_springs", "no springs but from particles to themselves",
                           [] { return self_springs(100); }, {still}));
  sets.push_back(hard_case("one_particle", "a single particle with a spring to itself",
                           [] { return self_springs(1); }, {still}));
  sets.push_back(hard_case("zero_iterations", "a cloth with no iterations to do",
                           [] { return problem_of(small_cloth(28), kCompliance, 0); }, {still}));
  return sets;
}

}  // namespace

Task make_task() {
  Task t;
  t.title = "XPBD projection of spring constraints (Jacobi, averaged by valence)";
  t.paper_number = 12;
  t.contract = describe<Inputs, Outputs<float>>();
  t.sets = {
      roll_set("public", SetKind::open, Size::paper, roll(1024, 1024, 16, false)),
      roll_set("hidden", SetKind::hidden, Size::paper, roll(1024, 1024, 16, true)),
      roll_set("public_smoke", SetKind::open, Size::smoke, roll(293, 167, 7, false)),
      roll_set("hidden_smoke", SetKind::hidden, Size::smoke, roll(167, 293, 7, true)),
  };
  for (InputSet& s : hard_sets()) t.sets.push_back(std::move(s));
  t.checks = {
      pc::displacement_check(4e-3, "the paper's table of inputs and checks"),
      pc::free_particles_check(1e-6, "the paper's table of inputs and checks"),
      pc::local_displacement_check(2e-2,
                                   "float32 numbers at |y| < 512 m are up to 3.05e-5 m apart, 4.1e-3 of the "
                                   "rms displacement of 7.4e-3 m, and "
                                   "two correct results are equal or neighbours: five times that, and far "
                                   "below the tenth of the rms that one "
                                   "spring too few makes"),
  };
  t.unordered = {{"n", {"springs"}}, {"m", {}}};
  t.target_floor_multiple = 20;
  return t;
}

}  // namespace gpuphys::solve_constraint_xpbd
