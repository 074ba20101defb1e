// Serial baseline of mc_r, written from cases/global_solve/mc_r.md alone: half a step, projection,
// reflection, half a step, projection. Built as FP64 truth and as FP32 variants (Real).
#include "cases/global_solve/mc_r.hpp"

#include <algorithm>

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/mac_fluid.hpp"
#include "serial_baselines/grid_lattice/mac_sampling.hpp"

namespace gpuphys::mc_r {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const serial::OpenFractions w{in.wx, in.wy, in.wz};
    const Real tol = static_cast<Real>(in.tol);
    const Real half_step = static_cast<Real>(in.dt) / 2 / static_cast<Real>(in.dx);

    // The input in Real, so that both advections are the same code.
    serial::FaceStorage<Real> start(w), advected(w), middle(w), reflected(w);
    const std::array input{in.ux, in.uy, in.uz};
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::int64_t f = 0; f < input[c].size(); ++f)
        start.field()[c].data[f] = static_cast<Real>(input[c].data[f]);
    }
    advect(w, start, start, half_step, advected.field());
    for (std::size_t c = 0; c < 3; ++c)
      std::copy_n(advected.field()[c].data, input[c].size(), middle.field()[c].data);
    serial::project(w, tol, middle.field());
    // What the projection took out is taken out once more.
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::int64_t f = 0; f < input[c].size(); ++f)
        reflected.field()[c].data[f] = 2 * middle.field()[c].data[f] - advected.field()[c].data[f];
    }
    const serial::FaceField<Real> u{out.ux, out.uy, out.uz};
    advect(w, reflected, middle, half_step, u);
    serial::project(w, tol, u);
  }

 private:
  using Point = serial::Point<Real>;
  using Field = serial::MacField<Real, Real>;

  static Field sampled(const serial::FaceStorage<Real>& f) {
    const auto s = f.samples();
    return {s[0], s[1], s[2]};
  }

  static Point departure(const Field& velocity, const Point& from, Real step) {
    const Point half = serial::moved(from, velocity.at(from), -step / 2);
    return serial::moved(from, velocity.at(half), -step);
  }

  // MacCormack: `carried` along `by`, with closed faces at rest before and after the correction.
  static void advect(const serial::OpenFractions& w, const serial::FaceStorage<Real>& carried,
                     const serial::FaceStorage<Real>& by, Real step, const serial::FaceField<Real>& result) {
    const Field velocity = sampled(by), field = sampled(carried);
    serial::FaceStorage<Real> predicted(w);
    serial::fill_faces<Real>(predicted.field(), [&](int c, const Point& face) {
      return field.component(c, departure(velocity, face, step));
    });
    serial::close_faces(w, predicted.field());
    const Field prediction = sampled(predicted);
    serial::fill_faces<Real>(result, [&](int c, const Point& face) {
      const Real returned = prediction.component(c, departure(velocity, face, -step));
      const Real corrected = prediction.component(c, face) + (field.component(c, face) - returned) / 2;
      const auto [low, high] = field.range(c, departure(velocity, face, step));
      return std::clamp(corrected, low, high);
    });
    serial::close_faces(w, result);
  }
};

}  // namespace gpuphys::mc_r

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(mc_r, mc_r::Baseline)
}
