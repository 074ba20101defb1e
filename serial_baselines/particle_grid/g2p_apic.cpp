// Serial baseline of g2p_apic, written from cases/particle_grid/g2p_apic.md alone: one particle after the
// other. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/g2p_apic.hpp"

#include <array>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/mac_gather.hpp"

namespace gpuphys::g2p_apic {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::array<View<const float, 3>, 3> u{in.ux, in.uy, in.uz};
    for (std::int64_t p = 0; p < in.x.shape[0]; ++p) {
      for (std::size_t c = 0; c < 3; ++c) gather(in, out, p, c, u[c]);
    }
  }

 private:
  static void gather(const Inputs& in, const Outputs<Real>& out, std::int64_t p, std::size_t c,
                     const View<const float, 3>& u) {
    const auto offset = [c](std::size_t d) { return d == c ? Real(0) : Real(0.5); };
    using Samples = serial::ClampedSamples<Real, 3>;
    const Samples x(in.x(p, 0), in.dx, offset(0), u.shape[0]), y(in.x(p, 1), in.dx, offset(1), u.shape[1]),
        z(in.x(p, 2), in.dx, offset(2), u.shape[2]);
    const auto middle = static_cast<Real>(u(x.index[1], y.index[1], z.index[1]));
    Real v = 0;
    std::array<Real, 3> moment{};
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t k = 0; k < 3; ++k) {
          const Real share = x.weight[i] * y.weight[j] * z.weight[k] *
                             (static_cast<Real>(u(x.index[i], y.index[j], z.index[k])) - middle);
          v += share;
          moment[0] += share * x.distance[i];
          moment[1] += share * y.distance[j];
          moment[2] += share * z.distance[k];
        }
      }
    }
    out.v(p, c) = middle + v;
    for (std::size_t b = 0; b < 3; ++b) out.B(p, c, b) = moment[b] * static_cast<Real>(in.dx);
  }
};

}  // namespace gpuphys::g2p_apic

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(g2p_apic, g2p_apic::Baseline)
}
