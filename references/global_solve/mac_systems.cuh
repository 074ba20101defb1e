// Seven-point systems of fluids on a staggered (MAC) grid with cut cells, in the layout that the multigrid of
// this folder takes: implicit viscosity of one velocity component, and pressure.
//
// All systems of a grid of nx x ny x nz cells have that many entries. In that of component c, entry (i,j,k)
// is the face on the upper side of cell (i,j,k) along c:
//
//      wall     0     1     2   wall        faces of a row of cells along c, by their entries;
//        |  .  |  .  |  .  |  .  |          the last entry is the wall's face: never an unknown
//              (four cells, three unknowns)
//
// A face is open where w > 0 and it is not on the outside of the box.
//
// Mapping: one thread per entry, z fastest. Bound by DRAM: 21 bytes written per entry, the rest through L1.
#pragma once

#include <cstdint>
#include <type_traits>

#include "core/contract/module.hpp"
#include "references/common/device_buffer.cuh"
#include "references/global_solve/multigrid_solver.cuh"

namespace gpuphys::mac_systems {

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kThreads = 96;
#else
constexpr int kThreads = 256;  // per block
#endif

/// Arrays of a MAC grid: component c has one face more along axis c than there are cells.
struct Grid {
  int n[3];
  __host__ __device__ int cells() const { return n[0] * n[1] * n[2]; }
  __host__ __device__ int extent(int c, int axis) const { return n[axis] + (c == axis ? 1 : 0); }
  __host__ __device__ int faces(int c) const { return extent(c, 0) * extent(c, 1) * extent(c, 2); }
  /// Of face (i,j,k) in the array of component c.
  __host__ __device__ int face(int c, int i, int j, int k) const {
    return (i * extent(c, 1) + j) * extent(c, 2) + k;
  }
};

struct Open {
  const float* w[3];
};

inline Grid make_grid(const View<const float, 3>& ux, const View<const float, 3>& uy) {
  const std::int64_t nx = uy.shape[0], ny = ux.shape[1], nz = ux.shape[2];
  if ((nx + 1) * (ny + 1) * (nz + 4) >= (std::int64_t{1} << 31))
    throw std::runtime_error("MAC grid: 2^31 faces of a component and more are not supported");
  return {{static_cast<int>(nx), static_cast<int>(ny), static_cast<int>(nz)}};
}

/// The open fraction of face (i,j,k) of component c, 0 if it is on the outside of the box.
template <int C>
__device__ __forceinline__ float open_fraction(const Grid& g, const float* w, int i, int j, int k) {
  const int own = C == 0 ? i : C == 1 ? j : k;
  return own > 0 && own < g.n[C] ? __ldg(w + g.face(C, i, j, k)) : 0.0f;
}

/// A system as the multigrid takes it.
struct System {
  float *diag, *ax, *ay, *az, *b;
  bool* active;
};

/// What suits viscosity: its mass term is up to an eighth of the first coarse diagonals where alpha is 4 and
/// more. Counted as held, cells beside walls along which fluid slips would take half of a correction, and a
/// cycle would reduce the residual at alpha = 16 by 0.31 instead of 0.14.
constexpr multigrid::Tuning kViscosityTuning{.held_share = 0.12f, .leave_out_empty_planes = false};
constexpr multigrid::Tuning kPressureTuning{.leave_out_empty_planes = false};

/// Memory for the systems of a grid, one after the other, and for their solutions.
class SystemBuffers {
 public:
  void allocate(const Grid& g) {
    const auto cells = static_cast<std::size_t>(g.cells());
    for (auto* v : {&diag_, &a_[0], &a_[1], &a_[2], &b_, &x_}) *v = DeviceBuffer<float>(cells);
    active_ = DeviceBuffer<bool>(cells);
  }
  System system() const {
    return {diag_.get(), a_[0].get(), a_[1].get(), a_[2].get(), b_.get(), active_.get()};
  }
  float* solution() const { return x_.get(); }

  void solve(multigrid::Solver& solver, float tolerance) {
    solver.solve(diag_.get(), a_[0].get(), a_[1].get(), a_[2].get(), b_.get(), active_.get(), tolerance,
                 x_.get());
  }

 private:
  DeviceBuffer<float> diag_, a_[3], b_, x_;
  DeviceBuffer<bool> active_;
};

/// The cell of a thread; false beyond the last.
__device__ __forceinline__ bool own_cell(const Grid& g, int& entry, int& i, int& j, int& k) {
  entry = static_cast<int>(blockIdx.x * static_cast<unsigned>(kThreads) + threadIdx.x);
  if (entry >= g.cells()) return false;
  const int row = entry / g.n[2];
  k = entry - row * g.n[2], i = row / g.n[1], j = row - i * g.n[1];
  return true;
}

/// w u + alpha sum over neighbours (u - u_n) = w u*, of component C: neighbours beyond the array along a wall
/// do not count, closed ones are at rest.
template <int C>
__global__ void __launch_bounds__(kThreads)
    assemble_viscosity(const __grid_constant__ Grid g, const float* __restrict__ w,
                       const float* __restrict__ start, const float alpha, const System s) {
  int entry, i, j, k;
  if (!own_cell(g, entry, i, j, k)) return;
  if constexpr (C == 0) ++i;
  if constexpr (C == 1) ++j;
  if constexpr (C == 2) ++k;
  const float open = open_fraction<C>(g, w, i, j, k);
  const bool unknown = open > 0.0f;
  // Every neighbour within the array counts in the diagonal; an open one on the upper side is coupled.
  const auto coupling = [&](int a, int b, int c) {
    return unknown && open_fraction<C>(g, w, a, b, c) > 0.0f ? -alpha : 0.0f;
  };
  const bool up_x = i + 1 < g.extent(C, 0), up_y = j + 1 < g.extent(C, 1), up_z = k + 1 < g.extent(C, 2);
  const int neighbours = (i > 0) + (j > 0) + (k > 0) + up_x + up_y + up_z;
  s.diag[entry] = unknown ? open + static_cast<float>(neighbours) * alpha : 0.0f;
  s.ax[entry] = up_x ? coupling(i + 1, j, k) : 0.0f;
  s.ay[entry] = up_y ? coupling(i, j + 1, k) : 0.0f;
  s.az[entry] = up_z ? coupling(i, j, k + 1) : 0.0f;
  s.b[entry] = unknown ? open * __ldg(start + g.face(C, i, j, k)) : 0.0f;
  s.active[entry] = unknown;
}

/// Entries of component C to its faces; the wall's faces, which have no entry of their own, are set to zero.
template <int C>
__global__ void __launch_bounds__(kThreads)
    write_component(const __grid_constant__ Grid g, const float* __restrict__ x, float* __restrict__ u) {
  const int f = static_cast<int>(blockIdx.x * static_cast<unsigned>(kThreads) + threadIdx.x);
  if (f >= g.faces(C)) return;
  const int row = f / g.extent(C, 2), k = f - row * g.extent(C, 2), i = row / g.extent(C, 1),
            j = row - i * g.extent(C, 1);
  const int own = C == 0 ? i : C == 1 ? j : k;
  const int entry = ((i - (C == 0)) * g.n[1] + (j - (C == 1))) * g.n[2] + (k - (C == 2));
  u[f] = own > 0 && own < g.n[C] ? __ldg(x + entry) : 0.0f;
}

inline unsigned blocks_for(int items) {
  return static_cast<unsigned>((items + kThreads - 1) / kThreads);
}

/// Viscosity of component C: `start` to `u`, which may be the same array.
template <int C>
void apply_viscosity(const Grid& g, const Open& open, const float* start, float alpha, float tolerance,
                     SystemBuffers& buffers, multigrid::Solver& solver, float* u) {
  assemble_viscosity<C><<<blocks_for(g.cells()), kThreads>>>(g, open.w[C], start, alpha, buffers.system());
  buffers.solve(solver, tolerance);
  write_component<C><<<blocks_for(g.faces(C)), kThreads>>>(g, buffers.solution(), u);
}

/// Pressure: sum over the open faces of a cell w (q - q_n) = -(outflow of u), for a u that is finite on open
/// faces. q is the pressure times dt / (rho dx): a difference of it is a velocity.
__global__ void __launch_bounds__(kThreads)
    assemble_pressure(const __grid_constant__ Grid g, const Open open, const float* __restrict__ ux,
                      const float* __restrict__ uy, const float* __restrict__ uz, const System s) {
  int entry, i, j, k;
  if (!own_cell(g, entry, i, j, k)) return;
  const float w[6] = {open_fraction<0>(g, open.w[0], i, j, k), open_fraction<0>(g, open.w[0], i + 1, j, k),
                      open_fraction<1>(g, open.w[1], i, j, k), open_fraction<1>(g, open.w[1], i, j + 1, k),
                      open_fraction<2>(g, open.w[2], i, j, k), open_fraction<2>(g, open.w[2], i, j, k + 1)};
  const auto flow = [](float fraction, const float* at) {
    return fraction > 0.0f ? fraction * __ldg(at) : 0.0f;
  };
  const float along_x = flow(w[1], ux + g.face(0, i + 1, j, k)) - flow(w[0], ux + g.face(0, i, j, k)),
              along_y = flow(w[3], uy + g.face(1, i, j + 1, k)) - flow(w[2], uy + g.face(1, i, j, k)),
              along_z = flow(w[5], uz + g.face(2, i, j, k + 1)) - flow(w[4], uz + g.face(2, i, j, k));
  const float diagonal = (w[0] + w[1]) + (w[2] + w[3]) + (w[4] + w[5]);
  s.diag[entry] = diagonal;
  s.ax[entry] = 0.0f - w[1];
  s.ay[entry] = 0.0f - w[3];
  s.az[entry] = 0.0f - w[5];
  s.b[entry] = 0.0f - (along_x + along_y + along_z);
  s.active[entry] = diagonal > 0.0f;
}

/// Takes the gradient of q out of the open faces of component C; closed faces are at rest. `reflected`, if
/// given, receives 2 (result) - (start).
template <int C>
__global__ void __launch_bounds__(kThreads)
    subtract_gradient(const __grid_constant__ Grid g, const float* __restrict__ w,
                      const float* __restrict__ q, const float* start, float* result, float* reflected) {
  const int f = static_cast<int>(blockIdx.x * static_cast<unsigned>(kThreads) + threadIdx.x);
  if (f >= g.faces(C)) return;
  const int row = f / g.extent(C, 2), k = f - row * g.extent(C, 2), i = row / g.extent(C, 1),
            j = row - i * g.extent(C, 1);
  const bool open = open_fraction<C>(g, w, i, j, k) > 0.0f;
  const float before = start[f];
  float after = 0.0f;
  if (open) {
    const int above = (i * g.n[1] + j) * g.n[2] + k;
    const int below = above - (C == 0 ? g.n[1] * g.n[2] : C == 1 ? g.n[2] : 1);
    after = before - (__ldg(q + above) - __ldg(q + below));
  }
  result[f] = after;
  if (reflected) reflected[f] = open ? 2.0f * after - before : 0.0f;
}

/// Projects `start` to `result`, which may be the same arrays; `reflected` null, or arrays for
/// 2 (result) - (start).
inline void project(const Grid& g, const Open& open, float* const (&start)[3], float tolerance,
                    SystemBuffers& buffers, multigrid::Solver& solver, float* const (&result)[3],
                    float* const* reflected = nullptr) {
  assemble_pressure<<<blocks_for(g.cells()), kThreads>>>(g, open, start[0], start[1], start[2],
                                                         buffers.system());
  buffers.solve(solver, tolerance);
  const auto finish = [&](auto component) {
    constexpr int C = decltype(component)::value;
    subtract_gradient<C><<<blocks_for(g.faces(C)), kThreads>>>(g, open.w[C], buffers.solution(), start[C],
                                                               result[C], reflected ? reflected[C] : nullptr);
  };
  finish(std::integral_constant<int, 0>{});
  finish(std::integral_constant<int, 1>{});
  finish(std::integral_constant<int, 2>{});
}

}  // namespace gpuphys::mac_systems
