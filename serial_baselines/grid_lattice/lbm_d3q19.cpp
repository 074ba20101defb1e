// Serial baseline of lbm_d3q19, written from cases/grid_lattice/lbm_d3q19.md alone: one cell at a time, plain
// loops. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/lbm_d3q19.hpp"

#include "core/module.hpp"
#include "serial_baselines/grid_lattice/lattice.hpp"

namespace gpuphys::lbm_d3q19 {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::TrtCollision<19, Real> collision(in.tau_plus, in.magic);
    serial::step<19, Real>(in.f, out.f, true, [&](std::array<Real, 19>& f) { collision.collide(f); });
  }
};

}  // namespace gpuphys::lbm_d3q19

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(lbm_d3q19, lbm_d3q19::Baseline)
}
