// The multigrid cycle of references/global_solve/multigrid_*.cuh once more, plainly, on the host: matrices by
// the functions the device uses, vectors in FP64. For nvcc only.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "references/global_solve/multigrid_solver.cuh"

namespace gpuphys::testing {

using multigrid::Coarsening, multigrid::Gates, multigrid::Matrix, multigrid::Tuning;
using Field = std::vector<double>;

/// A matrix that owns its entries.
struct HostLevel {
  std::vector<float> diag, ax, ay, az;
  std::vector<Gates> gates;
  Matrix view;

  HostLevel(int nx, int ny, int nz, int pitch) {
    const std::size_t size = static_cast<std::size_t>(nx) * ny * pitch;
    for (auto* a : {&diag, &ax, &ay, &az}) a->assign(size, 0.0f);
    gates.assign(size, 0);
    view = {diag.data(), ax.data(), ay.data(), az.data(), nx, ny, nz, pitch};
  }

  HostLevel coarser(const Coarsening& rule, int pitch_multiple = 16) const {
    const auto half = [](int n) { return (n + 1) / 2; };
    const int nz = half(view.nz);
    HostLevel c(half(view.nx), half(view.ny), nz,
                (nz + pitch_multiple - 1) / pitch_multiple * pitch_multiple);
    c.each([&](int i, int j, int k, int at) {
      const multigrid::CoarseCell cell = multigrid::coarse_cell(view, i, j, k, rule);
      c.diag[at] = cell.diag, c.ax[at] = cell.ax, c.ay[at] = cell.ay, c.az[at] = cell.az;
      c.gates[at] = cell.gates;
    });
    return c;
  }

  template <class Body>
  void each(Body&& body) const {
    for (int i = 0; i < view.nx; ++i)
      for (int j = 0; j < view.ny; ++j)
        for (int k = 0; k < view.nz; ++k) body(i, j, k, view.at(i, j, k));
  }

  /// Sum of the couplings of a cell times value(entry of the neighbour).
  template <class Value>
  double neighbours(int i, int j, int k, Value&& value) const {
    double sum = 0;
    const int at = view.at(i, j, k), p = view.plane(), row = view.pitch;
    if (i + 1 < view.nx) sum += ax[at] * value(at + p);
    if (i > 0) sum += ax[at - p] * value(at - p);
    if (j + 1 < view.ny) sum += ay[at] * value(at + row);
    if (j > 0) sum += ay[at - row] * value(at - row);
    if (k + 1 < view.nz) sum += az[at] * value(at + 1);
    if (k > 0) sum += az[at - 1] * value(at - 1);
    return sum;
  }

  Field multiply(const Field& x) const {
    Field y(x.size(), 0.0);
    each([&](int i, int j, int k, int at) {
      y[at] = diag[at] * x[at] + neighbours(i, j, k, [&](int n) { return x[n]; });
    });
    return y;
  }
};

class HostMultigrid {
 public:
  /// `fine` has the layout of the device's level 0.
  HostMultigrid(HostLevel fine, bool singular, const Tuning& tuning) : tuning_(tuning) {
    levels_.push_back(std::move(fine));
    do {
      levels_.push_back(levels_.back().coarser(multigrid::coarsening_to(
          static_cast<int>(levels_.size()), singular, tuning.first_coupling, tuning.held_share)));
    } while (levels_.back().view.nx * levels_.back().view.ny * levels_.back().view.nz > 1);
  }

  const std::vector<HostLevel>& levels() const { return levels_; }

  /// One V(1,1) cycle for the right-hand side r from zero.
  Field cycle(const Field& r) const { return cycle(0, r); }

 private:
  static void relax(const HostLevel& l, const Field& rhs, const float (&omega)[2], Field& x) {
    for (int colour = 0; colour < 2; ++colour) {
      l.each([&](int i, int j, int k, int at) {
        if ((i + j + k + colour) % 2 != 0 || !(l.diag[at] > 0)) return;
        const double r = rhs[at] - l.diag[at] * x[at] - l.neighbours(i, j, k, [&](int n) { return x[n]; });
        x[at] += omega[colour] * r / l.diag[at];
      });
    }
  }

  Field cycle(std::size_t level, const Field& rhs) const {
    const HostLevel& l = levels_[level];
    Field x(rhs.size(), 0.0);
    if (level + 1 == levels_.size()) {
      if (l.diag[0] > 0) x[0] = rhs[0] / l.diag[0];
      return x;
    }
    relax(l, rhs, tuning_.omega_down, x);
    const HostLevel& c = levels_[level + 1];
    const Field ax = l.multiply(x);
    Field coarse_rhs(c.diag.size(), 0.0);
    l.each(
        [&](int i, int j, int k, int at) { coarse_rhs[c.view.at(i / 2, j / 2, k / 2)] += rhs[at] - ax[at]; });
    const Field e = cycle(level + 1, coarse_rhs);
    l.each([&](int i, int j, int k, int at) {
      const int parent = c.view.at(i / 2, j / 2, k / 2);
      const int index[3] = {i, j, k}, step[3] = {c.view.plane(), c.view.pitch, 1};
      double weight = 1, sum = e[parent];
      for (int axis = 0; axis < 3; ++axis) {
        const bool up = index[axis] % 2 == 1;
        if (c.gates[parent] >> (2 * axis + (up ? 0 : 1)) & 1) {
          sum += 0.25 * (e[parent + (up ? step[axis] : -step[axis])] - e[parent]);
        } else {
          weight *= multigrid::wall_weight(c.gates[parent]);
        }
      }
      x[at] += weight * sum;
    });
    relax(l, rhs, tuning_.omega_up, x);
    return x;
  }

  std::vector<HostLevel> levels_;
  Tuning tuning_;
};

}  // namespace gpuphys::testing
