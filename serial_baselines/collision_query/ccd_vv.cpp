// Serial baseline of ccd_vv, written from cases/collision_query/ccd_vv.md alone: a uniform grid finds the
// pairs, one pair at a time. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "cases/collision_query/ccd_vv.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/collision_query/coplanarity.hpp"
#include "serial_baselines/collision_query/swept_cells.hpp"

namespace gpuphys::ccd_vv {

using serial::Moving;
using serial::Vec3;

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x0.shape[0];
    std::vector<serial::SweptBox> boxes;
    boxes.reserve(static_cast<std::size_t>(n));
    for (std::int64_t i = 0; i < n; ++i) {
      out.toi(i) = 1;
      // Half of d each, and a little more.
      boxes.push_back(serial::widened(
          serial::swept_box(in.x0, in.x1, std::array{static_cast<std::int32_t>(i)}), 0.501f * in.d));
    }
    const serial::SweptCells cells(std::move(boxes));
    cells.each_overlap([&](std::int64_t i, std::int64_t j) {
      const Real t = first_contact(serial::relative_motion<Real>(in.x0, in.x1, static_cast<std::int32_t>(i),
                                                                 static_cast<std::int32_t>(j)),
                                   static_cast<Real>(in.d));
      record(out, i, t);
      record(out, j, t);
    });
  }

 private:
  static void record(const Outputs<Real>& out, std::int64_t i, Real t) {
    if (t < out.toi(i)) out.toi(i) = t;
  }

  // The first time in [0, 1] at which |start + t change| <= d; 1 if there is none.
  static Real first_contact(const Moving<Real>& relative, Real d) {
    // A power of two for p and d, another one for q.
    const int unit = std::max(exponent_of(relative.start), std::ilogb(d));
    const int unit_q = exponent_of(relative.change);
    const Vec3<Real> p = std::ldexp(Real(1), -unit) * relative.start;
    const Vec3<Real> q = std::ldexp(Real(1), -unit_q) * relative.change;
    d = std::ldexp(d, -unit);
    const Real pp = dot(p, p);
    if (pp <= d * d) return 0;
    const Real b = dot(p, q);
    if (b >= 0) return 1;  // q = 0 included
    const Real qq = dot(q, q);
    const Vec3<Real> closest = p - (b / qq) * q;
    const Real mm = dot(closest, closest);
    if (mm > d * d) return 1;
    const Real distance = std::sqrt(pp);
    const Real t = (distance - d) * (distance + d) / (std::sqrt(qq * (d * d - mm)) - b);
    return std::min(std::ldexp(t, unit - unit_q), Real(1));
  }
};

}  // namespace gpuphys::ccd_vv

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(ccd_vv, ccd_vv::Baseline)
}
