// Back-tracing and semi-Lagrangian advection on a staggered (MAC) grid: the traces of all schemes, and the
// march over the faces of a grid that the advection references share.
//
// A trace turns a face into a displacement, in cells. Its stages are displacements too, each what a whole or
// a half step with one velocity travels: differences of a few cells, so that FP32 keeps its digits, and no
// velocity is ever held.
//
// The march: a thread owns one column of cells along x; its block owns a tile of `tile_z` x `tile_y` columns
// and visits `march_x` cells along x. At each cell the thread updates the three faces on the cell's lower
// sides, so that all three components of a neighbourhood are gathered by one SM while they sit in its L1. The
// faces that close the grid on the upper side (i = nx of ux, j = ny of uy, k = nz of uz) belong to no cell;
// the first blocks of the launch take them.
#pragma once

#include "references/grid_lattice/mac_interpolation.cuh"

namespace gpuphys::mac {

// ---- faces ----

/// Face C on the lower side of a cell, as traces see it. `faces` says which faces this code must do for:
/// those of a grid with two or more samples an axis whose lower neighbours exist or lie behind a wall, or
/// any, those that close the grid included.
enum class Faces { lower, any };
template <int C, Faces faces>
struct Face {
  static constexpr int component = C;
  static constexpr Extent extent = faces == Faces::lower ? Extent::two_or_more : Extent::any;
  const Velocity& v;
  const Cell& cell;
  Shared shared;  // with the cell before; for Faces::lower
  int i, j, k;

  /// Of the face, in the arrays of its component.
  __device__ __forceinline__ int offset() const { return sample_offset(v, C, i, j, k); }

  /// `scale` times the velocity at the face itself.
  __device__ __forceinline__ Displacement start(float scale) const {
    if constexpr (faces == Faces::lower) {
      return face_displacement<C>(v, cell, shared, scale);
    } else {
      return travel(scale, {0.0f, 0.0f, 0.0f});
    }
  }

  /// `scale` times the velocity at the face displaced by d.
  __device__ __forceinline__ Displacement travel(float scale, Displacement d) const {
    return scale * velocity<C, extent>(v, cell, d);
  }

  /// The samples of the face's own component around the face displaced by d.
  __device__ __forceinline__ Stencil own(Displacement d) const { return own_of(cell.at[C], d); }

  /// The same of another field on these samples; `at` is its value at the face.
  __device__ __forceinline__ Stencil own_of(const float* at, Displacement d) const {
    return stencil<C, C, extent>(v, cell, at, d);
  }
};

// ---- traces; `step` is -dt/dx, the cells travelled back in time per unit velocity ----

/// Euler, first order: r = -s u(0).
struct EulerTrace {
  float step;

  template <class Face>
  __device__ __forceinline__ Displacement departure(const Face& face) const {
    return face.start(step);
  }
};

/// Midpoint rule (RK2), second order. Its two scales are constants of a launch, not products of a thread.
struct MidpointTrace {
  float to_midpoint, to_departure;
  explicit MidpointTrace(float step) : to_midpoint(0.5f * step), to_departure(step) {}

  template <class Face>
  __device__ __forceinline__ Displacement departure(const Face& face) const {
    const Displacement midpoint = face.start(to_midpoint);
    return face.travel(to_departure, midpoint);
  }
};

/// Ralston's RK3, third order: stages at 0, 1/2 and 3/4 of the step, weights 2/9, 3/9 and 4/9.
struct RalstonTrace {
  float step;

  template <class Face>
  __device__ __forceinline__ Displacement departure(const Face& face) const {
    const Displacement k1 = face.start(step);
    const Displacement k2 = face.travel(step, 0.5f * k1);
    const Displacement k3 = face.travel(step, 0.75f * k2);
    return 2.0f / 9 * k1 + 3.0f / 9 * k2 + 4.0f / 9 * k3;
  }
};

/// The classical RK4, fourth order. In halves of the step, so that the first three stages are sample points
/// as they are: r = (h1 + 2 h2 + 2 h3 + h4) / 3.
struct ClassicalTrace {
  float half;
  explicit ClassicalTrace(float step) : half(0.5f * step) {}

  template <class Face>
  __device__ __forceinline__ Displacement departure(const Face& face) const {
    const Displacement h1 = face.start(half);
    const Displacement h2 = face.travel(half, h1);
    const Displacement h3 = face.travel(half, h2);
    const Displacement h4 = face.travel(half, 2.0f * h3);
    return 1.0f / 3 * (h1 + h4) + 2.0f / 3 * (h2 + h3);
  }
};

// ---- the march ----

/// What the march does at a face: `update(face)` computes whatever `store(face, value)` keeps. This one: the
/// face's own component at the departure point of `Trace`.
template <class Trace>
struct SemiLagrangian {
  Trace trace;
  float* __restrict__ u[3];

  template <class Face>
  __device__ __forceinline__ float update(const Face& face) const {
    return face.own(trace.departure(face)).value();
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, float value) const {
    u[Face::component][face.offset()] = value;
  }
};

template <int C, class Action>
__device__ __noinline__ void update_any_face(const Velocity& v, const Action& action, int i, int j, int k) {
  const Cell cell = make_cell(v, i, j, k);
  const Face<C, Faces::any> face{v, cell, {}, i, j, k};
  action.store(face, action.update(face));
}

/// Face number f of those that the march does not visit: i = nx of ux, then j = ny of uy, then k = nz of uz.
template <class Action>
__device__ __forceinline__ void update_upper_face(const Velocity& v, const Action& action, int f) {
  const int nx = v.n[0], ny = v.n[1], nz = v.n[2];
  if (f < ny * nz) return update_any_face<0>(v, action, nx, f / nz, f % nz);
  f -= ny * nz;
  if (f < nx * nz) return update_any_face<1>(v, action, f / nz, ny, f % nz);
  f -= nx * nz;
  if (f < nx * ny) return update_any_face<2>(v, action, f / ny, f % ny, nz);
}

/// One thread a cell: grids of a single cell along some axis.
template <class Action>
__global__ void advect_thin(const __grid_constant__ Velocity v, const __grid_constant__ Action action) {
  const int f = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (f >= v.n[0] * v.n[1] * v.n[2]) return;
  const int i = f / v.n[2] / v.n[1], j = f / v.n[2] % v.n[1], k = f % v.n[2];
  update_any_face<0>(v, action, i, j, k);
  update_any_face<1>(v, action, i, j, k);
  update_any_face<2>(v, action, i, j, k);
}

/// The knobs of a march: lanes along z and rows along y of a block's tile, cells that a thread visits along
/// x, and resident blocks an SM, which bound the registers. One warp along z reads whole lines; a block's
/// rows share most of the rows they gather; planes stay in L1 while the block marches.
template <int z, int y, int x, int resident>
struct March {
  static constexpr int tile_z = z, tile_y = y, march_x = x, threads = z * y, blocks_per_sm = resident;
};

/// What all schemes use, with x cells a thread. The other choice is for the variant that shows that rounding
/// does not depend on it.
#ifdef GPUPHYS_OTHER_BLOCKS
template <int>
using TiledMarch = March<32, 2, 3, 8>;
#else
template <int x>
using TiledMarch = March<32, 4, x, 8>;
#endif

struct Tiling {
  int upper_blocks, tiles_z, tiles_y;
};

template <class Policy, class Action>
__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    advect(const __grid_constant__ Velocity v, const __grid_constant__ Action action,
           const __grid_constant__ Tiling tiling) {
  const int block = static_cast<int>(blockIdx.x) - tiling.upper_blocks;
  if (block < 0) return update_upper_face(v, action, static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x));
  const int tile_z = block % tiling.tiles_z, tile_y = block / tiling.tiles_z % tiling.tiles_y,
            tile_x = block / tiling.tiles_z / tiling.tiles_y;
  const int k = tile_z * Policy::tile_z + static_cast<int>(threadIdx.x) % Policy::tile_z;
  const int j = tile_y * Policy::tile_y + static_cast<int>(threadIdx.x) / Policy::tile_z;
  if (k >= v.n[2] || j >= v.n[1]) return;
  const int begin = tile_x * Policy::march_x, end = min(begin + Policy::march_x, v.n[0]);
  Cell cell = make_cell(v, begin, j, k);
  Shared shared = shared_with_last(v, cell);
  for (int i = begin; i < end; ++i) {
    const Face<0, Faces::lower> face_x{v, cell, shared, i, j, k};
    const Face<1, Faces::lower> face_y{v, cell, shared, i, j, k};
    const Face<2, Faces::lower> face_z{v, cell, shared, i, j, k};
    // All three before the first store: their chains of dependent gathers overlap.
    const auto x = action.update(face_x);
    const auto y = action.update(face_y);
    const auto z = action.update(face_z);
    action.store(face_x, x);
    action.store(face_y, y);
    action.store(face_z, z);
    shared = shared_with_next(v, cell);
    advance(v, cell);
  }
}

/// Does `action` at every face of the grid.
template <class Policy, class Action>
void launch_march(const Velocity& v, const Action& action) {
  const auto blocks = [](int n, int per_block) { return (n + per_block - 1) / per_block; };
  const int upper = v.n[1] * v.n[2] + v.n[0] * v.n[2] + v.n[0] * v.n[1];
  const Tiling tiling{blocks(upper, Policy::threads), blocks(v.n[2], Policy::tile_z),
                      blocks(v.n[1], Policy::tile_y)};
  int tiles = tiling.tiles_z * tiling.tiles_y * blocks(v.n[0], Policy::march_x);
  if (v.n[0] < 2 || v.n[1] < 2 || v.n[2] < 2) {
    tiles = 0;
    const int cells = v.n[0] * v.n[1] * v.n[2];
    advect_thin<<<static_cast<unsigned>(blocks(cells, 128)), 128>>>(v, action);
  }
  advect<Policy><<<static_cast<unsigned>(tiling.upper_blocks + tiles), Policy::threads>>>(v, action, tiling);
}

/// A solver that advects by one march with `Trace`.
template <class Policy, class Trace>
class SemiLagrangianSolver {
 public:
  template <class Inputs, class Outputs>
  void allocate(const Inputs& in, const Outputs&) {
    require_supported(in.ux, in.uy, in.uz);
  }

  template <class Inputs, class Outputs>
  void compute(const Inputs& in, const Outputs& out) {
    const float step = in.dt / in.dx;
    const SemiLagrangian<Trace> action{Trace{-step}, {out.ux.data, out.uy.data, out.uz.data}};
    launch_march<Policy>(make_velocity(in.ux, in.uy, in.uz), action);
  }
};

}  // namespace gpuphys::mac
