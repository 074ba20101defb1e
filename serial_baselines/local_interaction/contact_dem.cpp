// Serial baseline of contact_dem, written from cases/local_interaction/contact_dem.md alone: linked lists of
// grains in hashed cells, every pair once. Built as FP64 truth and as FP32 variants (Real).
#include <algorithm>
#include <array>
#include <cmath>

#include "cases/local_interaction/contact_dem.hpp"
#include "core/contract/module.hpp"
#include "serial_baselines/local_interaction/cell_lists.hpp"

namespace gpuphys::contact_dem {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.radius.shape[0];
    float largest = 0;
    for (std::int64_t i = 0; i < n; ++i) largest = std::max(largest, in.radius(i));
    const serial::CellLists cells(in.x, 2.0 * static_cast<double>(largest));
    std::fill(out.force.data, out.force.data + out.force.size(), Real(0));
    cells.for_each_pair([&](std::int64_t i, std::int64_t j) {
      const std::array<Real, 3> f = contact_force(in, i, j);
      for (std::size_t c = 0; c < 3; ++c) {
        out.force(i, c) += f[c];
        out.force(j, c) -= f[c];
      }
    });
  }

 private:
  // The force on grain i from grain j.
  static std::array<Real, 3> contact_force(const Inputs& in, std::int64_t i, std::int64_t j) {
    std::array<Real, 3> d;
    for (std::size_t c = 0; c < 3; ++c) {
      d[c] = static_cast<Real>(in.x(i, c)) - static_cast<Real>(in.x(j, c));
    }
    const Real distance = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    const Real ri = in.radius(i), rj = in.radius(j);
    const Real overlap = ri + rj - distance;
    if (!(overlap > 0) || distance == 0) return {0, 0, 0};
    Real separation = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      separation += (static_cast<Real>(in.v(i, c)) - static_cast<Real>(in.v(j, c))) * (d[c] / distance);
    }
    const Real kn = in.kn, cn = in.cn;
    const Real reduced_radius = ri * rj / (ri + rj);
    const Real magnitude = std::sqrt(reduced_radius * overlap) * (kn * overlap - cn * separation);
    const Real push = std::max(Real(0), magnitude);
    return {push * (d[0] / distance), push * (d[1] / distance), push * (d[2] / distance)};
  }
};

}  // namespace gpuphys::contact_dem

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(contact_dem, contact_dem::Baseline)
}
