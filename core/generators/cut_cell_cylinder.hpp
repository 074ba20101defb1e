// A solid circular cylinder along z inside a closed box of unit cells: which cells hold fluid, and how open
// each face is.
#pragma once

#include <cstdint>
#include <vector>

namespace gpuphys {

/// Open part of a unit edge whose end points have signed distances `a` and `b` (positive in the fluid), for a
/// level set that varies linearly along the edge. A zero counts as fluid.
double open_edge_fraction(double a, double b);

/// Open area of the unit square for signed distances at its corners (marching squares with linear edge
/// crossings; vertices in the order (0,0), (1,0), (1,1), (0,1)). The two-crossing-pairs case, which no disc
/// produces, is taken as connected.
double open_square_area(double p00, double p10, double p11, double p01);

/// Lengths are in cells. The axis passes through (nx/2, ny/2): a grid node for even sizes, a cell centre or
/// the middle of a cell edge otherwise. All planes k are alike, so everything depends on (i, j) only.
///
/// The level set phi = distance to the axis - radius lives at the grid nodes. A cell is active when any of
/// its corners has phi > 0. Side faces take the open fraction of their edge in the (x, y) plane, z faces the
/// open area of the square. Faces on the outside of the box are closed.
class CutCellCylinder {
 public:
  /// Throws Error(internal) for sizes below 1 or a radius that is negative or not finite.
  CutCellCylinder(std::int64_t nx, std::int64_t ny, std::int64_t nz, double radius);

  std::int64_t nx() const { return nx_; }
  std::int64_t ny() const { return ny_; }
  std::int64_t nz() const { return nz_; }
  double radius() const { return radius_; }

  /// phi at node (i, j), 0 <= i <= nx, 0 <= j <= ny.
  double level_set(std::int64_t i, std::int64_t j) const {
    return phi_[static_cast<std::size_t>(i * (ny_ + 1) + j)];
  }

  bool active(std::int64_t i, std::int64_t j) const;
  /// Face between cells (i-1, j) and (i, j), 0 <= i <= nx.
  double face_x(std::int64_t i, std::int64_t j) const;
  /// Face between cells (i, j-1) and (i, j), 0 <= j <= ny.
  double face_y(std::int64_t i, std::int64_t j) const;
  /// Face between cells (i, j, k-1) and (i, j, k), 0 <= k <= nz.
  double face_z(std::int64_t i, std::int64_t j, std::int64_t k) const;
  /// Open area of the cross-section of cell (i, j).
  double area(std::int64_t i, std::int64_t j) const;

  std::int64_t active_cells() const;

 private:
  std::int64_t nx_, ny_, nz_;
  double radius_;
  std::vector<double> phi_;  // (nx+1, ny+1)
};

}  // namespace gpuphys
