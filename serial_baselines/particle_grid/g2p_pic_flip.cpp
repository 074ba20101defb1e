// Serial baseline of g2p_pic_flip, written from cases/particle_grid/g2p_pic_flip.md alone: one particle after
// the other. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/g2p_pic_flip.hpp"

#include <array>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/mac_gather.hpp"

namespace gpuphys::g2p_pic_flip {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::array<View<const float, 3>, 3> before{in.ux_old, in.uy_old, in.uz_old},
        after{in.ux_new, in.uy_new, in.uz_new};
    const auto flip = static_cast<Real>(in.flip);
    for (std::int64_t p = 0; p < in.x.shape[0]; ++p) {
      for (std::size_t c = 0; c < 3; ++c) {
        const Sampled at = sample(in, p, c, before[c], after[c]);
        out.v_new(p, c) = (1 - flip) * at.after + flip * (static_cast<Real>(in.v(p, c)) + at.change);
      }
    }
  }

 private:
  struct Sampled {
    Real after = 0;   // P(new)
    Real change = 0;  // P(new) - P(old), of the samples' differences
  };

  static Sampled sample(const Inputs& in, std::int64_t p, std::size_t c, const View<const float, 3>& before,
                        const View<const float, 3>& after) {
    const auto offset = [c](std::size_t d) { return d == c ? Real(0) : Real(0.5); };
    using Samples = serial::ClampedSamples<Real, 2>;
    const Samples x(in.x(p, 0), in.dx, offset(0), after.shape[0]),
        y(in.x(p, 1), in.dx, offset(1), after.shape[1]), z(in.x(p, 2), in.dx, offset(2), after.shape[2]);
    Sampled sum;
    for (std::size_t i = 0; i < 2; ++i) {
      for (std::size_t j = 0; j < 2; ++j) {
        for (std::size_t k = 0; k < 2; ++k) {
          const Real w = x.weight[i] * y.weight[j] * z.weight[k];
          const auto now = static_cast<Real>(after(x.index[i], y.index[j], z.index[k])),
                     then = static_cast<Real>(before(x.index[i], y.index[j], z.index[k]));
          sum.after += w * now;
          sum.change += w * (now - then);
        }
      }
    }
    return sum;
  }
};

}  // namespace gpuphys::g2p_pic_flip

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(g2p_pic_flip, g2p_pic_flip::Baseline)
}
