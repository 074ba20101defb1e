// Serial baseline of particle_sdf, written from cases/collision_query/particle_sdf.md alone: one particle
// after the other, all centres within its reach. Built as FP64 truth and as FP32 variants (Real).
#include "cases/collision_query/particle_sdf.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "core/contract/module.hpp"

namespace gpuphys::particle_sdf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    // Of each centre: the square of the distance to the nearest particle so far.
    std::vector<Real> least(static_cast<std::size_t>(out.phi.size()), std::numeric_limits<Real>::infinity());
    const Real dx = in.dx, reach = static_cast<Real>(in.r) + static_cast<Real>(in.clamp);
    for (std::int64_t p = 0; p < in.x.shape[0]; ++p) {
      std::array<Span, 3> spans;
      bool empty = false;
      for (std::size_t d = 0; d < 3; ++d) {
        spans[d] = span_of(static_cast<Real>(in.x(p, d)), reach, dx, out.phi.shape[d], offsets_[d]);
        empty = empty || spans[d].first >= spans[d].end;
      }
      if (empty) continue;
      for (std::int64_t i = spans[0].first; i < spans[0].end; ++i) {
        for (std::int64_t j = spans[1].first; j < spans[1].end; ++j) {
          const Real a = offset(0, i, spans), b = offset(1, j, spans);
          const auto row = static_cast<std::size_t>((i * out.phi.shape[1] + j) * out.phi.shape[2]);
          for (std::int64_t k = spans[2].first; k < spans[2].end; ++k) {
            const Real c = offset(2, k, spans);
            Real& here = least[row + static_cast<std::size_t>(k)];
            here = std::min(here, a * a + b * b + c * c);
          }
        }
      }
    }
    for (std::size_t c = 0; c < least.size(); ++c) {
      out.phi.data[c] = std::min(static_cast<Real>(in.clamp), std::sqrt(least[c]) - static_cast<Real>(in.r));
    }
  }

 private:
  // Centres [first, end) along an axis.
  struct Span {
    std::int64_t first, end;
  };

  // The centres within reach of coordinate x, and perhaps one more at each end; and their distances.
  static Span span_of(Real x, Real reach, Real dx, std::int64_t n, std::vector<Real>& offsets) {
    // Limited before they become integers: x may be anything.
    const Real last = static_cast<Real>(n);
    const auto first =
        static_cast<std::int64_t>(std::clamp(std::floor((x - reach) / dx - Real(0.5)), Real(0), last));
    const auto end =
        static_cast<std::int64_t>(std::clamp(std::ceil((x + reach) / dx - Real(0.5)) + 1, Real(0), last));
    offsets.clear();
    for (std::int64_t i = first; i < end; ++i)
      offsets.push_back(std::fma(static_cast<Real>(i) + Real(0.5), dx, -x));  // rounded once
    return {first, end};
  }
  Real offset(std::size_t axis, std::int64_t i, const std::array<Span, 3>& spans) const {
    return offsets_[axis][static_cast<std::size_t>(i - spans[axis].first)];
  }

  std::array<std::vector<Real>, 3> offsets_;
};

}  // namespace gpuphys::particle_sdf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(particle_sdf, particle_sdf::Baseline)
}
