#include "cases/collision_query/toi_checks.hpp"

#include <fmt/format.h>

#include <cmath>
#include <utility>

#include "core/generators/random.hpp"
#include "core/judge/comparators.hpp"

namespace gpuphys::toi {

using cloth_sheets::Mesh;
using cloth_sheets::Motion;
using cloth_sheets::Parameters;
using cloth_sheets::Point;

namespace {

// Truth as the best float32 output.
double rounded(const HostArray& truth, std::int64_t i) {
  return static_cast<double>(static_cast<float>(truth.value(i)));
}

std::function<std::string(std::int64_t)> difference_text(const HostArray& got, const HostArray& expected) {
  return [&](std::int64_t i) {
    return fmt::format("{}: got {:.9g}, expected {:.9g}", index_text(got, i), got.value(i),
                       rounded(expected, i));
  };
}

}  // namespace

Check minus_1_rel_l2(double tolerance) {
  return worst_over({.name = "toi_minus_1_rel_l2",
                     .kind = CheckKind::paper,
                     .array = "toi",
                     .quantity = "relative L2 error of toi - 1",
                     .tolerance = tolerance,
                     .why = "the paper's table of inputs and checks"},
                    [](const Judged& j) {
                      const HostArray &got = output(j, "toi"), &expected = truth(j, "toi");
                      return Items{1, [&](std::int64_t) {
                                     double difference = 0, norm = 0;
                                     for (std::int64_t i = 0; i < got.size(); ++i) {
                                       const double g = got.value(i), r = rounded(expected, i);
                                       difference += (g - r) * (g - r);
                                       norm += (r - 1) * (r - 1);
                                     }
                                     return std::sqrt(norm > 0 ? difference / norm : difference);
                                   }};
                    });
}

Check local(double tolerance, const std::string& why) {
  return worst_over({.name = "toi_local",
                     .kind = CheckKind::local,
                     .array = "toi",
                     .quantity = "largest error of toi",
                     .tolerance = tolerance,
                     .why = why},
                    [](const Judged& j) {
                      const HostArray &got = output(j, "toi"), &expected = truth(j, "toi");
                      return Items{got.size(),
                                   [&](std::int64_t i) { return got.value(i) - rounded(expected, i); },
                                   difference_text(got, expected)};
                    });
}

Check mismatched_events() {
  return count_where(
      {.name = "toi_mismatched_events",
       .kind = CheckKind::local,
       .array = "toi",
       .quantity = "times more than 1e-3 apart",
       .tolerance = 0.5,
       .why = "none: inputs hold no event that rounding in float32 can add or remove"},
      [](const Judged& j) {
        const HostArray &got = output(j, "toi"), &expected = truth(j, "toi");
        return Items{
            got.size(),
            [&](std::int64_t i) { return std::abs(got.value(i) - rounded(expected, i)) <= 1e-3 ? 0.0 : 1.0; },
            difference_text(got, expected)};
      });
}

Check within_the_step() {
  return within("toi", 0, 1, "an impact outside the step is none of it", "within_the_step");
}

Check known_times(const std::string& name, double tolerance, const std::string& why,
                  std::function<double(std::int64_t)> expected) {
  return equals_known(
      {.name = name,
       .kind = CheckKind::invariant,
       .array = "toi",
       .quantity = "largest distance from the known time",
       .tolerance = tolerance,
       .why = why,
       .needs_truth = false},
      [expected = std::move(expected)](const Judged& j) {
        std::vector<double> known(static_cast<std::size_t>(output(j, "toi").size()));
        for (std::size_t i = 0; i < known.size(); ++i) known[i] = expected(static_cast<std::int64_t>(i));
        return known;
      },
      1);
}

Check no_events(const std::string& why) {
  // A single event is an error of up to 1: any tolerance below the resolution of an impact time does.
  return known_times("no_events", 1e-12, why, [](std::int64_t) { return 1.0; });
}

InputSet hard(const std::string& stress, const std::string& about, std::function<Problem()> make,
              std::vector<Check> invariants, bool use_task_checks) {
  invariants.push_back(within_the_step());
  return hard_case(stress, about, std::move(make), std::move(invariants), use_task_checks);
}

Parameters public_sheets(std::int64_t n, double jitter) {
  Parameters p;
  p.n = n;
  p.jitter = jitter;
  p.shear = 0.5;  // so that vertices meet every place of a square of the next sheet
  return p;
}

Parameters hidden_sheets(std::int64_t n, double jitter) {
  Parameters p = public_sheets(n, jitter);
  p.seed = 2;
  p.offset = 0.95;
  p.waviness = 0.34;
  p.wave_a = 2;
  p.wave_b = 3;
  p.phase_step = 0.9;
  p.drive_period = 48;
  return p;
}

Problem problem_from(const Contract& contract, const Mesh& mesh, double d) {
  const auto n = static_cast<std::int64_t>(mesh.x0.size());
  const auto m = static_cast<std::int64_t>(mesh.primitives.size()) / mesh.corners;
  Problem p =
      make_problem(contract, mesh.corners == 1 ? std::map<std::string, std::int64_t>{{"n", n}}
                                               : std::map<std::string, std::int64_t>{{"n", n}, {"m", m}});
  const std::span<float> x0 = p.inputs[0].as<float>(), x1 = p.inputs[1].as<float>();
  for (std::size_t v = 0; v < mesh.x0.size(); ++v) {
    for (std::size_t c = 0; c < 3; ++c) {
      x0[3 * v + c] = mesh.x0[v][c];
      x1[3 * v + c] = mesh.x1[v][c];
    }
  }
  if (mesh.corners > 1)
    std::copy(mesh.primitives.begin(), mesh.primitives.end(), p.inputs[2].as<std::int32_t>().begin());
  if (!p.scalars.empty()) p.set_scalar("d", d);
  return p;
}

std::int32_t add_vertex(Mesh& mesh, const Point& start, const Point& end) {
  const auto narrow = [](const Point& p) {
    return std::array<float, 3>{static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
  };
  mesh.x0.push_back(narrow(start));
  mesh.x1.push_back(narrow(end));
  return static_cast<std::int32_t>(mesh.x0.size()) - 1;
}

void tumble(Mesh& mesh, std::int64_t vertices, double d, double size, std::uint64_t seed) {
  cloth_sheets::settle(mesh, vertices, d, [=](std::int64_t v, int attempt) {
    Motion m;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint64_t i = 3 * static_cast<std::uint64_t>(v) + c;
      m.start[c] = size * uniform11(seed, 10 + 100 * static_cast<std::uint64_t>(attempt), i);
      m.end[c] = size * uniform11(seed, 11 + 100 * static_cast<std::uint64_t>(attempt), i);
    }
    return m;
  });
}

Mesh scaled(Mesh mesh, double factor) {
  for (auto* x : {&mesh.x0, &mesh.x1}) {
    for (std::array<float, 3>& p : *x) {
      for (float& c : p) c *= static_cast<float>(factor);
    }
  }
  return mesh;
}

Mesh far_sheets(const Parameters& parameters, int corners, double d, double offset, double shake) {
  Mesh mesh = cloth_sheets::sheet_mesh(parameters, corners, d);
  const std::vector<std::array<float, 3>> x0 = mesh.x0, x1 = mesh.x1;
  cloth_sheets::settle(mesh, static_cast<std::int64_t>(x0.size()), d, [&](std::int64_t v, int attempt) {
    Motion m;
    for (std::size_t c = 0; c < 3; ++c) {
      // Drawn anew, a vertex moves by a few units of the resolution there.
      const double shift = attempt == 0 ? 0
                                        : shake * uniform11(41, static_cast<std::uint64_t>(attempt),
                                                            3 * static_cast<std::uint64_t>(v) + c);
      m.start[c] = offset + static_cast<double>(x0[static_cast<std::size_t>(v)][c]) + shift;
      m.end[c] = offset + static_cast<double>(x1[static_cast<std::size_t>(v)][c]) - shift;
    }
    return m;
  });
  return mesh;
}

}  // namespace gpuphys::toi
