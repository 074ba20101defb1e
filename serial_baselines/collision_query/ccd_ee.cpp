// Serial baseline of ccd_ee, written from cases/collision_query/ccd_ee.md alone: a uniform grid finds the
// pairs, one pair at a time. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <vector>

#include "cases/collision_query/ccd_ee.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/collision_query/coplanarity.hpp"
#include "serial_baselines/collision_query/swept_cells.hpp"

namespace gpuphys::ccd_ee {

using serial::Moving;
using serial::Vec3;

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t m = in.edges.shape[0];
    std::vector<serial::SweptBox> boxes;
    boxes.reserve(static_cast<std::size_t>(m));
    for (std::int64_t e = 0; e < m; ++e) {
      out.toi(e) = 1;
      boxes.push_back(serial::swept_box(in.x0, in.x1, std::array{in.edges(e, 0), in.edges(e, 1)}));
    }
    const serial::SweptCells cells(std::move(boxes));
    cells.each_overlap([&](std::int64_t i, std::int64_t j) {
      if (share_a_vertex(in, i, j)) return;
      const Real t = first_impact(in, std::min(i, j), std::max(i, j));
      record(out, i, t);
      record(out, j, t);
    });
  }

 private:
  static bool share_a_vertex(const Inputs& in, std::int64_t i, std::int64_t j) {
    const std::int32_t a = in.edges(i, 0), b = in.edges(i, 1), c = in.edges(j, 0), d = in.edges(j, 1);
    return a == c || a == d || b == c || b == d;
  }

  static void record(const Outputs<Real>& out, std::int64_t e, Real t) {
    if (t < out.toi(e)) out.toi(e) = t;
  }

  // 1 if there is none.
  static Real first_impact(const Inputs& in, std::int64_t i, std::int64_t j) {
    const std::int32_t a = in.edges(i, 0), b = in.edges(i, 1), c = in.edges(j, 0), d = in.edges(j, 1);
    const auto relative = [&](std::int32_t from, std::int32_t to) {
      return serial::relative_motion<Real>(in.x0, in.x1, from, to);
    };
    const Moving<Real> u = relative(a, b), v = relative(c, d), w = relative(a, c);
    Real impact = 1;
    serial::each_crossing(serial::triple_product(w, u, v), [&](Real t) {
      if (!meet(u.at(t), v.at(t), w.at(t))) return false;
      impact = t;
      return true;
    });
    return impact;
  }

  // Does the point where the lines of two coplanar edges cross lie on both edges?
  static bool meet(Vec3<Real> u, Vec3<Real> v, Vec3<Real> w) {
    const serial::Fractions<Real> at = serial::fractions(w, u, v);
    const Real s = at.s_times, r = -at.r_times;  // w = s u - r v
    return !at.parallel && s >= 0 && s <= at.nn && r >= 0 && r <= at.nn;
  }
};

}  // namespace gpuphys::ccd_ee

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(ccd_ee, ccd_ee::Baseline)
}
