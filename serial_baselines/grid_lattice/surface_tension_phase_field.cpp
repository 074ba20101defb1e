// Serial baseline of surface_tension_phase_field, written from
// cases/grid_lattice/surface_tension_phase_field.md alone: chemical potential times gradient in every cell.
// Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/surface_tension_phase_field.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/grid_lattice/periodic_stencil.hpp"

namespace gpuphys::surface_tension_phase_field {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::array<std::int64_t, 3> n{in.phi.shape[0], in.phi.shape[1], in.phi.shape[2]};
    const Real beta = static_cast<Real>(in.beta), kappa = static_cast<Real>(in.kappa);
    const auto phi = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      return static_cast<Real>(in.phi(i, j, k));
    };
    for (std::int64_t i = 0; i < n[0]; ++i) {
      for (std::int64_t j = 0; j < n[1]; ++j) {
        for (std::int64_t k = 0; k < n[2]; ++k) {
          const auto d = serial::derivatives<Real>(lattice_, n, i, j, k, phi);
          const Real mu = serial::chemical_potential(phi(i, j, k), d.laplacian, beta, kappa);
          out.fx(i, j, k) = mu * d.gradient[0];
          out.fy(i, j, k) = mu * d.gradient[1];
          out.fz(i, j, k) = mu * d.gradient[2];
        }
      }
    }
  }

 private:
  serial::Lattice<19> lattice_;
};

}  // namespace gpuphys::surface_tension_phase_field

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(surface_tension_phase_field, surface_tension_phase_field::Baseline)
}
