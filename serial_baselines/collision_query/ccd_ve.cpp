// Serial baseline of ccd_ve, written from cases/collision_query/ccd_ve.md alone: a uniform grid finds the
// pairs, one pair at a time. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cases/collision_query/ccd_ve.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/collision_query/coplanarity.hpp"
#include "serial_baselines/collision_query/swept_cells.hpp"

namespace gpuphys::ccd_ve {

using serial::Moving;
using serial::Vec3;

/// A vertex seen from the first end of an edge (w), and the edge (u). Lengths of w and d are in units of
/// 2^at_w m, those of u in units of 2^at_u m.
template <class Real>
struct VertexAndEdge {
  Moving<Real> w, u;
  Real d;
  int at_w, at_u;

  VertexAndEdge(const Inputs& in, std::int32_t vertex, std::int32_t a, std::int32_t b)
      : w(serial::relative_motion<Real>(in.x0, in.x1, a, vertex)),
        u(serial::relative_motion<Real>(in.x0, in.x1, a, b)),
        d(static_cast<Real>(in.d)),
        at_w(std::max({exponent_of(w.start), exponent_of(w.change), std::ilogb(d)})),
        at_u(std::max(exponent_of(u.start), exponent_of(u.change))) {
    w = {std::ldexp(Real(1), -at_w) * w.start, std::ldexp(Real(1), -at_w) * w.change};
    u = {std::ldexp(Real(1), -at_u) * u.start, std::ldexp(Real(1), -at_u) * u.change};
    d = std::ldexp(d, -at_w);
  }

  /// Is the vertex within d of the edge's line: g(t) <= 0?
  bool near(Real t) const {
    const Vec3<Real> along = u.at(t), c = cross(w.at(t), along);
    return dot(c, c) <= d * d * dot(along, along);
  }

  /// Is the vertex's foot on the edge, and the edge not vanishing?
  bool beside(Real t) const {
    const Vec3<Real> along = u.at(t);
    const Real uu = dot(along, along), wu = dot(w.at(t), along);
    const Real longest = std::max(dot(u.start, u.start), dot(u.at(1), u.at(1)));
    return uu > Real(0x1p-40) * longest && wu >= 0 && wu <= std::ldexp(uu, at_u - at_w);
  }

  /// g'.
  serial::Cubic<Real> slope() const {
    // w x u = c0 + c1 t + c2 t^2, and |u|^2 likewise.
    const Vec3<Real> c0 = cross(w.start, u.start), c2 = cross(w.change, u.change);
    const Vec3<Real> c1 = cross(w.start, u.change) + cross(w.change, u.start);
    const Real dd = d * d;
    serial::Cubic<Real> f;
    f.c[0] = 2 * dot(c0, c1) - 2 * dd * dot(u.start, u.change);
    f.c[1] = 2 * (dot(c1, c1) + 2 * dot(c0, c2) - dd * dot(u.change, u.change));
    f.c[2] = 6 * dot(c1, c2);
    f.c[3] = 4 * dot(c2, c2);
    return f;
  }
};

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x0.shape[0], m = in.edges.shape[0];
    std::vector<serial::SweptBox> boxes;  // of the vertices, then of the edges
    boxes.reserve(static_cast<std::size_t>(n + m));
    for (std::int64_t i = 0; i < n; ++i) {
      out.toi(i) = 1;
      boxes.push_back(serial::widened(
          serial::swept_box(in.x0, in.x1, std::array{static_cast<std::int32_t>(i)}), 1.001f * in.d));
    }
    for (std::int64_t e = 0; e < m; ++e)
      boxes.push_back(serial::swept_box(in.x0, in.x1, std::array{in.edges(e, 0), in.edges(e, 1)}));
    const serial::SweptCells cells(std::move(boxes));
    cells.each_overlap(
        [&](std::int64_t i, std::int64_t j) {
          const std::int32_t vertex = static_cast<std::int32_t>(i), a = in.edges(j - n, 0),
                             b = in.edges(j - n, 1);
          if (vertex == a || vertex == b) return;
          out.toi(i) = std::min(out.toi(i), first_contact(VertexAndEdge<Real>(in, vertex, a, b)));
        },
        n);
  }

 private:
  // 1 if there is none.
  static Real first_contact(const VertexAndEdge<Real>& pair) {
    if (pair.near(0) && pair.beside(0)) return 0;
    // g is monotone between the zeros of its derivative.
    std::array<Real, 5> ends{};
    std::size_t count = 1;
    serial::each_crossing(pair.slope(), [&](Real t) {
      ends[count++] = t;
      return false;
    });
    ends[count++] = 1;
    for (std::size_t k = 0; k + 1 < count; ++k) {
      Real low = ends[k], high = ends[k + 1];
      if (pair.near(low) || !pair.near(high)) continue;
      for (int step = 0; step < serial::kBisections; ++step) {
        const Real middle = (low + high) / 2;
        if (pair.near(middle)) {
          high = middle;
        } else {
          low = middle;
        }
      }
      const Real t = (low + high) / 2;
      if (pair.beside(t)) return t;
    }
    return 1;
  }
};

}  // namespace gpuphys::ccd_ve

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(ccd_ve, ccd_ve::Baseline)
}
