// Serial baseline of cahn_hilliard, written from cases/grid_lattice/cahn_hilliard.md alone: the phase field
// of all cells, then every cell relaxes and its populations move. Built as FP64 truth and as FP32 variants
// (Real).
#include "cases/grid_lattice/cahn_hilliard.hpp"

#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/grid_lattice/periodic_stencil.hpp"

namespace gpuphys::cahn_hilliard {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::array<std::int64_t, 3> n{in.h.shape[1], in.h.shape[2], in.h.shape[3]};
    const auto flat = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      return static_cast<std::size_t>((i * n[1] + j) * n[2] + k);
    };
    phi_.assign(static_cast<std::size_t>(n[0] * n[1] * n[2]), Real(0));
    // The small populations first.
    for (std::int64_t q = 18; q >= 0; --q) {
      for (std::int64_t i = 0; i < n[0]; ++i) {
        for (std::int64_t j = 0; j < n[1]; ++j) {
          for (std::int64_t k = 0; k < n[2]; ++k) phi_[flat(i, j, k)] += static_cast<Real>(in.h(q, i, j, k));
        }
      }
    }
    const auto phi = [&](std::int64_t i, std::int64_t j, std::int64_t k) { return phi_[flat(i, j, k)]; };

    const Real tau = static_cast<Real>(in.tau), beta = static_cast<Real>(in.beta),
               kappa = static_cast<Real>(in.kappa), eta = static_cast<Real>(in.eta);
    std::vector<Real> row_mu(static_cast<std::size_t>(n[2]));
    for (std::int64_t i = 0; i < n[0]; ++i) {
      for (std::int64_t j = 0; j < n[1]; ++j) {
        for (std::int64_t k = 0; k < n[2]; ++k) {
          const auto d = serial::derivatives<Real>(lattice_, n, i, j, k, phi);
          row_mu[static_cast<std::size_t>(k)] =
              serial::chemical_potential(phi(i, j, k), d.laplacian, beta, kappa);
        }
        // Population by population, because the planes of h are a large power of two apart.
        for (std::size_t q = 0; q < 19; ++q) {
          const std::array<int, 3>& c = lattice_.velocity(q);
          const Real w = static_cast<Real>(lattice_.weight(q));
          const auto from = static_cast<std::int64_t>(q);
          const std::int64_t to_i = serial::periodic(i + c[0], n[0]), to_j = serial::periodic(j + c[1], n[1]);
          for (std::int64_t k = 0; k < n[2]; ++k) {
            const Real driven = eta * row_mu[static_cast<std::size_t>(k)], value = phi(i, j, k);
            const Real cu = static_cast<Real>(c[0]) * static_cast<Real>(in.ux(i, j, k)) +
                            static_cast<Real>(c[1]) * static_cast<Real>(in.uy(i, j, k)) +
                            static_cast<Real>(c[2]) * static_cast<Real>(in.uz(i, j, k));
            const Real equilibrium = q == 0 ? value - (1 - w) * driven : w * (driven + 3 * value * cu);
            const Real before = static_cast<Real>(in.h(from, i, j, k));
            out.h(from, to_i, to_j, serial::periodic(k + c[2], n[2])) = before - (before - equilibrium) / tau;
          }
        }
      }
    }
  }

 private:
  serial::Lattice<19> lattice_;
  std::vector<Real> phi_;
};

}  // namespace gpuphys::cahn_hilliard

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(cahn_hilliard, cahn_hilliard::Baseline)
}
