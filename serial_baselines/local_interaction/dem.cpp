// Serial baseline of dem, written from cases/local_interaction/dem.md alone: linked lists of grains in hashed
// cells, every pair once, then one step. Built as FP64 truth and as FP32 variants (Real).
#include "cases/local_interaction/dem.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/contract/module.hpp"
#include "serial_baselines/local_interaction/cell_lists.hpp"

namespace gpuphys::dem {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t n = in.radius.shape[0];
    float largest = 0;
    for (std::int64_t i = 0; i < n; ++i) largest = std::max(largest, in.radius(i));
    std::vector<Load> loads(static_cast<std::size_t>(n));
    const serial::CellLists cells(in.x, 2.0 * static_cast<double>(largest));
    cells.for_each_pair([&](std::int64_t i, std::int64_t j) {
      add_contact(in, i, j, loads[static_cast<std::size_t>(i)], loads[static_cast<std::size_t>(j)]);
    });

    const Real dt = in.dt;
    for (std::int64_t i = 0; i < n; ++i) {
      const Load& load = loads[static_cast<std::size_t>(i)];
      const Real r = in.radius(i);
      const Real mass = Real(4) / 3 * std::numbers::pi_v<Real> * static_cast<Real>(in.rho) * r * r * r;
      const Real inertia = Real(2) / 5 * mass * r * r;
      for (std::size_t c = 0; c < 3; ++c) {
        const Real v = static_cast<Real>(in.v(i, c)) + dt * load.force[c] / mass;
        out.v_new(i, c) = v;
        out.x_new(i, c) = static_cast<Real>(in.x(i, c)) + dt * v;
        out.omega_new(i, c) = static_cast<Real>(in.omega(i, c)) + dt * load.torque[c] / inertia;
      }
    }
  }

 private:
  using Vector = std::array<Real, 3>;
  struct Load {
    Vector force{0, 0, 0}, torque{0, 0, 0};
  };

  static Vector vector_at(const View<const float, 2>& array, std::int64_t i) {
    return {static_cast<Real>(array(i, 0)), static_cast<Real>(array(i, 1)), static_cast<Real>(array(i, 2))};
  }
  static Real dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
  static Vector cross(const Vector& a, const Vector& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  }

  // What the grains i and j do to each other.
  static void add_contact(const Inputs& in, std::int64_t i, std::int64_t j, Load& on_i, Load& on_j) {
    const Vector xi = vector_at(in.x, i), xj = vector_at(in.x, j);
    const Vector d{xi[0] - xj[0], xi[1] - xj[1], xi[2] - xj[2]};
    const Real distance = std::sqrt(dot(d, d));
    const Real ri = in.radius(i), rj = in.radius(j);
    const Real overlap = ri + rj - distance;
    if (!(overlap > 0) || distance == 0) return;
    const Vector n{d[0] / distance, d[1] / distance, d[2] / distance};

    const Vector vi = vector_at(in.v, i), vj = vector_at(in.v, j);
    const Vector w{vi[0] - vj[0], vi[1] - vj[1], vi[2] - vj[2]};
    const Real separation = dot(w, n);
    const Real kn = in.kn, cn = in.cn;
    const Real spread = std::sqrt(ri * rj / (ri + rj) * overlap);
    const Real push = std::max(Real(0), spread * (kn * overlap - cn * separation));

    const Real arm_i = ri - overlap / 2, arm_j = rj - overlap / 2;
    const Vector oi = vector_at(in.omega, i), oj = vector_at(in.omega, j);
    const Vector turn{arm_i * oi[0] + arm_j * oj[0], arm_i * oi[1] + arm_j * oj[1],
                      arm_i * oi[2] + arm_j * oj[2]};
    const Vector rolled = cross(turn, n);
    Vector slip;
    for (std::size_t c = 0; c < 3; ++c) slip[c] = w[c] - separation * n[c] - rolled[c];
    const Real speed = std::sqrt(dot(slip, slip));
    const Real gt = in.gt, cap = static_cast<Real>(in.mu) * push;
    Vector friction{0, 0, 0};
    if (speed > 0) {
      const Real factor = std::min(gt, cap / speed);
      for (std::size_t c = 0; c < 3; ++c) friction[c] = -factor * slip[c];
    }

    const Vector twist = cross(n, friction);
    for (std::size_t c = 0; c < 3; ++c) {
      const Real force = push * n[c] + friction[c];
      on_i.force[c] += force;
      on_j.force[c] -= force;
      on_i.torque[c] -= arm_i * twist[c];
      on_j.torque[c] -= arm_j * twist[c];
    }
  }
};

}  // namespace gpuphys::dem

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(dem, dem::Baseline)
}
