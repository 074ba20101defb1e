// Serial baseline of g2p_mpm, written from cases/particle_grid/g2p_mpm.md alone: one particle after the
// other. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/g2p_mpm.hpp"

#include <array>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/node_gather.hpp"

namespace gpuphys::g2p_mpm {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const auto dx = static_cast<Real>(in.dx), dt = static_cast<Real>(in.dt);
    const std::int64_t particles = in.x.shape[0];
    for (std::int64_t p = 0; p < particles; ++p) {
      std::array<Real, 3> x;
      for (std::size_t a = 0; a < 3; ++a) x[a] = static_cast<Real>(in.x(p, a));
      const serial::Gathered<Real> at = serial::gather_from_nodes({in.ux, in.uy, in.uz}, x, dx);
      for (std::size_t a = 0; a < 3; ++a) {
        out.v(p, a) = at.v[a];
        out.x_new(p, a) = x[a] + dt * at.v[a];
        for (std::size_t b = 0; b < 3; ++b) {
          Real change = 0;
          for (std::size_t c = 0; c < 3; ++c) change += dt * at.g[a][c] * static_cast<Real>(in.F(p, c, b));
          out.F_new(p, a, b) = static_cast<Real>(in.F(p, a, b)) + change;
        }
      }
    }
  }
};

}  // namespace gpuphys::g2p_mpm

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(g2p_mpm, g2p_mpm::Baseline)
}
