// Serial baseline of fem_explicit, written from cases/local_interaction/fem_explicit.md alone: forces
// tetrahedron by tetrahedron, then the step. Built as FP64 truth and as FP32 variants (Real).
#include <vector>

#include "cases/local_interaction/fem_explicit.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::fem_explicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.mass.shape[0], m = in.tets.shape[0];
    const Real mu = in.mu, lambda = in.lambda, dt = in.dt;
    std::vector<serial::Vector3<Real>> force(static_cast<std::size_t>(n), {0, 0, 0});
    for (std::int64_t t = 0; t < m; ++t) {
      const serial::Matrix3<Real> rest = serial::edges<Real>(in.X, in.tets, t);
      const serial::Matrix3<Real> inverse_rest = serial::inverse(rest);
      const Real volume = serial::determinant(rest) / 6;
      const serial::Matrix3<Real> f = serial::product(serial::edges<Real>(in.x, in.tets, t), inverse_rest);
      const auto forces = serial::tet_forces(serial::neo_hookean_stress(f, mu, lambda), inverse_rest, volume);
      for (std::size_t vertex = 0; vertex < 4; ++vertex) {
        auto& sum = force[static_cast<std::size_t>(in.tets(t, vertex))];
        for (std::size_t c = 0; c < 3; ++c) sum[c] += forces[vertex][c];
      }
    }
    for (std::int64_t i = 0; i < n; ++i) {
      const Real mass = in.mass(i);
      for (std::size_t c = 0; c < 3; ++c) {
        const Real v = static_cast<Real>(in.v(i, c)) + dt * (force[static_cast<std::size_t>(i)][c] / mass);
        out.v_new(i, c) = v;
        out.x_new(i, c) = static_cast<Real>(in.x(i, c)) + dt * v;
      }
    }
  }
};

}  // namespace gpuphys::fem_explicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(fem_explicit, fem_explicit::Baseline)
}
