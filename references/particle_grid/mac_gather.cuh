// From the faces of a MAC grid to particles: what g2p_pic_flip (hat kernel, order 1) and g2p_apic (quadratic
// B-splines, order 2) share. FP32. (references/blocks/tile_gather.cuh has the passes,
// references/particle_grid/mac_scatter.cuh draws which faces a cell reaches.)
//
// A particle's place is kept from the nearest whole cell: s in [-1/2, 1/2], below 0 in the upper half of its
// cell c. Along an axis, of the component that has its faces on whole cells there (own) and of the two that
// have them in the middle (other):
//
//                       lowest sample                     distance from it (order 1) or from the one after it
//                       (order 2)
//   order 1, own        c                                 s, or 1 + s in the upper half
//   order 1, other      c - 1, or c in the upper half     s + 1/2
//   order 2, own        c - 1, or c in the upper half     s
//   order 2, other      c - 1                             s - 1/2, or s + 1/2 in the upper half
#pragma once

#include "core/contract/view.hpp"
#include "references/blocks/tile_gather.cuh"
#include "references/common/quadratic_bspline.cuh"

namespace gpuphys::mac_gather {

constexpr int kComponents = 3;

/// 1,024 particles a tile where there are eight a cell.
template <int Order>
using Tiling = tiles::Tiling<4, 4, 8, Order, true, true>;
template <int Order>
using Tile = tiles::Tile<Tiling<Order>, kComponents>;

/// Where a component's samples begin along an axis, from c - 1 on, and the distance drawn above.
struct Start {
  int sample;
  float distance;
};
template <int Order>
__device__ __forceinline__ Start start(float s, bool own) {
  const bool upper = s < 0.0f;
  if (Order == 1) return own ? Start{1, upper ? 1.0f + s : s} : Start{upper ? 1 : 0, s + 0.5f};
  return own ? Start{upper ? 1 : 0, s} : Start{0, upper ? s + 0.5f : s - 0.5f};
}

/// Component C by the hat kernel: differences of neighbours times fractions, so that what they share is not
/// rounded.
template <int C>
__device__ __forceinline__ float trilinear(const Tile<1>& tile, const tiles::Placed& placed) {
  using T = Tile<1>;
  const Start x = start<1>(placed.place[0], C == 0), y = start<1>(placed.place[1], C == 1),
              z = start<1>(placed.place[2], C == 2);
  const float* at =
      tile.values[C] + T::lowest_of(placed.cell) + x.sample * T::kPlane + y.sample * T::kRow + z.sample;
  const auto between = [](float a, float b, float t) { return a + t * (b - a); };
  const auto row = [&](int i, int j) {
    const float* r = at + i * T::kPlane + j * T::kRow;
    return between(r[0], r[1], z.distance);
  };
  const auto plane = [&](int i) { return between(row(i, 0), row(i, 1), y.distance); };
  return between(plane(0), plane(1), x.distance);
}

/// Weights of three samples, and their first moments, weight times (sample - particle) in cells.
__device__ __forceinline__ tiles::Along3 weights_and_moments(float t) {
  const bspline::Weights s = bspline::quadratic(t);
  return {{s.w[0], s.w[1], s.w[2]}, {-s.w[0] * (1.0f + t), -s.w[1] * t, s.w[2] * (1.0f - t)}};
}

/// Component C by quadratic B-splines: value, and first moments in cells.
template <int C>
__device__ __forceinline__ tiles::Sum27 quadratic(const Tile<2>& tile, const tiles::Placed& placed) {
  using T = Tile<2>;
  const Start x = start<2>(placed.place[0], C == 0), y = start<2>(placed.place[1], C == 1),
              z = start<2>(placed.place[2], C == 2);
  const float* at =
      tile.values[C] + T::lowest_of(placed.cell) + x.sample * T::kPlane + y.sample * T::kRow + z.sample;
  return tiles::sum_27<T>(at, weights_and_moments(x.distance), weights_and_moments(y.distance),
                          weights_and_moments(z.distance));
}

/// Extents of the components of three arrays.
inline void set_extents(int (&extent)[kComponents][3], const View<const float, 3>& ux,
                        const View<const float, 3>& uy, const View<const float, 3>& uz) {
  const View<const float, 3>* u[kComponents] = {&ux, &uy, &uz};
  for (int c = 0; c < kComponents; ++c) {
    for (int d = 0; d < 3; ++d) extent[c][d] = static_cast<int>(u[c]->shape[d]);
  }
}

/// Of the box whose faces these are.
template <int Order>
tiles::TileGrid grid_of(const View<const float, 3>& ux, const View<const float, 3>& uy,
                        const View<const float, 3>& uz, float dx) {
  return tiles::make_tile_grid<Tiling<Order>>(ux.shape[0], uy.shape[1], uz.shape[2], dx);
}

}  // namespace gpuphys::mac_gather
