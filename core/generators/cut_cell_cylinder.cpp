#include "core/generators/cut_cell_cylinder.hpp"

#include <fmt/format.h>

#include <cmath>

#include "core/base/error.hpp"

namespace gpuphys {

double open_edge_fraction(double a, double b) {
  if (a >= 0 && b >= 0) return 1;
  if (a < 0 && b < 0) return 0;
  return (a >= 0 ? a : b) / (std::abs(a) + std::abs(b));
}

double open_square_area(double p00, double p10, double p11, double p01) {
  const double phi[4] = {p00, p10, p11, p01};
  constexpr double corner_x[4] = {0, 1, 1, 0};
  constexpr double corner_y[4] = {0, 0, 1, 1};
  // The polygon of the open part: open corners and edge crossings, counter-clockwise.
  double x[8], y[8];
  int n = 0;
  for (int c = 0; c < 4; ++c) {
    const int d = (c + 1) % 4;
    if (phi[c] >= 0) {
      x[n] = corner_x[c];
      y[n++] = corner_y[c];
    }
    if ((phi[c] >= 0) != (phi[d] >= 0)) {
      const double t = std::abs(phi[c]) / (std::abs(phi[c]) + std::abs(phi[d]));
      x[n] = corner_x[c] + t * (corner_x[d] - corner_x[c]);
      y[n++] = corner_y[c] + t * (corner_y[d] - corner_y[c]);
    }
  }
  double twice_area = 0;
  for (int c = 0; c < n; ++c) {
    const int d = (c + 1) % n;
    twice_area += x[c] * y[d] - x[d] * y[c];
  }
  // Rounding may leave an area of 1e-17 below zero when only a corner touches.
  return std::fmin(1.0, std::fmax(0.0, 0.5 * twice_area));
}

CutCellCylinder::CutCellCylinder(std::int64_t nx, std::int64_t ny, std::int64_t nz, double radius)
    : nx_(nx), ny_(ny), nz_(nz), radius_(radius) {
  if (nx < 1 || ny < 1 || nz < 1 || !(radius >= 0) || !std::isfinite(radius)) {
    throw Error(
        ExitCode::internal,
        fmt::format("cut-cell cylinder: {} x {} x {} cells with radius {} is not a box with a cylinder", nx,
                    ny, nz, radius));
  }
  phi_.resize(static_cast<std::size_t>((nx + 1) * (ny + 1)));
  for (std::int64_t i = 0; i <= nx; ++i) {
    for (std::int64_t j = 0; j <= ny; ++j) {
      // The squares are exact and sqrt is correctly rounded, so phi is the same on every machine (hypot need
      // not be).
      const double dx = static_cast<double>(i) - 0.5 * static_cast<double>(nx);
      const double dy = static_cast<double>(j) - 0.5 * static_cast<double>(ny);
      phi_[static_cast<std::size_t>(i * (ny + 1) + j)] = std::sqrt(dx * dx + dy * dy) - radius;
    }
  }
}

bool CutCellCylinder::active(std::int64_t i, std::int64_t j) const {
  return level_set(i, j) > 0 || level_set(i + 1, j) > 0 || level_set(i, j + 1) > 0 ||
         level_set(i + 1, j + 1) > 0;
}

double CutCellCylinder::face_x(std::int64_t i, std::int64_t j) const {
  if (i == 0 || i == nx_) return 0;
  return open_edge_fraction(level_set(i, j), level_set(i, j + 1));
}

double CutCellCylinder::face_y(std::int64_t i, std::int64_t j) const {
  if (j == 0 || j == ny_) return 0;
  return open_edge_fraction(level_set(i, j), level_set(i + 1, j));
}

double CutCellCylinder::face_z(std::int64_t i, std::int64_t j, std::int64_t k) const {
  if (k == 0 || k == nz_) return 0;
  return area(i, j);
}

double CutCellCylinder::area(std::int64_t i, std::int64_t j) const {
  return open_square_area(level_set(i, j), level_set(i + 1, j), level_set(i + 1, j + 1), level_set(i, j + 1));
}

std::int64_t CutCellCylinder::active_cells() const {
  std::int64_t in_plane = 0;
  for (std::int64_t i = 0; i < nx_; ++i) {
    for (std::int64_t j = 0; j < ny_; ++j) in_plane += active(i, j) ? 1 : 0;
  }
  return in_plane * nz_;
}

}  // namespace gpuphys
