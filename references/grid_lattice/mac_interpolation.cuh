// Trilinear sampling and back-tracing on a staggered (MAC) grid, for the advection references.
//
// Everything is in index space and relative to the face being updated: a sample point is an integer base
// (i,j,k), the same for the whole thread, plus a displacement of a few cells in FP32. Absolute positions
// would lose eight bits to the index (256 + fraction) and quadruple the error.
//
// The floor of a displacement comes from one addition: q + 1.5*2^23 rounded down leaves floor(q) in the low
// mantissa bits, which replaces FRND and F2I (a sixteenth-rate unit) by two full-rate additions. Grids are
// limited to 2^20 cells an axis by require_supported(), so that any displacement out of the trick's range
// also is out of the grid.
#pragma once

#include <cstdint>
#include <stdexcept>

#include "core/module.hpp"

namespace gpuphys::mac {

/// A velocity on an nx x ny x nz MAC grid; component c has one more sample along axis c. C order, z fastest.
struct Velocity {
  const float* __restrict__ u[3];
  int n[3];
  // Derived: samples in a plane of constant x; floor_bias times (plane + row + 1).
  int plane[3];
  unsigned bias[3];

  __host__ __device__ int extent(int component, int axis) const {
    return n[axis] + (component == axis ? 1 : 0);
  }
};

/// Throws when offsets would not fit in 32 bits or a cell index not in the floor trick's range.
inline void require_supported(const View<const float, 3>& ux, const View<const float, 3>& uy,
                              const View<const float, 3>& uz) {
  for (const auto* u : {&ux, &uy, &uz}) {
    for (const std::int64_t n : u->shape) {
      if (n >= (1 << 20)) throw std::runtime_error("grid extent above 2^20 is not supported");
    }
    if (u->size() >= (std::int64_t{1} << 31))
      throw std::runtime_error("more than 2^31 samples are not supported");
  }
}

struct Displacement {
  float x, y, z;
};

/// floor(q) and q - floor(q) for |q| < 2^21. The floor is held as the raw bits of q + 1.5*2^23, `bits -
/// floor_bias`, so that one subtraction serves a whole offset. The fraction is exact: both operands are
/// multiples of q's last bit.
struct FloorFraction {
  unsigned bits;
  float fraction;
};
constexpr unsigned floor_bias = 0x4B400000u;
__device__ __forceinline__ FloorFraction floor_fraction(float q) {
  constexpr float magic = 12582912.0f;  // 1.5 * 2^23
  const float shifted = __fadd_rd(q, magic);
  return {__float_as_uint(shifted), q - (shifted - magic)};
}

__device__ __forceinline__ float lerp(float a, float b, float t) {
  return a + t * (b - a);
}

/// Where sample point `base + offset(C) + d` lies between the samples of component E along one axis.
/// offset(c) is 0 along axis c and 1/2 along the others, so the shift between C and E is 0 or +-1/2.
template <int C, int E, int Axis>
__device__ __forceinline__ FloorFraction axis_position(float d) {
  if constexpr ((C == Axis) == (E == Axis)) {
    return floor_fraction(d);
  } else {
    return floor_fraction(d + (E == Axis ? 0.5f : -0.5f));
  }
}

// ---- the fast path: faces on the lower sides of cells, every axis with at least two samples ----

/// One axis as seen from one cell: sample positions are kept in [low, high], and lower neighbours at most at
/// `cap`, so that both neighbours exist and a point at the upper end has fraction 1. Second entries: of the
/// component that is staggered along the axis and has one more sample there. `cap` carries the offset of
/// floor_fraction().
struct Axis {
  float low, high[2], cap[2];
};
__device__ __forceinline__ Axis make_axis(int cell, int n_cells) {
  constexpr float magic = 12582912.0f;
  const float room = static_cast<float>(n_cells - cell);
  return {static_cast<float>(-cell), {room - 1.0f, room}, {magic + (room - 2.0f), magic + (room - 1.0f)}};
}

/// A cell of the march: pointers to its sample of each component, its axes, and the distance to the lower
/// neighbour of each component along each axis (0 at the wall, where the value is extended).
struct Cell {
  const float* __restrict__ at[3];
  Axis axis[3];
  int down[3][3];
};

/// Position along one axis of the sample point of face C displaced by d, among the samples of component E.
template <int C, int E, int A>
__device__ __forceinline__ FloorFraction clamped_position(const Cell& cell, float d) {
  constexpr float magic = 12582912.0f;
  constexpr int own = E == A ? 1 : 0;
  if constexpr ((C == A) != (E == A)) d += E == A ? 0.5f : -0.5f;
  const float q = fminf(fmaxf(d, cell.axis[A].low), cell.axis[A].high[own]);
  const float shifted = fminf(__fadd_rd(q, magic), cell.axis[A].cap[own]);
  return {__float_as_uint(shifted), q - (shifted - magic)};
}

/// Between two neighbours along z. __ldg: the field is never written here, so that loads may move across
/// stores.
__device__ __forceinline__ float row(const float* p, float t) {
  return lerp(__ldg(p), __ldg(p + 1), t);
}

/// Component E at the cell's lower face C displaced by d (in cells).
template <int C, int E>
__device__ __forceinline__ float sample(const Velocity& v, const Cell& cell, Displacement d) {
  const FloorFraction x = clamped_position<C, E, 0>(cell, d.x);
  const FloorFraction y = clamped_position<C, E, 1>(cell, d.y);
  const FloorFraction z = clamped_position<C, E, 2>(cell, d.z);
  const unsigned ny = static_cast<unsigned>(v.extent(E, 1)), nz = static_cast<unsigned>(v.extent(E, 2));
  const int offset = static_cast<int>((x.bits * ny + y.bits) * nz + z.bits - v.bias[E]);
  const float* p00 = cell.at[E] + offset;
  const float* p01 = p00 + nz;
  const float* p10 = p00 + v.plane[E];
  const float* p11 = p10 + nz;
  const float a = lerp(row(p00, z.fraction), row(p01, z.fraction), y.fraction);
  const float b = lerp(row(p10, z.fraction), row(p11, z.fraction), y.fraction);
  return lerp(a, b, x.fraction);
}

/// All components at the cell's lower face C displaced by d.
template <int C>
__device__ __forceinline__ Displacement velocity(const Velocity& v, const Cell& cell, Displacement d) {
  return {sample<C, 0>(v, cell, d), sample<C, 1>(v, cell, d), sample<C, 2>(v, cell, d)};
}

/// Component E at the cell's lower face C itself: the sample when E = C; else four times the mean of the four
/// samples around the face (the caller folds the quarter into its scale).
template <int C, int E>
__device__ __forceinline__ float face_sum(const Velocity& v, const Cell& cell) {
  if constexpr (C == E) {
    return __ldg(cell.at[E]);
  } else {
    // Along axis C the samples of E lie half a cell on either side of the face; along axis E likewise, the
    // upper one always there because E has one more sample on that axis.
    const float* p = cell.at[E];
    const float* q = p - cell.down[E][C];
    const int up = E == 2 ? 1 : E == 1 ? v.extent(E, 2) : v.plane[E];
    return (__ldg(p) + __ldg(p + up)) + (__ldg(q) + __ldg(q + up));
  }
}

/// `scale` times the velocity at the cell's lower face C.
template <int C>
__device__ __forceinline__ Displacement face_displacement(const Velocity& v, const Cell& cell, float scale) {
  const float quarter = 0.25f * scale;
  return {(C == 0 ? scale : quarter) * face_sum<C, 0>(v, cell),
          (C == 1 ? scale : quarter) * face_sum<C, 1>(v, cell),
          (C == 2 ? scale : quarter) * face_sum<C, 2>(v, cell)};
}

__device__ __forceinline__ Displacement scaled(float scale, Displacement u) {
  return {scale * u.x, scale * u.y, scale * u.z};
}

/// Cell (i,j,k), to be moved along x by advance().
__device__ __forceinline__ Cell make_cell(const Velocity& v, int i, int j, int k) {
  Cell cell;
  for (int e = 0; e < 3; ++e) {
    cell.at[e] = v.u[e] + (i * v.extent(e, 1) + j) * v.extent(e, 2) + k;
    cell.down[e][0] = i > 0 ? v.plane[e] : 0;
    cell.down[e][1] = j > 0 ? v.extent(e, 2) : 0;
    cell.down[e][2] = k > 0 ? 1 : 0;
  }
  cell.axis[0] = make_axis(i, v.n[0]);
  cell.axis[1] = make_axis(j, v.n[1]);
  cell.axis[2] = make_axis(k, v.n[2]);
  return cell;
}

/// Cell (i+1,j,k) from cell (i,j,k).
__device__ __forceinline__ void advance(const Velocity& v, Cell& cell) {
  for (int e = 0; e < 3; ++e) {
    cell.at[e] += v.plane[e];
    cell.down[e][0] = v.plane[e];
  }
  Axis& x = cell.axis[0];
  x = {x.low - 1.0f, {x.high[0] - 1.0f, x.high[1] - 1.0f}, {x.cap[0] - 1.0f, x.cap[1] - 1.0f}};
}

// ---- the general path: any face, any extent ----

/// `scale` times a velocity, kept within the range of floor_fraction(); no grid is that large, so the clamp
/// at the hull of the samples absorbs the difference.
__device__ __forceinline__ Displacement limited(float scale, Displacement u) {
  constexpr float limit = 1048576.0f;
  return {fminf(fmaxf(scale * u.x, -limit), limit), fminf(fmaxf(scale * u.y, -limit), limit),
          fminf(fmaxf(scale * u.z, -limit), limit)};
}

/// Component E at face (i,j,k) of component C displaced by d; outside the hull of its samples, the value at
/// the hull.
template <int C, int E>
__device__ __forceinline__ float clamped_sample(const Velocity& v, int i, int j, int k, Displacement d) {
  const FloorFraction x = axis_position<C, E, 0>(d.x);
  const FloorFraction y = axis_position<C, E, 1>(d.y);
  const FloorFraction z = axis_position<C, E, 2>(d.z);
  const int nx = v.extent(E, 0), ny = v.extent(E, 1), nz = v.extent(E, 2);
  const float* u = v.u[E];
  const auto clamped = [](int index, int n) { return min(max(index, 0), n - 1); };
  const int xi = i + static_cast<int>(x.bits - floor_bias), yi = j + static_cast<int>(y.bits - floor_bias),
            zi = k + static_cast<int>(z.bits - floor_bias);
  const int x0 = clamped(xi, nx), x1 = clamped(xi + 1, nx), y0 = clamped(yi, ny), y1 = clamped(yi + 1, ny),
            z0 = clamped(zi, nz), z1 = clamped(zi + 1, nz);
  const auto row = [&](int a, int b) {
    const float* p = u + (a * ny + b) * nz;
    return lerp(p[z0], p[z1], z.fraction);
  };
  return lerp(lerp(row(x0, y0), row(x0, y1), y.fraction), lerp(row(x1, y0), row(x1, y1), y.fraction),
              x.fraction);
}

template <int C>
__device__ __forceinline__ Displacement clamped_velocity(const Velocity& v, int i, int j, int k,
                                                         Displacement d) {
  return {clamped_sample<C, 0>(v, i, j, k, d), clamped_sample<C, 1>(v, i, j, k, d),
          clamped_sample<C, 2>(v, i, j, k, d)};
}

inline Velocity make_velocity(const View<const float, 3>& ux, const View<const float, 3>& uy,
                              const View<const float, 3>& uz) {
  require_supported(ux, uy, uz);
  Velocity v{{ux.data, uy.data, uz.data},
             {static_cast<int>(uy.shape[0]), static_cast<int>(ux.shape[1]), static_cast<int>(ux.shape[2])},
             {},
             {}};
  for (int c = 0; c < 3; ++c) {
    v.plane[c] = v.extent(c, 1) * v.extent(c, 2);
    v.bias[c] = floor_bias * static_cast<unsigned>(v.plane[c] + v.extent(c, 2) + 1);
  }
  return v;
}

}  // namespace gpuphys::mac
