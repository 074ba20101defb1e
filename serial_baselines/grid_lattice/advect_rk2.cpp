// Serial baseline of advect_rk2, written from cases/grid_lattice/advect_rk2.md alone: positions in metres,
// one face at a time, plain loops. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <cmath>

#include "cases/grid_lattice/advect_rk2.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_rk2 {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::MacVelocity<Real> velocity{in.ux, in.uy, in.uz};
    const Real step =
        static_cast<Real>(in.dt) / static_cast<Real>(in.dx);  // cells travelled per unit velocity
    const std::array<View<Real, 3>, 3> results{out.ux, out.uy, out.uz};
    for (int c = 0; c < 3; ++c) {
      const View<Real, 3>& u = results[static_cast<std::size_t>(c)];
      for (std::int64_t i = 0; i < u.shape[0]; ++i) {
        for (std::int64_t j = 0; j < u.shape[1]; ++j) {
          for (std::int64_t k = 0; k < u.shape[2]; ++k) {
            const serial::Point<Real> face = serial::face_centre<Real>(c, i, j, k);
            const serial::Vector<Real> k1 = velocity.at(face);
            const serial::Point<Real> middle = serial::moved(face, k1, -step / 2);
            const serial::Vector<Real> k2 = velocity.at(middle);
            const serial::Point<Real> departure = serial::moved(face, k2, -step);
            u(i, j, k) = velocity.component(c, departure);
          }
        }
      }
    }
  }
};

}  // namespace gpuphys::advect_rk2

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_rk2, advect_rk2::Baseline)
}
