// Trilinear sampling on a staggered (MAC) grid, for the advection references.
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

#include "core/contract/module.hpp"

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
__device__ __forceinline__ Displacement operator*(float scale, Displacement d) {
  return {scale * d.x, scale * d.y, scale * d.z};
}
__device__ __forceinline__ Displacement operator+(Displacement a, Displacement b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}

/// floor(q) and q - floor(q) for |q| < 2^21. The floor is held as the raw bits of q + floor_shift, `bits -
/// floor_bias`, so that one subtraction serves a whole offset. The fraction is exact: both operands are
/// multiples of q's last bit.
struct FloorFraction {
  unsigned bits;
  float fraction;
};
constexpr float floor_shift = 12582912.0f;  // 1.5 * 2^23
constexpr unsigned floor_bias = 0x4B400000u;

__device__ __forceinline__ float lerp(float a, float b, float t) {
  return a + t * (b - a);
}

/// One axis as seen from one cell: sample positions are kept in [low, high], and lower neighbours at most at
/// `cap`, so that both neighbours exist and a point at the upper end has fraction 1; where the axis has a
/// single sample, that is both. Second entries: of the component that is staggered along the axis and has one
/// more sample there. `cap` carries floor_shift.
struct Axis {
  float low, high[2], cap[2];
};
__device__ __forceinline__ Axis make_axis(int cell, int n_cells) {
  const float room = static_cast<float>(n_cells - cell), low = static_cast<float>(-cell);
  return {low, {room - 1.0f, room}, {floor_shift + fmaxf(room - 2.0f, low), floor_shift + (room - 1.0f)}};
}

/// A cell of the march, or one beyond the upper walls whose lower face closes the grid: pointers to its
/// sample of each component, its axes, and the distance to the lower neighbour of each component along each
/// axis (0 at the wall, where the value is extended).
struct Cell {
  const float* __restrict__ at[3];
  Axis axis[3];
  int down[3][3];
};

/// Position along one axis of the sample point of face C displaced by d, among the samples of component E.
template <int C, int E, int A>
__device__ __forceinline__ FloorFraction clamped_position(const Cell& cell, float d) {
  constexpr int own = E == A ? 1 : 0;
  if constexpr ((C == A) != (E == A)) d += E == A ? 0.5f : -0.5f;
  const float q = fminf(fmaxf(d, cell.axis[A].low), cell.axis[A].high[own]);
  const float shifted = fminf(__fadd_rd(q, floor_shift), cell.axis[A].cap[own]);
  return {__float_as_uint(shifted), q - (shifted - floor_shift)};
}

/// The eight samples around a point, z fastest, and the point's fractions between them.
struct Stencil {
  float u[8];
  float x, y, z;

  __device__ __forceinline__ float value() const {
    const float a = lerp(lerp(u[0], u[1], z), lerp(u[2], u[3], z), y);
    const float b = lerp(lerp(u[4], u[5], z), lerp(u[6], u[7], z), y);
    return lerp(a, b, x);
  }
  __device__ __forceinline__ float smallest() const {
    return fminf(fminf(fminf(u[0], u[1]), fminf(u[2], u[3])), fminf(fminf(u[4], u[5]), fminf(u[6], u[7])));
  }
  __device__ __forceinline__ float largest() const {
    return fmaxf(fmaxf(fmaxf(u[0], u[1]), fmaxf(u[2], u[3])), fmaxf(fmaxf(u[4], u[5]), fmaxf(u[6], u[7])));
  }
};

/// What grid a point is looked up in: one whose axes all have two samples or more, or any.
enum class Extent { two_or_more, any };

/// Around the cell's lower face C displaced by d (in cells), in a field on the samples of component E; `at`
/// is the field's value at the cell. __ldg: no field is written by the kernel that reads it, so that loads
/// may move across stores.
template <int C, int E, Extent extent = Extent::two_or_more>
__device__ __forceinline__ Stencil stencil(const Velocity& v, const Cell& cell, const float* at,
                                           Displacement d) {
  const FloorFraction x = clamped_position<C, E, 0>(cell, d.x);
  const FloorFraction y = clamped_position<C, E, 1>(cell, d.y);
  const FloorFraction z = clamped_position<C, E, 2>(cell, d.z);
  const unsigned ny = static_cast<unsigned>(v.extent(E, 1)), nz = static_cast<unsigned>(v.extent(E, 2));
  const int offset = static_cast<int>((x.bits * ny + y.bits) * nz + z.bits - v.bias[E]);
  const auto single = [&](int axis) { return extent == Extent::any && v.extent(E, axis) == 1; };
  const unsigned up_y = single(1) ? 0 : nz;
  const int up_x = single(0) ? 0 : v.plane[E], up_z = single(2) ? 0 : 1;
  const float* p00 = at + offset;
  const float* p01 = p00 + up_y;
  const float* p10 = p00 + up_x;
  const float* p11 = p10 + up_y;
  return {{__ldg(p00), __ldg(p00 + up_z), __ldg(p01), __ldg(p01 + up_z), __ldg(p10), __ldg(p10 + up_z),
           __ldg(p11), __ldg(p11 + up_z)},
          x.fraction,
          y.fraction,
          z.fraction};
}

/// Component E at the cell's lower face C displaced by d.
template <int C, int E, Extent extent = Extent::two_or_more>
__device__ __forceinline__ float sample(const Velocity& v, const Cell& cell, Displacement d) {
  return stencil<C, E, extent>(v, cell, cell.at[E], d).value();
}

/// All components at the cell's lower face C displaced by d.
template <int C, Extent extent = Extent::two_or_more>
__device__ __forceinline__ Displacement velocity(const Velocity& v, const Cell& cell, Displacement d) {
  return {sample<C, 0, extent>(v, cell, d), sample<C, 1, extent>(v, cell, d),
          sample<C, 2, extent>(v, cell, d)};
}

/// What the velocities at the lower faces of two cells that follow each other along x have in common: samples
/// of ux in the plane between them, at the second cell and at its lower neighbours along y and z, and sums of
/// the pairs of uy and uz on either side of the first cell's centre.
struct Shared {
  float ux, ux_y, ux_z, uy_pair, uz_pair;
};
__device__ __forceinline__ Shared load_shared(const Velocity& v, const Cell& cell, const float* ux,
                                              const float* uy, const float* uz) {
  return {__ldg(ux), __ldg(ux - cell.down[0][1]), __ldg(ux - cell.down[0][2]),
          __ldg(uy) + __ldg(uy + v.extent(1, 2)), __ldg(uz) + __ldg(uz + 1)};
}
__device__ __forceinline__ Shared shared_with_last(const Velocity& v, const Cell& cell) {
  return load_shared(v, cell, cell.at[0], cell.at[1] - cell.down[1][0], cell.at[2] - cell.down[2][0]);
}
/// The compiler finds these loads among those of the cell's faces.
__device__ __forceinline__ Shared shared_with_next(const Velocity& v, const Cell& cell) {
  return load_shared(v, cell, cell.at[0] + v.plane[0], cell.at[1], cell.at[2]);
}

/// Component E at the cell's lower face C itself: the sample when E = C; else four times the mean of the four
/// samples around the face (the caller folds the quarter into its scale). `shared` is with the last cell.
template <int C, int E>
__device__ __forceinline__ float face_sum(const Velocity& v, const Cell& cell, const Shared& shared) {
  // Along axis C the samples of E lie half a cell on either side of the face; along axis E likewise, the
  // upper one always there because E has one more sample on that axis.
  const float* p = cell.at[E];
  const float* q = p - cell.down[E][C];
  const int up = E == 2 ? 1 : E == 1 ? v.extent(E, 2) : v.plane[E];
  if constexpr (C == E) {
    return E == 0 ? shared.ux : __ldg(p);
  } else if constexpr (E == 0) {
    return (shared.ux + __ldg(p + up)) + ((C == 1 ? shared.ux_y : shared.ux_z) + __ldg(q + up));
  } else if constexpr (C == 0) {
    return (__ldg(p) + __ldg(p + up)) + (E == 1 ? shared.uy_pair : shared.uz_pair);
  } else {
    return (__ldg(p) + __ldg(p + up)) + (__ldg(q) + __ldg(q + up));
  }
}

/// `scale` times the velocity at the cell's lower face C.
template <int C>
__device__ __forceinline__ Displacement face_displacement(const Velocity& v, const Cell& cell,
                                                          const Shared& shared, float scale) {
  const float quarter = 0.25f * scale;
  return {(C == 0 ? scale : quarter) * face_sum<C, 0>(v, cell, shared),
          (C == 1 ? scale : quarter) * face_sum<C, 1>(v, cell, shared),
          (C == 2 ? scale : quarter) * face_sum<C, 2>(v, cell, shared)};
}

/// Offset of sample (i,j,k) in the arrays of component c.
__device__ __forceinline__ int sample_offset(const Velocity& v, int c, int i, int j, int k) {
  return (i * v.extent(c, 1) + j) * v.extent(c, 2) + k;
}

/// Cell (i,j,k), to be moved along x by advance().
__device__ __forceinline__ Cell make_cell(const Velocity& v, int i, int j, int k) {
  Cell cell;
  for (int e = 0; e < 3; ++e) {
    cell.at[e] = v.u[e] + sample_offset(v, e, i, j, k);
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
