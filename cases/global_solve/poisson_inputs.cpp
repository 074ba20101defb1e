#include "cases/global_solve/poisson_inputs.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>

#include "core/generators/random.hpp"

namespace gpuphys::poisson {
namespace {

// Random streams: 0 is the noise of the manufactured solution.
constexpr std::uint64_t kFaceStream = 1;  // 1, 2, 3 for faces normal to x, y, z
constexpr std::uint64_t kCellStream = 4;

constexpr double kLocalTolerance = 1e-4;

const char* const kFiniteWhy = "no value of a well-posed system's solution is NaN or infinite";

}  // namespace

std::uint64_t flat(const Extents& n, std::int64_t i, std::int64_t j, std::int64_t k) {
  return static_cast<std::uint64_t>((i * n[1] + j) * n[2] + k);
}

double inner_face_uniform01(const Extents& n, std::uint64_t seed, int axis, std::int64_t i, std::int64_t j,
                            std::int64_t k) {
  return uniform01(seed, kFaceStream + static_cast<std::uint64_t>(axis), flat(n, i, j, k));
}

double face_uniform01(const Extents& n, std::uint64_t seed, int axis, std::int64_t i, std::int64_t j,
                      std::int64_t k) {
  const std::int64_t x = axis == 0, y = axis == 1, z = axis == 2;
  return inner_face_uniform01({n[0] + x, n[1] + y, n[2] + z}, seed, axis, i + x, j + y, k + z);
}

double cell_uniform01(const Extents& n, std::uint64_t seed, std::int64_t i, std::int64_t j, std::int64_t k) {
  return uniform01(seed, kCellStream, flat(n, i, j, k));
}

bool everywhere(std::int64_t, std::int64_t, std::int64_t) {
  return true;
}

double unit_conductance(int, std::int64_t, std::int64_t, std::int64_t) {
  return 1;
}

double layer_conductance(int axis, std::int64_t, std::int64_t j, std::int64_t) {
  const auto strong = [](std::int64_t layer) { return (layer / 3) % 2 == 0; };
  return strong(j) && (axis != 1 || strong(j + 1)) ? 1.0 : 0x1p-20;
}

bool on_outside(const Extents& n, int axis, std::int64_t i, std::int64_t j, std::int64_t k) {
  const std::int64_t low = axis == 0 ? i : axis == 1 ? j : k;
  return low < 0 || low + 1 == n[static_cast<std::size_t>(axis)];
}

std::vector<char> random_cells(const Extents& n, std::uint64_t seed, double share) {
  std::vector<char> active(static_cast<std::size_t>(n[0] * n[1] * n[2]));
  for (std::size_t c = 0; c < active.size(); ++c) active[c] = uniform01(seed, kCellStream, c) < share;
  return active;
}

std::vector<char> largest_component(const Extents& n, const std::vector<char>& active) {
  std::vector<int> label(active.size(), -1);
  std::vector<std::size_t> size;
  for (std::size_t seed = 0; seed < active.size(); ++seed) {
    if (!active[seed] || label[seed] >= 0) continue;
    const int mine = static_cast<int>(size.size());
    std::vector<std::size_t> stack{seed};
    label[seed] = mine;
    size.push_back(0);
    while (!stack.empty()) {
      const std::int64_t c = static_cast<std::int64_t>(stack.back());
      stack.pop_back();
      ++size.back();
      const std::int64_t at[3] = {c / (n[1] * n[2]), c / n[2] % n[1], c % n[2]};
      const std::int64_t step[3] = {n[1] * n[2], n[2], 1};
      for (int d = 0; d < 3; ++d) {
        for (const std::int64_t side : {-1, 1}) {
          if (at[d] + side < 0 || at[d] + side >= n[static_cast<std::size_t>(d)]) continue;
          const std::size_t other = static_cast<std::size_t>(c + side * step[d]);
          if (!active[other] || label[other] >= 0) continue;
          label[other] = mine;
          stack.push_back(other);
        }
      }
    }
  }
  const int largest = static_cast<int>(std::max_element(size.begin(), size.end()) - size.begin());
  std::vector<char> kept(active.size());
  for (std::size_t c = 0; c < kept.size(); ++c) kept[c] = label[c] == largest;
  return kept;
}

std::vector<char> maze_cells(const Extents& rooms, std::uint64_t seed) {
  const Extents n{2 * rooms[0] - 1, 2 * rooms[1] - 1, 2 * rooms[2] - 1};
  struct Passage {
    std::uint64_t order;
    std::uint64_t from, to;  // rooms
    std::uint64_t cell;
  };
  std::vector<Passage> passages;
  std::vector<char> active(static_cast<std::size_t>(n[0] * n[1] * n[2]), 0);
  for (std::int64_t i = 0; i < rooms[0]; ++i) {
    for (std::int64_t j = 0; j < rooms[1]; ++j) {
      for (std::int64_t k = 0; k < rooms[2]; ++k) {
        active[flat(n, 2 * i, 2 * j, 2 * k)] = 1;
        for (int d = 0; d < 3; ++d) {
          const std::int64_t a = i + (d == 0), b = j + (d == 1), c = k + (d == 2);
          if (a == rooms[0] || b == rooms[1] || c == rooms[2]) continue;
          const std::uint64_t from = flat(rooms, i, j, k);
          passages.push_back({random_bits(seed, kFaceStream + static_cast<std::uint64_t>(d), from), from,
                              flat(rooms, a, b, c), flat(n, i + a, j + b, k + c)});
        }
      }
    }
  }
  std::sort(passages.begin(), passages.end(), [](const Passage& a, const Passage& b) {
    return std::pair(a.order, a.cell) < std::pair(b.order, b.cell);
  });
  // Kruskal: a passage is opened when it joins two rooms that are not connected yet.
  std::vector<std::uint64_t> parent(static_cast<std::size_t>(rooms[0] * rooms[1] * rooms[2]));
  std::iota(parent.begin(), parent.end(), std::uint64_t{0});
  const auto root = [&](std::uint64_t r) {
    while (parent[r] != r) r = parent[r] = parent[parent[r]];
    return r;
  };
  for (const Passage& p : passages) {
    const std::uint64_t a = root(p.from), b = root(p.to);
    if (a == b) continue;
    parent[a] = b;
    active[p.cell] = 1;
  }
  return active;
}

ActiveCell cells_in(const Extents& n, const std::vector<char>& active) {
  return [n, &active](std::int64_t i, std::int64_t j, std::int64_t k) {
    return active[static_cast<std::size_t>(flat(n, i, j, k))] != 0;
  };
}

std::vector<double> rough_solution(const Problem& p, std::uint64_t seed) {
  return ramp_and_noise(p, seed, 1, 0.5);
}

Problem system_without_source(const Extents& n, Boundary boundary, const ActiveCell& active,
                              const FaceConductance& conductance) {
  Problem p = make_system(n[0], n[1], n[2], kTolerance);
  assemble(p, boundary, active, conductance);
  return p;
}

Problem system_with_rough_solution(const Extents& n, Boundary boundary, std::uint64_t seed,
                                   const ActiveCell& active, const FaceConductance& conductance,
                                   double scale) {
  Problem p = system_without_source(n, boundary, active, conductance);
  set_right_hand_side(p, rough_solution(p, seed), scale);
  return p;
}

InputSet paper_set(const std::string& name, SetKind kind, Size size, std::uint64_t seed,
                   const std::string& about, std::function<Problem(const Extents&)> make) {
  const Extents n = size == Size::paper ? Extents{256, 256, 256} : Extents{36, 36, 33};
  InputSet s;
  s.name = name;
  s.kind = kind;
  s.size = size;
  s.about = fmt::format("{} in {} x {} x {} cells, seed {}", about, n[0], n[1], n[2], seed);
  s.make = [=] { return make(n); };
  if (size == Size::paper) {
    s.known_solution = [=](const Problem& p) {
      return as_solution(describe<Inputs, Outputs<float>>(), p, rough_solution(p, seed));
    };
    s.truth_source = "manufactured solution";
  }
  return s;
}

InputSet finite_hard_case(const std::string& stress, const std::string& about,
                          std::function<Problem()> make) {
  return hard_case(stress, about, std::move(make), {finite_check(kFiniteWhy)});
}

InputSet zero_hard_case(const std::string& stress, const std::string& about, std::function<Problem()> make,
                        const std::string& why) {
  InputSet s = finite_hard_case(stress, about, std::move(make));
  s.invariants.push_back(zero_solution_check(why));
  return s;
}

Check paper_residual_check() {
  return residual_check(kTolerance, "the paper's tolerance");
}

Check single_equation_check() {
  return local_residual_check(
      kLocalTolerance,
      "a residual that just passes has rms 1e-6 of b's; spread like noise its largest entry is below 6 times "
      "that, and a factor of nearly 20 more is left for residuals that gather at cut cells and walls");
}

AccuracyKnob tolerance_knob() {
  return {"tol", {1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 3e-6, 1e-6}};
}

}  // namespace gpuphys::poisson
