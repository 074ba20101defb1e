// Serial baseline of velocity_gradient_mpm, written from cases/particle_grid/velocity_gradient_mpm.md alone:
// one particle after the other. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/velocity_gradient_mpm.hpp"

#include <array>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/node_gather.hpp"

namespace gpuphys::velocity_gradient_mpm {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t particles = in.x.shape[0];
    for (std::int64_t p = 0; p < particles; ++p) {
      std::array<Real, 3> x;
      for (std::size_t a = 0; a < 3; ++a) x[a] = static_cast<Real>(in.x(p, a));
      const serial::Gathered<Real> at =
          serial::gather_from_nodes({in.ux, in.uy, in.uz}, x, static_cast<Real>(in.dx));
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) out.G(p, a, b) = at.g[a][b];
      }
    }
  }
};

}  // namespace gpuphys::velocity_gradient_mpm

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(velocity_gradient_mpm, velocity_gradient_mpm::Baseline)
}
