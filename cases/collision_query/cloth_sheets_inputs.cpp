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

/// The relative motion of a pair: u and v along two edges or two sides of a triangle, w between the first end
/// of u and that of v, or the vertex.
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
  std::array<double, 2> depth_in_edges(double t) const {
    const Point u = between(u0, u1, t), v = between(v0, v1, t), w = between(w0, w1, t), n = cross(u, v);
    const double nn = dot(n, n), lengths = std::max(length(u), length(v));
    if (nn == 0) return {0, 1};
    const double s = dot(cross(w, v), n) / nn, r = dot(cross(w, u), n) / nn;
    return {std::min({s, 1 - s, r, 1 - r}), kRounding * std::max(1.0, length(w) * lengths / std::sqrt(nn))};
  }
  /// Likewise inside the triangle, with the margin that belongs to it.
  std::array<double, 2> depth_in_triangle(double t) const {
    constexpr double margin = 0x1p-20;
    const Point u = between(u0, u1, t), v = between(v0, v1, t), w = between(w0, w1, t), n = cross(u, v);
    const double nn = dot(n, n), lengths = std::max(length(u), length(v));
    if (nn == 0) return {0, 1};
    const double s = dot(cross(w, v), n) / nn, r = dot(cross(u, w), n) / nn;
    return {std::min({s, r, 1 - s - r}) + margin,
            kRounding * std::max(1.0, length(w) * lengths / std::sqrt(nn))};
  }
};

// Could two correct FP32 codes disagree about the events of this pair? `depth(t)`: how far inside the
// partners a crossing at t lies, and the uncertainty of that.
template <class Depth>
bool coplanarity_ambiguous(const PairMotion& p, Depth&& depth_at) {
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
    if (std::abs(p.volume(t)) < noise && depth_at(t)[0] > -0.05) return true;
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
      const auto [depth, unsure] = depth_at(at);
      inside += depth > unsure;
      outside += depth < -unsure;
    }
    if (inside != 3 && outside != 3) return true;
    if (inside == 3 && off > kTimeUncertainty) return true;
  }
  return false;
}

bool ambiguous(const PairMotion& edges) {
  return coplanarity_ambiguous(edges, [&](double t) { return edges.depth_in_edges(t); });
}

// Two vertices of which one moves from p0 to p1 as seen from the other.
bool contact_ambiguous(const Point& p0, const Point& p1, double d) {
  constexpr double apart = 1e-5;  // of d: how clear of the distance of contact decisions must be
  const Point q = minus(p1, p0);
  const double size = std::max({length(p0), length(p1), d}), noise = kRounding * size;
  const double start = length(p0), clear = apart * d + noise;
  if (std::abs(start - d) < clear) return true;
  const double qq = dot(q, q), b = dot(p0, q);
  if (start < d || b >= 0) return false;
  const double closest = -b / qq, m = length(between(p0, p1, closest));
  const double slack = std::sqrt(std::max(0.0, d * d - m * m) / qq);
  if (closest - slack > 1 + 1e-3) return false;
  if (std::abs(m - d) < clear) return true;
  if (m > d) return false;
  // The time of entry moves by the rounding of the distance over the speed of approach.
  return noise / (std::sqrt(qq) * std::sqrt(d * d - m * m) / d) > kTimeUncertainty;
}

/// A vertex and an edge: w from the edge's first end to the vertex, u along the edge.
struct EdgeAndVertex {
  Point u0, w0, u1, w1;
  double d;

  Point u(double t) const { return between(u0, u1, t); }
  Point w(double t) const { return between(w0, w1, t); }
  /// Distance from the edge's line.
  double distance(double t) const { return length(cross(w(t), u(t))) / length(u(t)); }
  double foot(double t) const { return dot(w(t), u(t)) / dot(u(t), u(t)); }
  double excess(double t) const {
    const Point c = cross(w(t), u(t));
    return dot(c, c) - d * d * dot(u(t), u(t));
  }
  double slope(double t) const {
    const Point du = minus(u1, u0), dw = minus(w1, w0), p = cross(dw, u(t)), q = cross(w(t), du);
    return 2 * dot(cross(w(t), u(t)), {p[0] + q[0], p[1] + q[1], p[2] + q[2]}) - 2 * d * d * dot(u(t), du);
  }
};

// The zeros of a cubic that takes these values at 0, 1/3, 2/3 and 1, inside (0, 1).
template <class F>
std::vector<double> turns_of(F&& f) {
  const double f0 = f(0.0), f1 = f(1 / 3.0), f2 = f(2 / 3.0), f3 = f(1.0);
  // f = f0 + a s + b s^2 + c s^3 with s = 3 t, by differences.
  const double d1 = f1 - f0, d2 = f2 - 2 * f1 + f0, d3 = f3 - 3 * f2 + 3 * f1 - f0;
  const double c = d3 / 6, b = d2 / 2 - d3 / 2, a = d1 - d2 / 2 + d3 / 3;
  std::vector<double> ends{0.0};
  const double discriminant = b * b - 3 * c * a;
  if (discriminant > 0) {
    const double q = -(b + std::copysign(std::sqrt(discriminant), b));
    for (const double s : {q / (3 * c), a / q}) {
      if (s > 0 && s < 3) ends.push_back(s / 3);
    }
  }
  ends.push_back(1.0);
  std::sort(ends.begin(), ends.end());
  std::vector<double> zeros;
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    double low = ends[k], high = ends[k + 1];
    const bool rising = f(low) < 0;
    if (rising == (f(high) < 0)) continue;
    for (int step = 0; step < 40; ++step) {
      const double middle = 0.5 * (low + high);
      ((f(middle) < 0) == rising ? low : high) = middle;
    }
    zeros.push_back(0.5 * (low + high));
  }
  return zeros;
}

bool contact_ambiguous(const EdgeAndVertex& p) {
  const double longest = std::max(length(p.u0), length(p.u1));
  if (longest == 0) return false;
  const double lengths = std::max(length(p.w0), length(p.w1)) * longest;
  const auto noise = [&](double t) { return kRounding * std::max(p.d, lengths / length(p.u(t))); };
  const auto unsure_of_foot = [&](double t) {
    return 1e-5 + kRounding * std::max(1.0, lengths / dot(p.u(t), p.u(t)));
  };
  std::vector<double> ends = turns_of([&](double t) { return p.slope(t); });
  ends.insert(ends.begin(), 0.0);
  ends.push_back(1.0);
  for (const double t : ends) {
    if (length(p.u(t)) < 1e-5 * longest) return true;
    const double foot = p.foot(t);
    if (std::abs(p.distance(t) - p.d) < 1e-5 * p.d + noise(t) && foot > -0.05 && foot < 1.05) return true;
  }
  // Contact from the start: the foot decides.
  if (p.distance(0) < p.d && std::min(std::abs(p.foot(0)), std::abs(p.foot(0) - 1)) < unsure_of_foot(0))
    return true;
  for (std::size_t k = 0; k + 1 < ends.size(); ++k) {
    double low = ends[k], high = ends[k + 1];
    if (p.excess(low) <= 0 || p.excess(high) > 0) continue;
    for (int step = 0; step < 50; ++step) {
      const double middle = 0.5 * (low + high);
      (p.excess(middle) > 0 ? low : high) = middle;
    }
    const double t = 0.5 * (low + high), around = 1e-4;
    const double speed = (p.distance(t - around) - p.distance(t + around)) / (2 * around);
    const double off = noise(t) / std::abs(speed), shift = off < 0.05 ? off : 0.05;
    int beside = 0, beyond = 0;
    for (const double at : {t - shift, t, t + shift}) {
      const double depth = std::min(p.foot(at), 1 - p.foot(at));
      beside += depth > unsure_of_foot(at);
      beyond += depth < -unsure_of_foot(at);
    }
    if (beside != 3 && beyond != 3) return true;
    if (beside == 3 && off > kTimeUncertainty) return true;
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
    return static_cast<std::int64_t>(std::floor((x - low_[d]) / size_));
  }
  template <class F>
  void visit(const Box& b, F&& f) const {
    // A box that asks may reach beyond the columns.
    const auto within = [&](float x, std::size_t d) {
      return std::clamp<std::int64_t>(column(x, d), 0, n_[d] - 1);
    };
    for (std::int64_t i = within(b.low[0], 0); i <= within(b.high[0], 0); ++i) {
      for (std::int64_t j = within(b.low[1], 1); j <= within(b.high[1], 1); ++j)
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
  m.start = {da + 0.37 * l + p.shear * l * std::sin(turn * db / n) + p.jitter * noise(kJitterStream, 0),
             db + 0.21 * l + p.jitter * noise(kJitterStream, 1),
             l * p.offset + wave + p.jitter * noise(kJitterStream, 2)};
  const double drive =
      lift * (l % 2 == 0 ? 1 : -1) * std::sin(turn * (da + 0.5 * db) / p.drive_period + lift_phase * l);
  m.end = {m.start[0] + lateral * noise(kLateralStream, 0), m.start[1] + lateral * noise(kLateralStream, 1),
           m.start[2] + drive + lift_noise * noise(kLiftStream, 0)};
  return m;
}

namespace {

/// Primitives of a mesh: corners of each one after the other; without corners, the vertices themselves.
struct Group {
  std::int64_t count;
  int each;
  const std::int32_t* corners;

  std::int32_t corner(std::size_t item, int k) const {
    if (corners == nullptr) return static_cast<std::int32_t>(item);
    return corners[static_cast<std::size_t>(each) * item + static_cast<std::size_t>(k)];
  }
};

using Positions = std::vector<std::array<float, 3>>;

// Draws all vertices, and again those that `redraw(i, j, round)` names of an ambiguous pair of `asking` item
// i and `others` item j, until no pair is ambiguous. Where the groups are one, i < j.
template <class Ambiguous, class Redraw>
void settle_pairs(Positions& x0, Positions& x1, std::int64_t vertices, const DrawVertex& draw,
                  const Group& asking, const Group& others, float margin, Ambiguous&& ambiguous_pair,
                  Redraw&& redraw) {
  const std::size_t n = static_cast<std::size_t>(vertices);
  const bool one_group = asking.corners == others.corners;
  x0.resize(n);
  x1.resize(n);
  std::vector<int> attempt(n, 0);
  std::vector<char> moved(n, 1);
  const auto box_of = [&](const Group& group, std::size_t item, float wider) {
    Box box;
    for (std::size_t d = 0; d < 3; ++d) {
      const std::size_t first = static_cast<std::size_t>(group.corner(item, 0));
      box.low[d] = box.high[d] = x0[first][d];
      for (int k = 0; k < group.each; ++k) {
        const std::size_t v = static_cast<std::size_t>(group.corner(item, k));
        box.low[d] = std::min({box.low[d], x0[v][d], x1[v][d]});
        box.high[d] = std::max({box.high[d], x0[v][d], x1[v][d]});
      }
      box.low[d] -= wider;
      box.high[d] += wider;
    }
    return box;
  };
  const auto touched = [&](const Group& group, std::size_t item) {
    for (int k = 0; k < group.each; ++k) {
      if (moved[static_cast<std::size_t>(group.corner(item, k))]) return true;
    }
    return false;
  };
  const auto share_a_vertex = [&](std::size_t i, std::size_t j) {
    for (int k = 0; k < asking.each; ++k) {
      for (int l = 0; l < others.each; ++l) {
        if (asking.corner(i, k) == others.corner(j, l)) return true;
      }
    }
    return false;
  };
  std::vector<Box> boxes(static_cast<std::size_t>(others.count));
  for (int round = 0; round < 100; ++round) {
    parallel_for(vertices, [&](std::int64_t i) {
      const std::size_t v = static_cast<std::size_t>(i);
      if (!moved[v]) return;
      const Motion motion = draw(i, attempt[v]);
      for (std::size_t d = 0; d < 3; ++d) {
        x0[v][d] = static_cast<float>(motion.start[d]);
        x1[v][d] = static_cast<float>(motion.end[d]);
      }
    });
    if (others.count == 0) return;
    for (std::size_t e = 0; e < boxes.size(); ++e) boxes[e] = box_of(others, e, 0);
    const Columns columns(boxes);
    const auto bad = std::make_unique<std::atomic<char>[]>(n);
    std::atomic<bool> any = false;
    parallel_for(asking.count, [&](std::int64_t index) {
      const std::size_t i = static_cast<std::size_t>(index);
      const bool asks = touched(asking, i);
      if (one_group && !asks) return;
      const Box box = box_of(asking, i, margin);
      columns.candidates(box, [&](std::size_t j) {
        if (one_group && (i == j || (j < i && touched(others, j)))) return;
        if (!overlap(box, boxes[j]) || share_a_vertex(i, j)) return;
        if (!one_group && !asks && !touched(others, j)) return;
        const std::size_t first = one_group ? std::min(i, j) : i, second = one_group ? std::max(i, j) : j;
        if (ambiguous_pair(first, second)) {
          bad[static_cast<std::size_t>(redraw(first, second, round))] = 1;
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
  throw Error(ExitCode::internal, "cloth_sheets: ambiguous pairs remain after 100 rounds");
}

}  // namespace

void settle(EdgeMesh& mesh, std::int64_t vertices, const DrawVertex& draw) {
  const Group edges{static_cast<std::int64_t>(mesh.edges.size()), 2,
                    mesh.edges.empty() ? nullptr : mesh.edges.front().data()};
  settle_pairs(
      mesh.x0, mesh.x1, vertices, draw, edges, edges, 0,
      [&](std::size_t i, std::size_t j) { return ambiguous(pair_motion(mesh, i, j)); },
      // In turn each of the four: where one end lies on the other edge, moving the wrong vertex is no cure.
      [&](std::size_t i, std::size_t j, int round) {
        return edges.corner(round % 4 < 2 ? i : j, round % 2);
      });
}

void settle(Mesh& mesh, std::int64_t vertices, double d, const DrawVertex& draw) {
  const int corners = mesh.corners;
  const Group points{vertices, 1, nullptr};
  const Group others = corners == 1 ? points
                                    : Group{static_cast<std::int64_t>(mesh.primitives.size()) / corners,
                                            corners, mesh.primitives.data()};
  const auto seen = [&](const std::vector<std::array<float, 3>>& x, std::int32_t from, std::int32_t to) {
    return minus(wide(x[static_cast<std::size_t>(to)]), wide(x[static_cast<std::size_t>(from)]));
  };
  const auto ambiguous_pair = [&](std::size_t i, std::size_t j) {
    const std::int32_t vertex = static_cast<std::int32_t>(i), a = others.corner(j, 0);
    const Point w0 = seen(mesh.x0, a, vertex), w1 = seen(mesh.x1, a, vertex);
    if (corners == 1) return contact_ambiguous(w0, w1, d);
    const std::int32_t b = others.corner(j, 1);
    const Point u0 = seen(mesh.x0, a, b), u1 = seen(mesh.x1, a, b);
    if (corners == 2) return contact_ambiguous(EdgeAndVertex{u0, w0, u1, w1, d});
    const std::int32_t c = others.corner(j, 2);
    const PairMotion p{u0, seen(mesh.x0, a, c), w0, u1, seen(mesh.x1, a, c), w1};
    return coplanarity_ambiguous(p, [&](double t) { return p.depth_in_triangle(t); });
  };
  settle_pairs(mesh.x0, mesh.x1, vertices, draw, points, others,
               corners == 3 ? 1e-4f : static_cast<float>(1.01 * d), ambiguous_pair,
               [&](std::size_t i, std::size_t j, int round) {
                 const int turn = round % (corners + 1);
                 return turn == 0 ? static_cast<std::int32_t>(i) : others.corner(j, turn - 1);
               });
}

Mesh sheet_mesh(const Parameters& p, int corners, double d) {
  const std::int64_t n = p.n, per_sheet = n * n, vertices = kSheets * per_sheet;
  const std::vector<std::int64_t> vertex_at = random_order(p.seed, kVertexOrderStream, vertices);
  Mesh mesh;
  mesh.corners = corners;
  if (corners > 1) {
    std::vector<std::int32_t> place(vertex_at.size());
    for (std::size_t i = 0; i < vertex_at.size(); ++i)
      place[static_cast<std::size_t>(vertex_at[i])] = static_cast<std::int32_t>(i);
    std::vector<std::array<std::int32_t, 3>> lattice;
    for (int l = 0; l < kSheets; ++l) {
      for (std::int64_t a = 0; a < n; ++a) {
        for (std::int64_t b = 0; b < n; ++b) {
          const auto vertex = [&](std::int64_t da, std::int64_t db) {
            return place[static_cast<std::size_t>(l * per_sheet + (a + da) * n + b + db)];
          };
          const bool below = a + 1 < n, right = b + 1 < n;
          if (corners == 2) {
            if (below) lattice.push_back({vertex(0, 0), vertex(1, 0), 0});
            if (right) lattice.push_back({vertex(0, 0), vertex(0, 1), 0});
            if (below && right) lattice.push_back({vertex(0, 0), vertex(1, 1), 0});
          } else if (below && right) {
            lattice.push_back({vertex(0, 0), vertex(1, 0), vertex(1, 1)});
            lattice.push_back({vertex(0, 0), vertex(1, 1), vertex(0, 1)});
          }
        }
      }
    }
    for (const std::int64_t e :
         random_order(p.seed, kEdgeOrderStream, static_cast<std::int64_t>(lattice.size()))) {
      std::array<std::int32_t, 3> c = lattice[static_cast<std::size_t>(e)];
      // One of the orders of the corners: which comes first, and whether the others are exchanged.
      const std::uint64_t bits = random_bits(p.seed, kFlipStream, static_cast<std::uint64_t>(e));
      if (corners == 3)
        std::rotate(c.begin(), c.begin() + static_cast<std::ptrdiff_t>((bits >> 3) % 3), c.end());
      if (bits >> 63)
        std::swap(c[static_cast<std::size_t>(corners - 2)], c[static_cast<std::size_t>(corners - 1)]);
      mesh.primitives.insert(mesh.primitives.end(), c.begin(), c.begin() + corners);
    }
  }
  settle(mesh, vertices, d, [&](std::int64_t v, int attempt) {
    const std::int64_t id = vertex_at[static_cast<std::size_t>(v)];
    return lattice_vertex(p, static_cast<int>(id / per_sheet), id / n % n, id % n, attempt);
  });
  return mesh;
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
