// Serial baseline of advect_rk3, written from cases/grid_lattice/advect_rk3.md alone: one face at a time,
// plain loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/advect_rk3.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_rk3 {

struct Trace {
  template <class Real>
  static serial::Point<Real> departure(const serial::MacField<Real>& velocity,
                                       const serial::Point<Real>& face, Real step) {
    const serial::Vector<Real> k1 = velocity.at(face);
    const serial::Vector<Real> k2 = velocity.at(serial::moved(face, k1, -step / 2));
    const serial::Vector<Real> k3 = velocity.at(serial::moved(face, k2, -step * 3 / 4));
    // In sixteenths, which changes no bit: nine velocities from the end of the valid range are beyond
    // float32.
    serial::Vector<Real> k;
    for (std::size_t d = 0; d < 3; ++d)
      k[d] = 16 * ((2 * (k1[d] / 16) + 3 * (k2[d] / 16) + 4 * (k3[d] / 16)) / 9);
    return serial::moved(face, k, -step);
  }
};

template <class Real>
using Baseline = serial::SemiLagrangian<Real, Trace>;

}  // namespace gpuphys::advect_rk3

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_rk3, advect_rk3::Baseline)
}
