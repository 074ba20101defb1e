// Serial baseline of p2g_mpm, written from cases/particle_grid/p2g_mpm.md alone: one particle after the
// other, its 27 nodes in plain loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/p2g_mpm.hpp"

#include <array>
#include <cmath>
#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/elasticity.hpp"
#include "serial_baselines/particle_grid/quadratic_spline.hpp"

namespace gpuphys::p2g_mpm {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>& out) {
    nodes_.resize(static_cast<std::size_t>(out.ux.size()));
  }

  void compute(const Inputs& in, const Outputs<Real>& out) {
    for (Node& node : nodes_) node = Node{};
    const std::int64_t particles = in.x.shape[0];
    for (std::int64_t p = 0; p < particles; ++p) scatter(in, out, p);
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const Node& node = nodes_[i];
      const std::array<Real*, 3> u{out.ux.data + i, out.uy.data + i, out.uz.data + i};
      for (std::size_t a = 0; a < 3; ++a) *u[a] = node.mass > 0 ? node.momentum[a] / node.mass : Real(0);
    }
  }

 private:
  // In units of a particle's mass.
  struct Node {
    Real mass = 0;
    std::array<Real, 3> momentum{};
  };

  void scatter(const Inputs& in, const Outputs<Real>& out, std::int64_t p) {
    const auto dx = static_cast<Real>(in.dx);
    std::array<Real, 3> g, v;
    serial::Matrix3<Real> f;
    for (std::size_t a = 0; a < 3; ++a) {
      g[a] = static_cast<Real>(in.x(p, a)) / dx;
      // Beyond the reach of any node; such coordinates may not fit an integer.
      if (!(g[a] > -2 && g[a] < static_cast<Real>(out.ux.shape[a]) + 1)) return;
      v[a] = static_cast<Real>(in.v(p, a));
      for (std::size_t b = 0; b < 3; ++b) f[a][b] = static_cast<Real>(in.F(p, a, b));
    }
    const serial::Matrix3<Real> stress =
        serial::kirchhoff_stress(f, static_cast<Real>(in.mu), static_cast<Real>(in.lambda));
    // dt f / m_p = -(dt V0 / m_p) tau grad w, and grad w = slopes / dx.
    const Real impulse =
        -static_cast<Real>(in.dt) * static_cast<Real>(in.V0) / static_cast<Real>(in.mass_p) / dx;
    const serial::QuadraticSpline<Real> x(g[0]), y(g[1]), z(g[2]);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t k = 0; k < 3; ++k) {
          const std::array<std::int64_t, 3> at{x.base + static_cast<std::int64_t>(i),
                                               y.base + static_cast<std::int64_t>(j),
                                               z.base + static_cast<std::int64_t>(k)};
          if (!inside(out, at)) continue;
          const Real w = x.weight[i] * y.weight[j] * z.weight[k];
          const std::array<Real, 3> gradient{x.slope[i] * y.weight[j] * z.weight[k],
                                             x.weight[i] * y.slope[j] * z.weight[k],
                                             x.weight[i] * y.weight[j] * z.slope[k]};
          Node& node = nodes_[static_cast<std::size_t>(out.ux.offset(at[0], at[1], at[2]))];
          node.mass += w;
          for (std::size_t a = 0; a < 3; ++a) {
            const Real force =
                stress[a][0] * gradient[0] + stress[a][1] * gradient[1] + stress[a][2] * gradient[2];
            node.momentum[a] += w * v[a] + impulse * force;
          }
        }
      }
    }
  }

  static bool inside(const Outputs<Real>& out, const std::array<std::int64_t, 3>& at) {
    for (std::size_t d = 0; d < 3; ++d) {
      if (at[d] < 0 || at[d] >= out.ux.shape[d]) return false;
    }
    return true;
  }

  std::vector<Node> nodes_;
};

}  // namespace gpuphys::p2g_mpm

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(p2g_mpm, p2g_mpm::Baseline)
}
