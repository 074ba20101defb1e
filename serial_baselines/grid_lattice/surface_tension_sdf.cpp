// Serial baseline of surface_tension_sdf, written from cases/grid_lattice/surface_tension_sdf.md alone: in
// every cell of the band the differences, the curvature, the smeared delta, the force. Built as FP64 truth
// and as FP32 variants (Real).
#include "cases/grid_lattice/surface_tension_sdf.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/contract/module.hpp"

namespace gpuphys::surface_tension_sdf {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    const std::int64_t nx = in.phi.shape[0], ny = in.phi.shape[1], nz = in.phi.shape[2];
    const Real half_width = Real(1.5) * static_cast<Real>(in.dx);
    for (std::int64_t i = 0; i < nx; ++i) {
      for (std::int64_t j = 0; j < ny; ++j) {
        for (std::int64_t k = 0; k < nz; ++k) {
          std::array<Real, 3> f{0, 0, 0};
          if (std::abs(static_cast<Real>(in.phi(i, j, k))) < half_width) f = force(in, {i, j, k}, half_width);
          out.fx(i, j, k) = f[0];
          out.fy(i, j, k) = f[1];
          out.fz(i, j, k) = f[2];
        }
      }
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;

  static Cell beside(Cell cell, std::size_t axis, std::int64_t step) {
    cell[axis] += step;
    return cell;
  }

  // The sample of a cell, or of the nearest one in the array.
  static Real sample(const Inputs& in, const Cell& cell) {
    Cell at;
    for (std::size_t d = 0; d < 3; ++d) at[d] = std::clamp<std::int64_t>(cell[d], 0, in.phi.shape[d] - 1);
    return static_cast<Real>(in.phi(at[0], at[1], at[2]));
  }

  static std::array<Real, 3> force(const Inputs& in, const Cell& cell, Real half_width) {
    const Real dx = static_cast<Real>(in.dx), sigma = static_cast<Real>(in.sigma);
    const Real centre = sample(in, cell);
    std::array<Real, 3> slope;                // first derivatives
    std::array<std::array<Real, 3>, 3> bend;  // second derivatives times dx
    for (std::size_t a = 0; a < 3; ++a) {
      const Real up = sample(in, beside(cell, a, 1)), down = sample(in, beside(cell, a, -1));
      slope[a] = (up - down) / (2 * dx);
      bend[a][a] = ((up - centre) - (centre - down)) / dx;
      for (std::size_t b = 0; b < a; ++b) {
        const auto corner = [&](std::int64_t s, std::int64_t t) {
          return sample(in, beside(beside(cell, a, s), b, t));
        };
        bend[a][b] = bend[b][a] =
            ((corner(1, 1) - corner(1, -1)) - (corner(-1, 1) - corner(-1, -1))) / (4 * dx);
      }
    }
    Real bracket = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      const std::size_t b = (a + 1) % 3, c = (a + 2) % 3;
      bracket += slope[a] * slope[a] * (bend[b][b] + bend[c][c]);
      bracket -= 2 * slope[a] * slope[b] * bend[a][b];
    }
    const Real steepness =
        slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2] + static_cast<Real>(0x1p-40);
    const Real curvature = std::clamp<Real>(bracket / (steepness * std::sqrt(steepness)), -1, 1) / dx;
    const Real delta = (1 + std::cos(std::numbers::pi_v<Real> * centre / half_width)) / (2 * half_width);
    std::array<Real, 3> f;
    for (std::size_t a = 0; a < 3; ++a) f[a] = -sigma * curvature * delta * slope[a];
    return f;
  }
};

}  // namespace gpuphys::surface_tension_sdf

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(surface_tension_sdf, surface_tension_sdf::Baseline)
}
