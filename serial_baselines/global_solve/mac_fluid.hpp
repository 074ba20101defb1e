// Viscosity and pressure projection on a staggered grid with cut cells, for the serial baselines of the fluid
// steps, from their specifications alone.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/parallel.hpp"
#include "core/contract/view.hpp"
#include "serial_baselines/global_solve/box_multigrid.hpp"

namespace gpuphys::serial {

template <class Real>
using FaceField = std::array<View<Real, 3>, 3>;  ///< one array per component
using OpenFractions = std::array<View<const float, 3>, 3>;

/// Is a face open: w > 0, and not on the outside of the box?
inline bool is_open(const OpenFractions& w, std::size_t axis, std::int64_t i, std::int64_t j,
                    std::int64_t k) {
  const std::int64_t at[3] = {i, j, k};
  return at[axis] > 0 && at[axis] + 1 < w[axis].shape[axis] && w[axis](i, j, k) > 0;
}

/// visit(i, j, k) for every entry of an array of this shape.
template <class Visit>
void each_index(const std::int64_t* shape, Visit&& visit) {
  for (std::int64_t i = 0; i < shape[0]; ++i) {
    for (std::int64_t j = 0; j < shape[1]; ++j) {
      for (std::int64_t k = 0; k < shape[2]; ++k) visit(i, j, k);
    }
  }
}

/// One component after implicit viscosity; `alpha` = nu dt / dx^2.
template <class Real, class Start>
void viscous_component(const OpenFractions& w, std::size_t axis, Real alpha, Real tolerance,
                       const Start& start, const View<Real, 3>& out) {
  std::array<std::int64_t, 3> n{out.shape[0], out.shape[1], out.shape[2]};
  BoxSystem<Real> system(n);
  std::vector<Real> b(system.size(), Real(0));
  each_index(out.shape, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
    if (!is_open(w, axis, i, j, k)) return;
    const std::size_t c = system.flat(i, j, k);
    const Real open = static_cast<Real>(w[axis](i, j, k));
    b[c] = open * static_cast<Real>(start(i, j, k));
    Real held = 0;  // neighbours at which the velocity is zero
    for (std::size_t d = 0; d < 3; ++d) {
      for (const std::int64_t side : {-1, 1}) {
        std::int64_t at[3] = {i, j, k};
        at[d] += side;
        if (at[d] < 0 || at[d] >= n[d]) continue;  // beyond a wall along which fluid slips
        if (!is_open(w, axis, at[0], at[1], at[2])) {
          held += alpha;
        } else if (side == 1) {
          system.g[d][c] = alpha;
        }
      }
    }
    system.excess[c] = open + held;
  });
  BoxMultigrid<Real> multigrid(std::move(system));
  const std::vector<Real> x = multigrid.solve(b, tolerance);
  for (std::int64_t f = 0; f < out.size(); ++f) out.data[f] = x[static_cast<std::size_t>(f)];
}

/// All three, which do not depend on each other.
template <class Real, class Start>
void apply_viscosity(const OpenFractions& w, Real alpha, Real tolerance, const std::array<Start, 3>& start,
                     const FaceField<Real>& out) {
  parallel_for(3, [&](std::int64_t c) {
    const auto axis = static_cast<std::size_t>(c);
    viscous_component(w, axis, alpha, tolerance, start[axis], out[axis]);
  });
}

/// Storage for a velocity.
template <class Real>
class FaceStorage {
 public:
  explicit FaceStorage(const OpenFractions& w) {
    for (std::size_t c = 0; c < 3; ++c) {
      storage_[c].assign(static_cast<std::size_t>(w[c].size()), Real(0));
      field_[c] = {storage_[c].data(), {w[c].shape[0], w[c].shape[1], w[c].shape[2]}};
    }
  }
  const FaceField<Real>& field() const { return field_; }
  std::array<View<const Real, 3>, 3> samples() const {
    std::array<View<const Real, 3>, 3> views;
    for (std::size_t c = 0; c < 3; ++c)
      views[c] = {field_[c].data, {field_[c].shape[0], field_[c].shape[1], field_[c].shape[2]}};
    return views;
  }

 private:
  std::array<std::vector<Real>, 3> storage_;
  FaceField<Real> field_;
};

/// Sets closed faces to zero.
template <class Real>
void close_faces(const OpenFractions& w, const FaceField<Real>& u) {
  for (std::size_t c = 0; c < 3; ++c) {
    each_index(u[c].shape, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      if (!is_open(w, c, i, j, k)) u[c](i, j, k) = 0;
    });
  }
}

/// Takes the gradient out of u that its divergence asks for. `u` is zero on closed faces.
template <class Real>
void project(const OpenFractions& w, Real tolerance, const FaceField<Real>& u) {
  const std::int64_t n[3] = {w[1].shape[0], w[0].shape[1], w[0].shape[2]};
  BoxSystem<Real> system({n[0], n[1], n[2]});
  std::vector<Real> b(system.size(), Real(0));
  each_index(n, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
    const std::size_t cell = system.flat(i, j, k);
    Real outflow = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      std::int64_t at[3] = {i, j, k};
      if (is_open(w, d, at[0], at[1], at[2]))
        outflow -= static_cast<Real>(w[d](at[0], at[1], at[2])) * u[d](at[0], at[1], at[2]);
      ++at[d];
      if (is_open(w, d, at[0], at[1], at[2])) {
        const Real open = static_cast<Real>(w[d](at[0], at[1], at[2]));
        outflow += open * u[d](at[0], at[1], at[2]);
        system.g[d][cell] = open;
      }
    }
    b[cell] = -outflow;
  });
  BoxMultigrid<Real> multigrid(std::move(system));
  const std::vector<Real> q = multigrid.solve(b, tolerance);
  for (std::size_t d = 0; d < 3; ++d) {
    each_index(u[d].shape, [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      if (!is_open(w, d, i, j, k)) return;
      std::int64_t below[3] = {i, j, k};
      --below[d];
      const auto flat = [&](const std::int64_t* c) {
        return static_cast<std::size_t>((c[0] * n[1] + c[1]) * n[2] + c[2]);
      };
      const std::int64_t above[3] = {i, j, k};
      u[d](i, j, k) -= q[flat(above)] - q[flat(below)];
    });
  }
}

}  // namespace gpuphys::serial
