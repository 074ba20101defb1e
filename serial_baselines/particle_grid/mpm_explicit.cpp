// Serial baseline of mpm_explicit, written from cases/particle_grid/mpm_explicit.md alone: one particle after
// the other to the nodes, then one after the other back. Built as FP64 truth and as FP32 variants (Real).
#include "cases/particle_grid/mpm_explicit.hpp"

#include <array>
#include <cmath>
#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/elasticity.hpp"
#include "serial_baselines/particle_grid/node_gather.hpp"

namespace gpuphys::mpm_explicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t particles = in.x.shape[0];
    nodes_ = {{}, {in.nx, in.ny, in.nz}};
    const auto count = static_cast<std::size_t>(nodes_.size());
    mass_.assign(count, Real(0));
    for (std::vector<Real>& m : momentum_) m.assign(count, Real(0));
    for (std::int64_t p = 0; p < particles; ++p) scatter(in, p);
    std::array<View<const Real, 3>, 3> u;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t i = 0; i < count; ++i) {
        if (mass_[i] > 0) momentum_[a][i] /= mass_[i];  // now a velocity; 0 where there is no mass
      }
      u[a] = {momentum_[a].data(), {in.nx, in.ny, in.nz}};
    }
    for (std::int64_t p = 0; p < particles; ++p) gather(in, u, p, out);
  }

 private:
  void scatter(const Inputs& in, std::int64_t p) {
    const auto dx = static_cast<Real>(in.dx);
    std::array<serial::UnclampedSpline<Real>, 3> s;
    for (std::size_t d = 0; d < 3; ++d) {
      const Real g = static_cast<Real>(in.x(p, d)) / dx;
      // Beyond the reach of any node; such coordinates may not fit an integer.
      if (!(g > -2 && g < static_cast<Real>(nodes_.shape[d]) + 1)) return;
      s[d] = serial::UnclampedSpline<Real>(static_cast<Real>(in.x(p, d)), dx);
    }
    serial::Matrix3<Real> f;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) f[a][b] = static_cast<Real>(in.F(p, a, b));
    }
    const serial::Matrix3<Real> stress =
        serial::kirchhoff_stress(f, static_cast<Real>(in.mu), static_cast<Real>(in.lambda));
    // In units of a particle's mass: dt f / m_p = -(dt V0 / m_p) tau grad w.
    const Real impulse = -static_cast<Real>(in.dt) * static_cast<Real>(in.V0) / static_cast<Real>(in.mass_p);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        for (std::size_t k = 0; k < 3; ++k) {
          const std::array<std::int64_t, 3> at{s[0].first + static_cast<std::int64_t>(i),
                                               s[1].first + static_cast<std::int64_t>(j),
                                               s[2].first + static_cast<std::int64_t>(k)};
          if (!inside(at)) continue;
          const auto node = static_cast<std::size_t>(nodes_.offset(at[0], at[1], at[2]));
          const Real w = s[0].weight[i] * s[1].weight[j] * s[2].weight[k];
          const std::array<Real, 3> gradient{s[0].slope[i] * s[1].weight[j] * s[2].weight[k],
                                             s[0].weight[i] * s[1].slope[j] * s[2].weight[k],
                                             s[0].weight[i] * s[1].weight[j] * s[2].slope[k]};
          mass_[node] += w;
          for (std::size_t a = 0; a < 3; ++a) {
            const Real force =
                stress[a][0] * gradient[0] + stress[a][1] * gradient[1] + stress[a][2] * gradient[2];
            momentum_[a][node] += w * static_cast<Real>(in.v(p, a)) + impulse * force;
          }
        }
      }
    }
  }

  static void gather(const Inputs& in, const std::array<View<const Real, 3>, 3>& u, std::int64_t p,
                     const Outputs<Real>& out) {
    const auto dt = static_cast<Real>(in.dt);
    std::array<Real, 3> x;
    for (std::size_t a = 0; a < 3; ++a) x[a] = static_cast<Real>(in.x(p, a));
    const serial::Gathered<Real> at = serial::gather_from_nodes(u, x, static_cast<Real>(in.dx));
    for (std::size_t a = 0; a < 3; ++a) {
      out.v_new(p, a) = at.v[a];
      out.x_new(p, a) = x[a] + dt * at.v[a];
      for (std::size_t b = 0; b < 3; ++b) {
        Real change = 0;
        for (std::size_t c = 0; c < 3; ++c) change += dt * at.g[a][c] * static_cast<Real>(in.F(p, c, b));
        out.F_new(p, a, b) = static_cast<Real>(in.F(p, a, b)) + change;
      }
    }
  }

  bool inside(const std::array<std::int64_t, 3>& at) const {
    for (std::size_t d = 0; d < 3; ++d) {
      if (at[d] < 0 || at[d] >= nodes_.shape[d]) return false;
    }
    return true;
  }

  View<const Real, 3> nodes_;  // extents only
  std::vector<Real> mass_;
  std::array<std::vector<Real>, 3> momentum_;
};

}  // namespace gpuphys::mpm_explicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(mpm_explicit, mpm_explicit::Baseline)
}
