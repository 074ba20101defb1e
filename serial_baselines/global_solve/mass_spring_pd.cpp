// Serial baseline of mass_spring_pd, written from cases/global_solve/mass_spring_pd.md alone. Built as FP64
// truth and as FP32 variants (Real).
#include "cases/global_solve/mass_spring_pd.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/projective_dynamics.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::mass_spring_pd {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.mass.shape[0], m = in.rest.shape[0];
    const Real k = in.k, dt = in.dt;
    serial::GlobalMatrix<Real> matrix(in.mass.data, n);
    for (std::int64_t j = 0; j < m; ++j) {
      if (in.springs(j, 0) != in.springs(j, 1))
        matrix.add_edge(in.springs(j, 0), in.springs(j, 1), dt * dt * k);
    }
    matrix.finish();
    const auto gradient = [&](const serial::Vectors<Real>& u) {
      serial::Vectors<Real> g(u.size(), {0, 0, 0});
      for (std::int64_t j = 0; j < m; ++j) {
        const auto a = static_cast<std::size_t>(in.springs(j, 0)),
                   b = static_cast<std::size_t>(in.springs(j, 1));
        serial::Vector3<Real> d = serial::difference<Real>(in.x, in.springs(j, 0), in.springs(j, 1));
        for (std::size_t c = 0; c < 3; ++c) d[c] += u[a][c] - u[b][c];
        // k (d - L d / |d|), which is minus the pull of the spring.
        const serial::Vector3<Real> pull = serial::spring_pull(d, static_cast<Real>(in.rest(j)));
        for (std::size_t c = 0; c < 3; ++c) {
          g[a][c] -= k * pull[c];
          g[b][c] += k * pull[c];
        }
      }
      return g;
    };
    serial::write_displaced(in, serial::local_global_iterations(in, matrix, gradient), out);
  }
};

}  // namespace gpuphys::mass_spring_pd

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(mass_spring_pd, mass_spring_pd::Baseline)
}
