// Serial baseline of self_collision_xpbd, written from cases/position_constraint/self_collision_xpbd.md
// alone: the pairs once, then one pair at a time. Built as FP64 truth and as FP32 variants (Real).
//
// Positions are held as the input plus a displacement, so that the FP32 builds keep their digits; for FP64
// that is harmless.
#include "cases/position_constraint/self_collision_xpbd.hpp"

#include <array>
#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/position_constraint/contact_list.hpp"

namespace gpuphys::self_collision_xpbd {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.x.shape[0];
    serial::Vectors<double> rough(static_cast<std::size_t>(n));
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d)
        rough[static_cast<std::size_t>(i)][d] = static_cast<double>(in.x(i, d));
    }
    const auto pairs = serial::pairs_within(rough, static_cast<Real>(in.search_radius),
                                            [&](std::int32_t i, std::int32_t j) { return apart(in, i, j); });

    const Real dt = static_cast<Real>(in.dt);
    const serial::ContactLaw<Real> law{static_cast<Real>(in.thickness),
                                       static_cast<Real>(in.compliance) / (dt * dt),
                                       static_cast<Real>(in.relaxation)};
    std::vector<Real> multiplier(pairs.size(), Real(0));
    serial::Vectors<Real> now(static_cast<std::size_t>(n), {Real(0), Real(0), Real(0)});
    serial::Vectors<Real> next = now;
    for (std::int32_t k = 0; k < in.iters; ++k) {
      next = now;
      for (std::size_t p = 0; p < pairs.size(); ++p) {
        const auto [i, j] = pairs[p];
        const auto a = static_cast<std::size_t>(i), b = static_cast<std::size_t>(j);
        std::array<Real, 3> d = apart(in, i, j);
        for (std::size_t c = 0; c < 3; ++c) d[c] += now[a][c] - now[b][c];
        const Real wi = static_cast<Real>(in.inv_mass(i)), wj = static_cast<Real>(in.inv_mass(j));
        const std::array<Real, 3> move = law.advance(d, wi + wj, multiplier[p]);
        for (std::size_t c = 0; c < 3; ++c) {
          next[a][c] += wi * move[c];
          next[b][c] -= wj * move[c];
        }
      }
      std::swap(now, next);
    }
    for (std::int64_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c)
        out.x_new(i, c) = static_cast<Real>(in.x(i, c)) + now[static_cast<std::size_t>(i)][c];
    }
  }

 private:
  static std::array<Real, 3> apart(const Inputs& in, std::int32_t i, std::int32_t j) {
    return {static_cast<Real>(in.x(i, 0)) - static_cast<Real>(in.x(j, 0)),
            static_cast<Real>(in.x(i, 1)) - static_cast<Real>(in.x(j, 1)),
            static_cast<Real>(in.x(i, 2)) - static_cast<Real>(in.x(j, 2))};
  }
};

}  // namespace gpuphys::self_collision_xpbd

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(self_collision_xpbd, self_collision_xpbd::Baseline)
}
