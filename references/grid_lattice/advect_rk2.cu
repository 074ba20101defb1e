// advect_rk2: semi-Lagrangian self-advection of a MAC-grid velocity, midpoint (RK2) back-tracing, FP32.
//
// For every face: velocity at the face, half a step back, velocity there, a full step back with it, own
// component there.
//
// Mapping: a thread owns one column of cells along x; its block owns a tile of `tile_z` x `tile_y` columns
// and marches `march_x` cells along x. At each cell the thread updates the three faces on the cell's lower
// sides, so that all three components of a neighbourhood are gathered by one SM while they sit in its L1. The
// faces that close the grid on the upper side (i = nx of ux, j = ny of uy, k = nz of uz) belong to no cell;
// the first blocks of the launch take them.
//
// What bounds it: L1, not DRAM. Per cell there are 18 distinct loads for the velocities at the three faces
// (exact means of four), 72 for the midpoints and 24 for the departure points, nearly all L1 hits. A warp's
// load of 32 neighbours along z starts anywhere, so it spans two lines and takes 1.8 wavefronts (measured);
// at 75 % of the L1 data pipe and 61 % of the issue slots the kernel is a third above what that pipe alone
// would take. What pays is fewer instructions around those loads: floors are one rounded-down addition whose
// raw bits go straight into the offset, walls are float minima and maxima along each axis instead of index
// clamps or branches, a point costs four row pointers. Tried and dropped: a branch to an unclamped path for
// points clear of the walls (0.76 ms; the lanes near z walls drag a quarter of all warps through both), 16 x
// 2 lanes a warp (0.66), three blocks an SM instead of four (0.60), one component a launch (0.77).
#include "cases/grid_lattice/advect_rk2.hpp"
#include "references/grid_lattice/mac_interpolation.cuh"

namespace gpuphys::advect_rk2 {
namespace {

struct Policy {
  static constexpr int tile_z = 32;  // one warp along the contiguous index
  static constexpr int tile_y = 4;   // rows of a block share most of their midpoint and departure rows in L1
  static constexpr int march_x = 4;  // cells a thread visits along x: planes stay in L1 meanwhile
  static constexpr int threads = tile_z * tile_y;
  static constexpr int blocks_per_sm = 8;
};

struct Result {
  float* __restrict__ u[3];
};

// Cells travelled per unit velocity: back to the midpoint, and back to the departure point.
struct Trace {
  float to_midpoint, to_departure;
};

// Face (i,j,k) of component C by the path that is correct everywhere.
template <int C>
__device__ __noinline__ float advected_clamped(const mac::Velocity& v, Trace trace, int i, int j, int k) {
  const mac::Displacement k1 = mac::clamped_velocity<C>(v, i, j, k, {0.0f, 0.0f, 0.0f});
  const mac::Displacement midpoint = mac::limited(trace.to_midpoint, k1);
  const mac::Displacement k2 = mac::clamped_velocity<C>(v, i, j, k, midpoint);
  const mac::Displacement departure = mac::limited(trace.to_departure, k2);
  return mac::clamped_sample<C, C>(v, i, j, k, departure);
}

// The cell's lower face of component C.
template <int C>
__device__ __forceinline__ float advected(const mac::Velocity& v, const mac::Cell& cell, Trace trace) {
  const mac::Displacement midpoint = mac::face_displacement<C>(v, cell, trace.to_midpoint);
  const mac::Displacement k2 = mac::velocity<C>(v, cell, midpoint);
  const mac::Displacement departure = mac::scaled(trace.to_departure, k2);
  return mac::sample<C, C>(v, cell, departure);
}

__device__ __forceinline__ void store(const mac::Velocity& v, const Result& result, int c, int i, int j,
                                      int k, float value) {
  result.u[c][(i * v.extent(c, 1) + j) * v.extent(c, 2) + k] = value;
}

// Face number f of those that the march does not visit: i = nx of ux, then j = ny of uy, then k = nz of uz.
__device__ void update_upper_face(const mac::Velocity& v, const Result& result, Trace trace, int f) {
  const int nx = v.n[0], ny = v.n[1], nz = v.n[2];
  if (f < ny * nz)
    return store(v, result, 0, nx, f / nz, f % nz, advected_clamped<0>(v, trace, nx, f / nz, f % nz));
  f -= ny * nz;
  if (f < nx * nz)
    return store(v, result, 1, f / nz, ny, f % nz, advected_clamped<1>(v, trace, f / nz, ny, f % nz));
  f -= nx * nz;
  if (f < nx * ny)
    return store(v, result, 2, f / ny, f % ny, nz, advected_clamped<2>(v, trace, f / ny, f % ny, nz));
}

// One thread a cell, general path: grids of a single cell along some axis.
__global__ void advect_thin(const __grid_constant__ mac::Velocity v, const __grid_constant__ Result result,
                            Trace trace) {
  const int f = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (f >= v.n[0] * v.n[1] * v.n[2]) return;
  const int i = f / v.n[2] / v.n[1], j = f / v.n[2] % v.n[1], k = f % v.n[2];
  store(v, result, 0, i, j, k, advected_clamped<0>(v, trace, i, j, k));
  store(v, result, 1, i, j, k, advected_clamped<1>(v, trace, i, j, k));
  store(v, result, 2, i, j, k, advected_clamped<2>(v, trace, i, j, k));
}

struct Tiling {
  int upper_blocks, tiles_z, tiles_y;
};

__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    advect(const __grid_constant__ mac::Velocity v, const __grid_constant__ Result result,
           const __grid_constant__ Trace trace, const __grid_constant__ Tiling tiling) {
  const int block = static_cast<int>(blockIdx.x) - tiling.upper_blocks;
  if (block < 0) {
    return update_upper_face(v, result, trace,
                             static_cast<int>(blockIdx.x) * Policy::threads + static_cast<int>(threadIdx.x));
  }
  const int tile_z = block % tiling.tiles_z, tile_y = block / tiling.tiles_z % tiling.tiles_y,
            tile_x = block / tiling.tiles_z / tiling.tiles_y;
  const int k = tile_z * Policy::tile_z + static_cast<int>(threadIdx.x) % Policy::tile_z;
  const int j = tile_y * Policy::tile_y + static_cast<int>(threadIdx.x) / Policy::tile_z;
  if (k >= v.n[2] || j >= v.n[1]) return;
  const int begin = tile_x * Policy::march_x, end = min(begin + Policy::march_x, v.n[0]);
  mac::Cell cell = mac::make_cell(v, begin, j, k);
  for (int i = begin; i < end; ++i) {
    // All three before the first store: their chains of dependent gathers overlap.
    const float x = advected<0>(v, cell, trace), y = advected<1>(v, cell, trace),
                z = advected<2>(v, cell, trace);
    store(v, result, 0, i, j, k, x);
    store(v, result, 1, i, j, k, y);
    store(v, result, 2, i, j, k, z);
    mac::advance(v, cell);
  }
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) { mac::require_supported(in.ux, in.uy, in.uz); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const mac::Velocity v = mac::make_velocity(in.ux, in.uy, in.uz);
    const float step = in.dt / in.dx;
    const Trace trace{-0.5f * step, -step};
    const Result result{{out.ux.data, out.uy.data, out.uz.data}};
    const auto blocks = [](int n, int per_block) { return (n + per_block - 1) / per_block; };
    const int upper = v.n[1] * v.n[2] + v.n[0] * v.n[2] + v.n[0] * v.n[1];
    const Tiling tiling{blocks(upper, Policy::threads), blocks(v.n[2], Policy::tile_z),
                        blocks(v.n[1], Policy::tile_y)};
    int tiles = tiling.tiles_z * tiling.tiles_y * blocks(v.n[0], Policy::march_x);
    if (v.n[0] < 2 || v.n[1] < 2 || v.n[2] < 2) {
      tiles = 0;
      const int cells = v.n[0] * v.n[1] * v.n[2];
      advect_thin<<<static_cast<unsigned>(blocks(cells, 128)), 128>>>(v, result, trace);
    }
    advect<<<static_cast<unsigned>(tiling.upper_blocks + tiles), Policy::threads>>>(v, result, trace, tiling);
  }
};

}  // namespace
}  // namespace gpuphys::advect_rk2

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(advect_rk2, advect_rk2::Reference)
}
