#include "cases/collision_query/cloth_sheets_inputs.hpp"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>
#include <numbers>
#include <numeric>

#include "core/base/error.hpp"
#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::cloth_sheets {
namespace {

// Random streams. Attempt k > 0 of a vertex takes 100 k more.
constexpr std::uint64_t kJitterStream = 0, kLateralStream = 1, kLiftStream = 2;
constexpr std::uint64_t kVertexOrderStream = 99, kEdgeOrderStream = 98, kFlipStream = 97;

Point minus(const Point& p, const Point& q) {
  return {p[0] - q[0], p[1] - q[1], p[2] - q[2]};
}
Point cross(const Point& p, const Point& q) {
  return {p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]};
}
double dot(const Point& p, const Point& q) {
  return p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
}
double length(const Point& p) {
  return std::sqrt(dot(p, p));
}
Point between(const Point& p, const Point& q, double t) {
  return {p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1]), p[2] + t * (q[2] - p[2])};
}
Point wide(const std::array<float, 3>& p) {
  return {p[0], p[1], p[2]};
}

// How far an FP32 evaluation may be off, in units of the unit roundoff: several times what is seen.
constexpr double kRounding = 16 * 0x1p-24;
// The largest uncertainty of the time of an event that is kept.
constexpr double kTimeUncertainty = 5e-4;

/// The relative motion of two edges: u and v along them, w between their first ends.
struct PairMotion {
  Point u0, v0, w0, u1, v1, w1;

  /// The pair is coplanar where this vanishes.
  double volume(double t) const {
    return dot(between(w0, w1, t), cross(between(u0, u1, t), between(v0, v1, t)));
  }
  double slope(double t) const {
    const Point u = between(u0, u1, t), v = between(v0, v1, t), w = between(w0, w1, t);
    return dot(minus(w1, w0), cross(u, v)) + dot(w, cross(minus(u1, u0), v)) +
           dot(w, cross(u, minus(v1, v0)));
  }
  /// How far inside both edges the crossing lies at t: negative outside. Second: its uncertainty.
  std::array<double, 2> depth(double t) const {
    const Point u = between(u0, u1, t), v = between(v0, v1, t), w = between(w0, w1, t), n = cross(u, v);
    const double nn = dot(n, n), lengths = std::max(length(u), length(v));
    if (nn == 0) return {0, 1};
    const double s = dot(cross(w, v), n) / nn, r = dot(cross(w, u), n) / nn;
    return {std::min({s, 1 - s, r, 1 - r}), kRounding * std::max(1.0, length(w) * lengths / std::sqrt(nn))};
  }
};

// Could two correct FP32 codes disagree about the events of this pair?
bool ambiguous(const PairMotion& p) {
  const double scale = std::max(length(p.u0), length(p.u1)) * std::max(length(p.v0), length(p.v1)) *
                       std::max(length(p.w0), length(p.w1));
  const double noise = kRounding * scale;
  // The cubic's slope is a parabola: three values give it.
  const double g0 = p.slope(0), gm = p.slope(0.5), g1 = p.slope(1);
  const double q2 = 2 * (g0 - 2 * gm + g1), q1 = g1 - g0 - q2;
  std::vector<double> ends{0.0};
  const double discriminant = q1 * q1 - 4 * q2 * g0;
  if (discriminant > 0) {
    const double q = -0.5 * (q1 + std::copysign(std::sqrt(discriminant), q1));
    for (const double t : {q / q2, g0 / q}) {
      if (t > 0 && t < 1) ends.push_back(t);
    }
  }
  ends.push_back(1.0);
  std::sort(ends.begin(), ends.end());
  for (const double t : ends) {
    if (std::abs(p.volume(t)) < noise && p.depth(t)[0] > -0.05) return true;
  }
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    double low = ends[k], high = ends[k + 1];
    const bool rising = p.volume(low) < 0;
    if (rising == (p.volume(high) < 0)) continue;
    for (int step = 0; step < 50; ++step) {
      const double middle = 0.5 * (low + high);
      ((p.volume(middle) < 0) == rising ? low : high) = middle;
    }
    const double t = 0.5 * (low + high), off = noise / std::abs(p.slope(t));
    const double shift = off < 0.05 ? off : 0.05;
    int inside = 0, outside = 0;
    for (const double at : {t - shift, t, t + shift}) {
      const auto [depth, unsure] = p.depth(at);
      inside += depth > unsure;
      outside += depth < -unsure;
    }
    if (inside != 3 && outside != 3) return true;
    if (inside == 3 && off > kTimeUncertainty) return true;
  }
  return false;
}

struct Box {
  std::array<float, 3> low, high;
};

bool overlap(const Box& p, const Box& q) {
  for (std::size_t d = 0; d < 3; ++d) {
    if (p.low[d] > q.high[d] || q.low[d] > p.high[d]) return false;
  }
  return true;
}

// Boxes in columns over x and y, each in every column it touches.
class Columns {
 public:
  explicit Columns(const std::vector<Box>& boxes) {
    double sum = 0;
    high_ = low_ = {boxes[0].low[0], boxes[0].low[1]};
    for (const Box& b : boxes) {
      for (std::size_t d = 0; d < 2; ++d) {
        sum += 0.5 * (static_cast<double>(b.high[d]) - b.low[d]);
        low_[d] = std::min(low_[d], static_cast<double>(b.low[d]));
        high_[d] = std::max(high_[d], static_cast<double>(b.high[d]));
      }
    }
    const double count = static_cast<double>(boxes.size());
    const double area = (high_[0] - low_[0]) * (high_[1] - low_[1]);
    size_ = std::max(
        {sum / count, std::sqrt(area / count), 1e-3 * (high_[0] - low_[0] + high_[1] - low_[1]), 1e-30});
    for (std::size_t d = 0; d < 2; ++d) n_[d] = column(high_[d], d) + 1;
    first_.assign(static_cast<std::size_t>(n_[0] * n_[1] + 1), 0);
    for (const Box& b : boxes) visit(b, [&](std::size_t c) { ++first_[c + 1]; });
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    items_.resize(static_cast<std::size_t>(first_.back()));
    std::vector<std::int64_t> next(first_);
    for (std::size_t i = 0; i < boxes.size(); ++i)
      visit(boxes[i], [&](std::size_t c) { items_[static_cast<std::size_t>(next[c]++)] = i; });
  }

  /// Calls f(j) for every box that shares a column with `b`, possibly more than once.
  template <class F>
  void candidates(const Box& b, F&& f) const {
    visit(b, [&](std::size_t c) {
      for (std::int64_t k = first_[c]; k < first_[c + 1]; ++k) f(items_[static_cast<std::size_t>(k)]);
    });
  }

 private:
  std::int64_t column(double x, std::size_t d) const {
    return static_cast<std::int64_t>((x - low_[d]) / size_);
  }
  template <class F>
  void visit(const Box& b, F&& f) const {
    for (std::int64_t i = column(b.low[0], 0); i <= column(b.high[0], 0); ++i) {
      for (std::int64_t j = column(b.low[1], 1); j <= column(b.high[1], 1); ++j)
        f(static_cast<std::size_t>(i * n_[1] + j));
    }
  }
  std::array<double, 2> low_, high_;
  double size_ = 1;
  std::array<std::int64_t, 2> n_{};
  std::vector<std::int64_t> first_;
  std::vector<std::size_t> items_;
};

PairMotion pair_motion(const EdgeMesh& m, std::size_t i, std::size_t j) {
  const auto at = [](const std::vector<std::array<float, 3>>& x, std::int32_t v) {
    return wide(x[static_cast<std::size_t>(v)]);
  };
  const auto [a, b] = m.edges[i];
  const auto [c, d] = m.edges[j];
  return {minus(at(m.x0, b), at(m.x0, a)), minus(at(m.x0, d), at(m.x0, c)), minus(at(m.x0, c), at(m.x0, a)),
          minus(at(m.x1, b), at(m.x1, a)), minus(at(m.x1, d), at(m.x1, c)), minus(at(m.x1, c), at(m.x1, a))};
}

}  // namespace

std::vector<std::int64_t> random_order(std::uint64_t seed, std::uint64_t stream, std::int64_t count) {
  std::vector<std::pair<std::uint64_t, std::int64_t>> keys(static_cast<std::size_t>(count));
  for (std::int64_t i = 0; i < count; ++i)
    keys[static_cast<std::size_t>(i)] = {random_bits(seed, stream, static_cast<std::uint64_t>(i)), i};
  std::sort(keys.begin(), keys.end());
  std::vector<std::int64_t> order;
  order.reserve(keys.size());
  for (const auto& key : keys) order.push_back(key.second);
  return order;
}

Motion lattice_vertex(const Parameters& p, int l, std::int64_t a, std::int64_t b, int attempt) {
  constexpr double turn = 2 * std::numbers::pi;
  constexpr double lateral = 0.1, lift = 0.7, lift_noise = 0.05, lift_phase = 0.9;
  const double n = static_cast<double>(p.n), da = static_cast<double>(a), db = static_cast<double>(b);
  const std::uint64_t id = static_cast<std::uint64_t>((l * p.n + a) * p.n + b);
  const auto noise = [&](std::uint64_t stream, std::uint64_t d) {
    return uniform11(p.seed, stream + 100 * static_cast<std::uint64_t>(attempt), 3 * id + d);
  };
  const double wave =
      p.waviness * std::sin(turn * p.wave_a * da / n + p.phase_step * l) * std::cos(turn * p.wave_b * db / n);
  Motion m;
  m.start = {da + 0.37 * l + p.jitter * noise(kJitterStream, 0),
             db + 0.21 * l + p.jitter * noise(kJitterStream, 1),
             l * p.offset + wave + p.jitter * noise(kJitterStream, 2)};
  const double drive =
      lift * (l % 2 == 0 ? 1 : -1) * std::sin(turn * (da + 0.5 * db) / p.drive_period + lift_phase * l);
  m.end = {m.start[0] + lateral * noise(kLateralStream, 0), m.start[1] + lateral * noise(kLateralStream, 1),
           m.start[2] + drive + lift_noise * noise(kLiftStream, 0)};
  return m;
}

void settle(EdgeMesh& mesh, std::int64_t vertices, const DrawVertex& draw) {
  const std::size_t n = static_cast<std::size_t>(vertices), m = mesh.edges.size();
  mesh.x0.resize(n);
  mesh.x1.resize(n);
  std::vector<int> attempt(n, 0);
  std::vector<char> moved(n, 1);
  std::vector<Box> boxes(m);
  for (int round = 0; round < 100; ++round) {
    parallel_for(vertices, [&](std::int64_t i) {
      const std::size_t v = static_cast<std::size_t>(i);
      if (!moved[v]) return;
      const Motion motion = draw(i, attempt[v]);
      for (std::size_t d = 0; d < 3; ++d) {
        mesh.x0[v][d] = static_cast<float>(motion.start[d]);
        mesh.x1[v][d] = static_cast<float>(motion.end[d]);
      }
    });
    for (std::size_t e = 0; e < m; ++e) {
      const std::size_t a = static_cast<std::size_t>(mesh.edges[e][0]);
      const std::size_t b = static_cast<std::size_t>(mesh.edges[e][1]);
      for (std::size_t d = 0; d < 3; ++d) {
        boxes[e].low[d] = std::min({mesh.x0[a][d], mesh.x0[b][d], mesh.x1[a][d], mesh.x1[b][d]});
        boxes[e].high[d] = std::max({mesh.x0[a][d], mesh.x0[b][d], mesh.x1[a][d], mesh.x1[b][d]});
      }
    }
    if (m == 0) return;
    const Columns columns(boxes);
    const auto touched = [&](std::size_t e) {
      return moved[static_cast<std::size_t>(mesh.edges[e][0])] ||
             moved[static_cast<std::size_t>(mesh.edges[e][1])];
    };
    const auto bad = std::make_unique<std::atomic<char>[]>(n);
    std::atomic<bool> any = false;
    parallel_for(static_cast<std::int64_t>(m), [&](std::int64_t index) {
      const std::size_t i = static_cast<std::size_t>(index);
      if (!touched(i)) return;
      columns.candidates(boxes[i], [&](std::size_t j) {
        if (i == j || (j < i && touched(j)) || !overlap(boxes[i], boxes[j])) return;
        const auto [a, b] = mesh.edges[i];
        const auto [c, d] = mesh.edges[j];
        if (a == c || a == d || b == c || b == d) return;
        if (ambiguous(pair_motion(mesh, std::min(i, j), std::max(i, j)))) {
          // In turn each of the four: where one end lies on the other edge, moving the wrong vertex is no
          // cure.
          const auto& edge = mesh.edges[round % 4 < 2 ? std::min(i, j) : std::max(i, j)];
          bad[static_cast<std::size_t>(edge[static_cast<std::size_t>(round % 2)])] = 1;
          any = true;
        }
      });
    });
    if (!any) return;
    for (std::size_t v = 0; v < n; ++v) {
      moved[v] = bad[v];
      attempt[v] += bad[v];
    }
  }
  throw Error(ExitCode::internal, "cloth_sheets: ambiguous edge pairs remain after 100 rounds");
}

EdgeMesh edge_mesh(const Parameters& p) {
  const std::int64_t n = p.n, per_sheet = n * n, vertices = kSheets * per_sheet;
  const std::vector<std::int64_t> vertex_at = random_order(p.seed, kVertexOrderStream, vertices);
  std::vector<std::int32_t> place(vertex_at.size());
  for (std::size_t i = 0; i < vertex_at.size(); ++i)
    place[static_cast<std::size_t>(vertex_at[i])] = static_cast<std::int32_t>(i);
  std::vector<std::array<std::int32_t, 2>> lattice;
  const auto vertex = [&](int l, std::int64_t a, std::int64_t b) {
    return place[static_cast<std::size_t>(l * per_sheet + a * n + b)];
  };
  for (int l = 0; l < kSheets; ++l) {
    for (std::int64_t a = 0; a < n; ++a) {
      for (std::int64_t b = 0; b < n; ++b) {
        if (a + 1 < n) lattice.push_back({vertex(l, a, b), vertex(l, a + 1, b)});
        if (b + 1 < n) lattice.push_back({vertex(l, a, b), vertex(l, a, b + 1)});
        if (a + 1 < n && b + 1 < n) lattice.push_back({vertex(l, a, b), vertex(l, a + 1, b + 1)});
      }
    }
  }
  EdgeMesh mesh;
  for (const std::int64_t e :
       random_order(p.seed, kEdgeOrderStream, static_cast<std::int64_t>(lattice.size()))) {
    std::array<std::int32_t, 2> ends = lattice[static_cast<std::size_t>(e)];
    if (random_bits(p.seed, kFlipStream, static_cast<std::uint64_t>(e)) >> 63) std::swap(ends[0], ends[1]);
    mesh.edges.push_back(ends);
  }
  settle(mesh, vertices, [&](std::int64_t v, int attempt) {
    const std::int64_t id = vertex_at[static_cast<std::size_t>(v)];
    return lattice_vertex(p, static_cast<int>(id / per_sheet), id / n % n, id % n, attempt);
  });
  return mesh;
}

}  // namespace gpuphys::cloth_sheets
