// Serial baseline of ccd_vf, written from cases/collision_query/ccd_vf.md alone: a uniform grid finds the
// pairs, one pair at a time. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <vector>

#include "cases/collision_query/ccd_vf.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/collision_query/coplanarity.hpp"
#include "serial_baselines/collision_query/swept_cells.hpp"

namespace gpuphys::ccd_vf {

using serial::Moving;
using serial::Vec3;

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x0.shape[0], m = in.tris.shape[0];
    std::vector<serial::SweptBox> boxes;  // of the vertices, then of the triangles
    boxes.reserve(static_cast<std::size_t>(n + m));
    for (std::int64_t i = 0; i < n; ++i) {
      out.toi(i) = 1;
      boxes.push_back(serial::swept_box(in.x0, in.x1, std::array{static_cast<std::int32_t>(i)}));
    }
    for (std::int64_t f = 0; f < m; ++f) {
      const serial::SweptBox box =
          serial::swept_box(in.x0, in.x1, std::array{in.tris(f, 0), in.tris(f, 1), in.tris(f, 2)});
      // The margin of s and r reaches a little beyond the triangle.
      float extent = 0;
      for (std::size_t d = 0; d < 3; ++d) extent = std::max(extent, box.high[d] - box.low[d]);
      boxes.push_back(serial::widened(box, 8 * static_cast<float>(kMargin) * extent));
    }
    const serial::SweptCells cells(std::move(boxes));
    cells.each_overlap(
        [&](std::int64_t i, std::int64_t j) {
          const std::int32_t vertex = static_cast<std::int32_t>(i);
          const std::int32_t a = in.tris(j - n, 0), b = in.tris(j - n, 1), c = in.tris(j - n, 2);
          if (vertex == a || vertex == b || vertex == c) return;
          out.toi(i) = std::min(out.toi(i), first_impact(in, vertex, a, b, c));
        },
        n);
  }

 private:
  static constexpr Real kMargin = Real(0x1p-20);

  // 1 if there is none.
  static Real first_impact(const Inputs& in, std::int32_t vertex, std::int32_t a, std::int32_t b,
                           std::int32_t c) {
    const auto seen_from_a = [&](std::int32_t to) {
      return serial::relative_motion<Real>(in.x0, in.x1, a, to);
    };
    const Moving<Real> u = seen_from_a(b), v = seen_from_a(c), w = seen_from_a(vertex);
    Real impact = 1;
    serial::each_crossing(serial::triple_product(w, u, v), [&](Real t) {
      if (!inside(w.at(t), u.at(t), v.at(t))) return false;
      impact = t;
      return true;
    });
    return impact;
  }

  // Does the point w of the plane of u and v lie in their triangle?
  static bool inside(Vec3<Real> w, Vec3<Real> u, Vec3<Real> v) {
    const serial::Fractions<Real> at = serial::fractions(w, u, v);
    const Real s = at.s_times, r = at.r_times;
    return !at.parallel && s >= -kMargin * at.nn && r >= -kMargin * at.nn && s + r <= (1 + kMargin) * at.nn;
  }
};

}  // namespace gpuphys::ccd_vf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(ccd_vf, ccd_vf::Baseline)
}
