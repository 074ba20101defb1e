// Serial baseline of advect_rk1, written from cases/grid_lattice/advect_rk1.md alone: one face at a time,
// plain loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/advect_rk1.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_rk1 {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    serial::advect<Real>(in, out, [](const auto& velocity, const serial::Point<Real>& face, Real step) {
      const serial::Vector<Real> k1 = velocity.at(face);
      return serial::moved(face, k1, -step);
    });
  }
};

}  // namespace gpuphys::advect_rk1

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_rk1, advect_rk1::Baseline)
}
