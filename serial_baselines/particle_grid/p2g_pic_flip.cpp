// Serial baseline of p2g_pic_flip, written from cases/particle_grid/p2g_pic_flip.md alone: for each component
// one particle after the other, its eight faces in plain loops. Built as FP64 truth and as FP32 variants
// (Real). The components are independent of each other and run side by side.
#include "cases/particle_grid/p2g_pic_flip.hpp"

#include <array>
#include <vector>

#include "core/base/parallel.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/particle_grid/mac_samples.hpp"

namespace gpuphys::p2g_pic_flip {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::vector<std::uint32_t> order = serial::order_by_cell(in.x, in.dx, {in.nx, in.ny, in.nz});
    const std::array<View<Real, 3>, 3> u{out.ux, out.uy, out.uz};
    parallel_for(3, [&](std::int64_t c) {
      const auto component = static_cast<std::size_t>(c);
      transfer(in, order, component, u[component]);
    });
  }

 private:
  struct Face {
    Real mass = 0, momentum = 0;
  };

  static void transfer(const Inputs& in, const std::vector<std::uint32_t>& order, std::size_t c,
                       const View<Real, 3>& u) {
    std::vector<Face> faces(static_cast<std::size_t>(u.size()));
    for (const std::uint32_t p : order) scatter(in, p, c, u, faces);
    for (std::size_t i = 0; i < faces.size(); ++i)
      u.data[i] = faces[i].mass > 0 ? faces[i].momentum / faces[i].mass : Real(0);
  }

  static void scatter(const Inputs& in, std::uint32_t p, std::size_t c, const View<Real, 3>& u,
                      std::vector<Face>& faces) {
    std::array<serial::MacSamples<Real, 2>, 3> s;
    for (std::size_t d = 0; d < 3; ++d) {
      const auto offset = serial::mac_offset<Real>(c, d);
      if (!serial::near_samples(in.x(p, d), in.dx, offset, u.shape[d])) return;
      s[d] = serial::hat_samples(in.x(p, d), in.dx, offset);
    }
    const auto v = static_cast<Real>(in.v(p, c));
    for (std::size_t i = 0; i < 2; ++i) {
      for (std::size_t j = 0; j < 2; ++j) {
        for (std::size_t k = 0; k < 2; ++k) {
          const std::array<std::int64_t, 3> at{s[0].first + static_cast<std::int64_t>(i),
                                               s[1].first + static_cast<std::int64_t>(j),
                                               s[2].first + static_cast<std::int64_t>(k)};
          if (!inside(u, at)) continue;
          const Real w = s[0].weight[i] * s[1].weight[j] * s[2].weight[k];
          Face& face = faces[static_cast<std::size_t>(u.offset(at[0], at[1], at[2]))];
          face.mass += w;
          face.momentum += w * v;
        }
      }
    }
  }

  static bool inside(const View<Real, 3>& u, const std::array<std::int64_t, 3>& at) {
    for (std::size_t d = 0; d < 3; ++d) {
      if (at[d] < 0 || at[d] >= u.shape[d]) return false;
    }
    return true;
  }
};

}  // namespace gpuphys::p2g_pic_flip

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(p2g_pic_flip, p2g_pic_flip::Baseline)
}
