// Serial baseline of mass_spring_explicit, written from cases/local_interaction/mass_spring_explicit.md
// alone: forces spring by spring, then the step. Built as FP64 truth and as FP32 variants (Real).
#include <vector>

#include "cases/local_interaction/mass_spring_explicit.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::mass_spring_explicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.mass.shape[0], m = in.rest.shape[0];
    const Real k = in.k, dt = in.dt;
    std::vector<serial::Vector3<Real>> force(static_cast<std::size_t>(n), {0, 0, 0});
    for (std::int64_t j = 0; j < m; ++j) {
      const std::int32_t a = in.springs(j, 0), b = in.springs(j, 1);
      const serial::Vector3<Real> pull =
          serial::spring_pull(serial::difference<Real>(in.x, a, b), static_cast<Real>(in.rest(j)));
      for (std::size_t c = 0; c < 3; ++c) {
        force[static_cast<std::size_t>(a)][c] += k * pull[c];
        force[static_cast<std::size_t>(b)][c] -= k * pull[c];
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

}  // namespace gpuphys::mass_spring_explicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(mass_spring_explicit, mass_spring_explicit::Baseline)
}
