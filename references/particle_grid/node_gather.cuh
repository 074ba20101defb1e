// From the nodes of a collocated grid to particles by quadratic B-splines: what g2p_mpm and
// velocity_gradient_mpm share. FP32. (references/blocks/tile_gather.cuh has the passes.)
#pragma once

#include "references/blocks/tile_gather.cuh"
#include "references/common/quadratic_bspline.cuh"

namespace gpuphys::node_gather {

constexpr int kComponents = 3;

/// 1,024 particles a tile where there are eight a cell.
using Tiling = tiles::Tiling<4, 4, 8, 2, false, true>;
using Tile = tiles::Tile<Tiling, kComponents>;
using Source = tiles::Samples<kComponents>;

struct Policy {
  static constexpr int mark_threads = 256;
  static constexpr int mark_stride = 32;  // one row of 32 particles in so many
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int plan_threads = 128;
  static constexpr int count_threads = 512;
  static constexpr int count_shared = 40 * 1024;  // takes half the tiles of the paper's size
  static constexpr int place_threads = 128;
  static constexpr int gather_threads = 128;
  static constexpr int piece = 320;
  static constexpr int result_stride = 3;
  static constexpr int gather_blocks_per_sm = 6;
#else
  static constexpr int plan_threads = 256;
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int place_threads = 256;
  static constexpr int gather_threads = 256;
  static constexpr int piece = 512;  // half a full tile: 38 KB of shared memory a block
  static constexpr int gather_blocks_per_sm = 4;
  static constexpr int result_stride = 4;  // float4: three, padded to two whole sectors
#endif
};

__device__ __forceinline__ tiles::Along3 along(float t) {
  const bspline::Weights s = bspline::quadratic(t);
  return {{s.w[0], s.w[1], s.w[2]}, {s.slope[0], s.slope[1], s.slope[2]}};
}

/// Velocity and its change per cell along each axis, at a particle.
struct Local {
  float v[3];
  float per_cell[3][3];  ///< [component][axis]
};

template <class Tile>
__device__ __forceinline__ Local at_particle(const Tile& tile, const tiles::Placed& placed) {
  const tiles::Along3 x = along(placed.place[0]), y = along(placed.place[1]), z = along(placed.place[2]);
  const int lowest = Tile::lowest_of(placed.cell);
  Local at;
#pragma unroll
  for (int c = 0; c < kComponents; ++c) {
    const tiles::Sum27 sum = tiles::sum_27<Tile>(tile.values[c] + lowest, x, y, z);
    at.v[c] = sum.value;
#pragma unroll
    for (int d = 0; d < 3; ++d) at.per_cell[c][d] = sum.first[d];
  }
  return at;
}

/// Of inputs with node arrays ux, uy, uz.
template <class Inputs>
Source samples_of(const Inputs& in) {
  Source s{{in.ux.data, in.uy.data, in.uz.data}, {}};
  for (auto& extent : s.extent) {
    for (int d = 0; d < 3; ++d) extent[d] = static_cast<int>(in.ux.shape[d]);
  }
  return s;
}

template <class Inputs>
tiles::TileGrid grid_of(const Inputs& in) {
  return tiles::make_tile_grid<Tiling>(in.ux.shape[0], in.ux.shape[1], in.ux.shape[2], in.dx);
}

}  // namespace gpuphys::node_gather
