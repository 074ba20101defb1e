// surface_tension_phase_field: force mu grad(phi) of a phase field, mu = 4 beta phi (phi - 1)(phi - 1/2) -
// kappa laplacian(phi), both derivatives with the 19 points of a D3Q19 lattice, periodic, FP32.
//
// Mapping: a block owns a tile of the (y,z) plane, a warp one row of it, a thread four neighbouring cells,
// and all march along x. Of every plane a thread reads rows y-1, y, y+1 and gets what lies beside its cells
// along z from its neighbours in the warp:
//
//     y+1    l | 4 cells | r          per plane and thread: 3 loads of 16 bytes, 6 shuffles
//     y      l | 4 cells | r          (lanes at the ends of a tile load l, r themselves)
//     y-1    l | 4 cells | r
//
// What bounds it: DRAM, 16 bytes per cell, 2139 MB at paper size. phi comes from memory once: a warp asks for
// its own row two planes ahead, and when its neighbours need that row as their y+-1, it is in L1. Only the
// two planes at the ends of a march (1 in 34) and the rows around a tile are read again, from L2. About 60
// instructions per cell, a little under half of the issue slots at that speed.
//
// The trick: no plane is kept. What x-1 and x+1 contribute is four numbers per cell, all differences within
// their own plane or between centres of neighbouring planes, so that constants cancel exactly:
//
//     cross = sum over y+-1, z+-1 of (phi - centre)/6      laplacian += cross(x+-1) + (centre(x+-1) -
//     centre(x)) up_y  = phi(y+1) - phi(y-1), up_z likewise           d/dx = (cross + centre)(x+1) - (cross +
//     centre)(x-1), halved
#include "cases/grid_lattice/surface_tension_phase_field.hpp"

#include <algorithm>

#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::surface_tension_phase_field {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
struct Policy {
  static constexpr int rows = 3, blocks_per_sm = 2, planes = 7;
};
#else
struct Policy {
  static constexpr int rows = 8;           // of a tile: warps per block
  static constexpr int blocks_per_sm = 2;  // that must fit an SM (limits registers)
  static constexpr int planes = 64;        // of a march, about
};
#endif

struct Forces {
  float *fx, *fy, *fz;
};

constexpr unsigned kWholeWarp = 0xffffffffu;

/// Where a thread's rows lie in a plane, and who knows what lies beside them.
struct Place {
  int row[3];                ///< offsets of its cells at y-1, y, y+1
  int left, right;           ///< steps from its first cell to the ones beside
  bool ask_left, ask_right;  ///< a neighbour in the warp has them
};

/// One plane as it was loaded.
template <int N>
struct Raw {
  float cells[3][N];
  float left[3], right[3];  ///< only where no neighbour has them
};

/// All of a plane but the thread's own row.
template <int N>
__device__ __forceinline__ void load_around(const float* plane, const Place& place, Raw<N>& raw) {
  lbm::load_pack(plane + place.row[0], raw.cells[0]);
  lbm::load_pack(plane + place.row[2], raw.cells[2]);
#pragma unroll
  for (int r = 0; r < 3; ++r) {
    raw.left[r] = place.ask_left ? 0.0f : __ldg(plane + place.row[r] + place.left);
    raw.right[r] = place.ask_right ? 0.0f : __ldg(plane + place.row[r] + place.right);
  }
}

template <int N>
__device__ __forceinline__ Raw<N> load_plane(const float* plane, const Place& place) {
  Raw<N> raw;
  lbm::load_pack(plane + place.row[1], raw.cells[1]);
  load_around(plane, place, raw);
  return raw;
}

/// What a plane gives to the derivatives of its own cells and to those of the planes beside it.
template <int N>
struct Plane {
  float centre[N], cross[N], up_y[N], up_z[N];  // for the planes beside it
  float laplacian[N], slope_y[N], slope_z[N];   // for itself
};

template <int N>
__device__ __forceinline__ Plane<N> terms(const Raw<N>& raw, const Place& place) {
  float v[3][N + 2];  // rows y-1, y, y+1 from z-1 to z+N
#pragma unroll
  for (int r = 0; r < 3; ++r) {
    const float left = __shfl_up_sync(kWholeWarp, raw.cells[r][N - 1], 1),
                right = __shfl_down_sync(kWholeWarp, raw.cells[r][0], 1);
    v[r][0] = place.ask_left ? left : raw.left[r];
    v[r][N + 1] = place.ask_right ? right : raw.right[r];
#pragma unroll
    for (int n = 0; n < N; ++n) v[r][n + 1] = raw.cells[r][n];
  }
  Plane<N> p;
#pragma unroll
  for (int n = 0; n < N; ++n) {
    const float c = v[1][n + 1];
    const float axis = ((v[0][n + 1] - c) + (v[2][n + 1] - c)) + ((v[1][n] - c) + (v[1][n + 2] - c));
    const float edge = ((v[0][n] - c) + (v[2][n + 2] - c)) + ((v[0][n + 2] - c) + (v[2][n] - c));
    p.centre[n] = c;
    p.cross[n] = axis * (1.0f / 6);
    p.up_y[n] = v[2][n + 1] - v[0][n + 1];
    p.up_z[n] = v[1][n + 2] - v[1][n];
    p.laplacian[n] = axis * (1.0f / 3) + edge * (1.0f / 6);
    p.slope_y[n] = p.up_y[n] * (1.0f / 6) + ((v[2][n] - v[0][n]) + (v[2][n + 2] - v[0][n + 2])) * (1.0f / 12);
    p.slope_z[n] = p.up_z[n] * (1.0f / 6) + ((v[0][n + 2] - v[0][n]) + (v[2][n + 2] - v[2][n])) * (1.0f / 12);
  }
  return p;
}

/// Forces of `planes` planes on one tile, `width` packs of N cells wide; blockIdx.x counts tiles along z
/// first. Lanes and warps beyond the end of a tile or of the grid repeat other cells and store nothing.
template <int N>
__global__ void __launch_bounds__(32 * Policy::rows, Policy::blocks_per_sm)
    march(const float* __restrict__ phi, const Forces out, const __grid_constant__ lbm::Grid grid,
          const int width, const int planes, const float four_beta, const float kappa) {
  const int packs = grid.nz / N, tiles = (packs + width - 1) / width, lane = static_cast<int>(threadIdx.x);
  const int tile_y = static_cast<int>(blockIdx.x) / tiles,
            tile_z = static_cast<int>(blockIdx.x) - tile_y * tiles;
  const int row = tile_y * Policy::rows + static_cast<int>(threadIdx.y), column = tile_z * width + lane;
  const int j = min(row, grid.ny - 1), pack = min(column, packs - 1), k = N * pack;
  const bool stores = row < grid.ny && column < packs && lane < width;
  const std::int64_t area = static_cast<std::int64_t>(grid.ny) * grid.nz;

  Place place;
  place.row[0] = lbm::neighbour<-1>(j, grid.ny) * grid.nz + k;
  place.row[1] = j * grid.nz + k;
  place.row[2] = lbm::neighbour<1>(j, grid.ny) * grid.nz + k;
  place.left = pack == 0 ? grid.nz - 1 : -1;
  place.right = pack == packs - 1 ? N - grid.nz : N;
  place.ask_left = pack != 0 && lane != 0;
  place.ask_right = pack != packs - 1 && lane < width - 1;

  const int first = static_cast<int>(blockIdx.y) * planes, end = min(first + planes, grid.nx);
  const auto plane = [&](int i) { return phi + (i < grid.nx ? i : i - grid.nx) * area; };
  Plane<N> before = terms(load_plane<N>(phi + lbm::neighbour<-1>(first, grid.nx) * area, place), place);
  Plane<N> here = terms(load_plane<N>(plane(first), place), place);
  Raw<N> next = load_plane<N>(plane(first + 1), place);
  float ahead[N];  // of the plane after the next
  lbm::load_pack(plane(min(first + 2, end)) + place.row[1], ahead);
  for (int i = first; i < end; ++i) {
    const Plane<N> after = terms(next, place);
    // On their way while this plane is worked on; at the end the same again.
    load_around(plane(min(i + 2, end)), place, next);
#pragma unroll
    for (int n = 0; n < N; ++n) next.cells[1][n] = ahead[n];
    lbm::load_pack(plane(min(i + 3, end)) + place.row[1], ahead);
    float fx[N], fy[N], fz[N];
#pragma unroll
    for (int n = 0; n < N; ++n) {
      const float c = here.centre[n];
      const float laplacian = here.laplacian[n] + ((after.cross[n] + (after.centre[n] - c)) +
                                                   (before.cross[n] + (before.centre[n] - c)));
      const float mu = four_beta * c * (c - 1.0f) * (c - 0.5f) - kappa * laplacian;
      fx[n] = mu * (0.5f * ((after.cross[n] - before.cross[n]) + (after.centre[n] - before.centre[n])));
      fy[n] = mu * (here.slope_y[n] + (after.up_y[n] + before.up_y[n]) * (1.0f / 12));
      fz[n] = mu * (here.slope_z[n] + (after.up_z[n] + before.up_z[n]) * (1.0f / 12));
    }
    if (stores) {
      const std::int64_t at = i * area + place.row[1];
      lbm::store_pack(out.fx + at, fx);
      lbm::store_pack(out.fy + at, fy);
      lbm::store_pack(out.fz + at, fz);
    }
    before = here;
    here = after;
  }
}

struct Reference {
  void allocate(const Inputs& in, const Outputs<float>&) { grid_of(in); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const lbm::Grid grid = grid_of(in);
    const Forces forces{out.fx.data, out.fy.data, out.fz.data};
    // Marches of equal length, at most 65,535 of them.
    const int marches = std::clamp(grid.nx / Policy::planes, 1, 65535),
              planes = (grid.nx + marches - 1) / marches;
    const auto launch = [&](auto cells) {
      constexpr int N = decltype(cells)::value;
      // Tiles of equal width, at most a warp wide.
      const int packs = grid.nz / N, tiles = (packs + 31) / 32, width = (packs + tiles - 1) / tiles;
      const int stacked = (grid.ny + Policy::rows - 1) / Policy::rows;
      const dim3 blocks(static_cast<unsigned>(((packs + width - 1) / width) * stacked),
                        static_cast<unsigned>((grid.nx + planes - 1) / planes));
      march<N><<<blocks, dim3(32, Policy::rows)>>>(in.phi.data, forces, grid, width, planes, 4.0f * in.beta,
                                                   in.kappa);
    };
    if (lbm::in_packs<4>(in.phi.data, out.fx.data, grid.nz) &&
        lbm::in_packs<4>(out.fy.data, out.fz.data, 4)) {
      launch(std::integral_constant<int, 4>{});
    } else {
      launch(std::integral_constant<int, 1>{});
    }
  }

 private:
  static lbm::Grid grid_of(const Inputs& in) {
    return lbm::make_grid(in.phi.shape[0], in.phi.shape[1], in.phi.shape[2]);
  }
};

}  // namespace
}  // namespace gpuphys::surface_tension_phase_field

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(surface_tension_phase_field, surface_tension_phase_field::Reference)
}
