// Serial baseline of advect_mc, written from cases/grid_lattice/advect_mc.md alone: one face at a time, plain
// loops. Built as FP64 truth and as FP32 variants (Real); the prediction is held in Real.
#include <algorithm>
#include <array>
#include <vector>

#include "cases/grid_lattice/advect_mc.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::advect_mc {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs& in, const Outputs<Real>&) {
    for (std::size_t c = 0; c < 3; ++c) {
      const View<const float, 3>& u = c == 0 ? in.ux : c == 1 ? in.uy : in.uz;
      storage_[c].resize(static_cast<std::size_t>(u.size()));
      predicted_[c] = {storage_[c].data(), {u.shape[0], u.shape[1], u.shape[2]}};
    }
  }

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::MacField<Real> velocity{in.ux, in.uy, in.uz};
    const Real step = static_cast<Real>(in.dt) / static_cast<Real>(in.dx);
    const auto departure = [&](const serial::Point<Real>& face) {
      return serial::midpoint_departure(velocity, face, step);
    };
    serial::fill_faces<Real>(predicted_, [&](int c, const serial::Point<Real>& face) {
      return velocity.component(c, departure(face));
    });
    const auto constant = [](const View<Real, 3>& u) {
      return View<const Real, 3>{u.data, {u.shape[0], u.shape[1], u.shape[2]}};
    };
    const serial::MacField<Real, Real> prediction{constant(predicted_[0]), constant(predicted_[1]),
                                                  constant(predicted_[2])};
    serial::fill_faces<Real>({out.ux, out.uy, out.uz}, [&](int c, const serial::Point<Real>& face) {
      const serial::Point<Real> arrival = serial::midpoint_departure(velocity, face, -step);
      const Real returned = prediction.component(c, arrival);
      const Real corrected = prediction.component(c, face) + (velocity.component(c, face) - returned) / 2;
      const auto [low, high] = velocity.range(c, departure(face));
      return std::clamp(corrected, low, high);
    });
  }

 private:
  std::array<std::vector<Real>, 3> storage_;
  std::array<View<Real, 3>, 3> predicted_;
};

}  // namespace gpuphys::advect_mc

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(advect_mc, advect_mc::Baseline)
}
