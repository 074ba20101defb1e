// Serial baseline of advect_rk2, written from cases/grid_lattice/advect_rk2.md alone: one face at a time,
// plain loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/advect_rk2.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_rk2 {

struct Trace {
  template <class Real>
  static serial::Point<Real> departure(const serial::MacField<Real>& velocity,
                                       const serial::Point<Real>& face, Real step) {
    return serial::midpoint_departure(velocity, face, step);
  }
};

template <class Real>
using Baseline = serial::SemiLagrangian<Real, Trace>;

}  // namespace gpuphys::advect_rk2

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_rk2, advect_rk2::Baseline)
}
