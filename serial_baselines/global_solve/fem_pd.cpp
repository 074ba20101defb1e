// Serial baseline of fem_pd, written from cases/global_solve/fem_pd.md alone. Built as FP64 truth and as FP32
// variants (Real).
#include "cases/global_solve/fem_pd.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/projective_dynamics.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::fem_pd {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.mass.shape[0], m = in.tets.shape[0];
    const Real mu = in.mu, dt = in.dt;
    std::vector<Rest> rest(static_cast<std::size_t>(m));
    serial::GlobalMatrix<Real> matrix(in.mass.data, n);
    for (std::int64_t t = 0; t < m; ++t) {
      Rest& r = rest[static_cast<std::size_t>(t)];
      const serial::Matrix3<Real> edges = serial::edges<Real>(in.X, in.tets, t);
      r.inverse = serial::inverse(edges);
      r.volume = serial::determinant(edges) / 6;
      // Gradients of the four barycentric coordinates: rows of D_m^-1, and minus their sum.
      serial::Vector3<Real> slope[4] = {{0, 0, 0}, r.inverse[0], r.inverse[1], r.inverse[2]};
      for (std::size_t c = 0; c < 3; ++c) slope[0][c] = -slope[1][c] - slope[2][c] - slope[3][c];
      for (std::size_t a = 0; a < 4; ++a) {
        for (std::size_t b = a + 1; b < 4; ++b) {
          Real product = 0;
          for (std::size_t c = 0; c < 3; ++c) product += slope[a][c] * slope[b][c];
          matrix.add_edge(in.tets(t, a), in.tets(t, b), -dt * dt * 2 * mu * r.volume * product);
        }
      }
    }
    matrix.finish();
    const auto gradient = [&](const serial::Vectors<Real>& u) {
      std::vector<std::array<serial::Vector3<Real>, 4>> pull(static_cast<std::size_t>(m));
      parallel_for(m / 1024 + 1, [&](std::int64_t block) {
        for (std::int64_t t = block * 1024; t < std::min(m, block * 1024 + 1024); ++t)
          pull[static_cast<std::size_t>(t)] = element_forces(in, t, rest[static_cast<std::size_t>(t)], u);
      });
      serial::Vectors<Real> g(u.size(), {0, 0, 0});
      for (std::int64_t t = 0; t < m; ++t) {
        for (std::size_t a = 0; a < 4; ++a) {
          for (std::size_t c = 0; c < 3; ++c)
            g[static_cast<std::size_t>(in.tets(t, a))][c] -= pull[static_cast<std::size_t>(t)][a][c];
        }
      }
      return g;
    };
    serial::write_displaced(in, serial::local_global_iterations(in, matrix, gradient), out);
  }

 private:
  struct Rest {
    serial::Matrix3<Real> inverse;
    Real volume;
  };

  // Forces of P = 2 mu (F - R) at the displacement u.
  static std::array<serial::Vector3<Real>, 4> element_forces(const Inputs& in, std::int64_t t,
                                                             const Rest& rest,
                                                             const serial::Vectors<Real>& u) {
    serial::Matrix3<Real> edges = serial::edges<Real>(in.x, in.tets, t);
    for (std::size_t k = 0; k < 3; ++k) {
      const auto first = static_cast<std::size_t>(in.tets(t, 0)),
                 vertex = static_cast<std::size_t>(in.tets(t, k + 1));
      for (std::size_t c = 0; c < 3; ++c) edges[c][k] += u[vertex][c] - u[first][c];
    }
    const serial::Matrix3<Real> f = serial::product(edges, rest.inverse),
                                rotation = serial::nearest_rotation(f);
    serial::Matrix3<Real> stress;
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b)
        stress[a][b] = 2 * static_cast<Real>(in.mu) * (f[a][b] - rotation[a][b]);
    }
    return serial::tet_forces(stress, rest.inverse, rest.volume);
  }
};

}  // namespace gpuphys::fem_pd

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(fem_pd, fem_pd::Baseline)
}
