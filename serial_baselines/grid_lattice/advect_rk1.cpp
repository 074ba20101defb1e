// Serial baseline of advect_rk1, written from cases/grid_lattice/advect_rk1.md alone: one face at a time,
// plain loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/advect_rk1.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_rk1 {

struct Trace {
  template <class Real>
  static serial::Point<Real> departure(const serial::MacField<Real>& velocity,
                                       const serial::Point<Real>& face, Real step) {
    const serial::Vector<Real> k1 = velocity.at(face);
    return serial::moved(face, k1, -step);
  }
};

template <class Real>
using Baseline = serial::SemiLagrangian<Real, Trace>;

}  // namespace gpuphys::advect_rk1

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_rk1, advect_rk1::Baseline)
}
