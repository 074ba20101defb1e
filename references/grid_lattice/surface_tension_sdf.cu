// surface_tension_sdf: surface-tension force -sigma kappa delta grad(phi) in the band |phi| < 1.5 dx of a
// level set, zero elsewhere, FP32.
//
// Mapping: a block takes a stretch of the flat array, every thread some packs of four cells along it. It
// reads phi, writes zeros, and puts the cells of the band into a queue in shared memory. Then the threads
// take one queued cell each, whatever stretch of the block it came from:
//
//     phi      ..... ....B BB... ..... ...BB B....        B: |phi| < 1.5 dx
//     queue    B B B B B B                                one lane each, no lane idles for its neighbours
//
// What bounds it: DRAM, 16 bytes per cell, 2147 MB at paper size. Of 134 M cells some 0.7 M lie in the band.
// A row that crosses the interface has about three of them, so that a fifth of all warps would run the 250
// instructions of a force three times over with one or two lanes; the queue makes one or two dense warps of
// them per block.
//
// The second differences are formed from differences of neighbours, which are exact or nearly so near the
// interface; kappa dx, which is clamped to [-1, 1], needs no division by dx.
#include "cases/grid_lattice/surface_tension_sdf.hpp"

#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::surface_tension_sdf {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
struct Policy {
  static constexpr int threads = 128, packs = 1;
};
#else
struct Policy {
  static constexpr int threads = 256;  // per block
  static constexpr int packs = 2;      // per thread, read before the first is used
};
#endif

struct Forces {
  float *fx, *fy, *fz;
};

struct Law {
  float half_width;  // of the band, m
  float per_dx;      // 1/dx
  float strength;    // sigma / (1.5 dx) / dx: what the unit curvature 1/dx is worth
};

/// What a difference along one axis reads: the neighbours' offsets, zero at an end of the array.
struct Steps {
  int up, down;
};
__device__ __forceinline__ Steps steps(int index, int n, int stride) {
  return {index + 1 < n ? stride : 0, index > 0 ? -stride : 0};
}

/// The mixed second difference times dx of two axes, about `at`.
__device__ __forceinline__ float mixed(const float* at, const Steps& a, const Steps& b, float per_dx) {
  return ((__ldg(at + a.up + b.up) - __ldg(at + a.up + b.down)) -
          (__ldg(at + a.down + b.up) - __ldg(at + a.down + b.down))) *
         (0.25f * per_dx);
}

/// Writes the force of one cell of the band.
__device__ __forceinline__ void write_force(const float* __restrict__ phi, const Forces& out, int cell,
                                            const lbm::Grid& grid, const Law& law) {
  const int row = cell / grid.nz, k = cell - row * grid.nz, i = row / grid.ny, j = row - i * grid.ny;
  const Steps x = steps(i, grid.nx, grid.ny * grid.nz), y = steps(j, grid.ny, grid.nz),
              z = steps(k, grid.nz, 1);
  const float* at = phi + cell;
  const float centre = __ldg(at);
  const float x_up = __ldg(at + x.up), x_down = __ldg(at + x.down), y_up = __ldg(at + y.up),
              y_down = __ldg(at + y.down), z_up = __ldg(at + z.up), z_down = __ldg(at + z.down);
  const float xy = mixed(at, x, y, law.per_dx), xz = mixed(at, x, z, law.per_dx),
              yz = mixed(at, y, z, law.per_dx);
  const float half = 0.5f * law.per_dx;
  const float gx = (x_up - x_down) * half, gy = (y_up - y_down) * half, gz = (z_up - z_down) * half;
  const float xx = ((x_up - centre) - (centre - x_down)) * law.per_dx,
              yy = ((y_up - centre) - (centre - y_down)) * law.per_dx,
              zz = ((z_up - centre) - (centre - z_down)) * law.per_dx;
  const float pure = gx * gx * (yy + zz) + gy * gy * (xx + zz) + gz * gz * (xx + yy);
  const float twist = gx * gy * xy + gx * gz * xz + gy * gz * yz;
  const float steepness = gx * gx + gy * gy + gz * gz + 0x1p-40f;
  const float curvature = fminf(fmaxf((pure - 2.0f * twist) / (steepness * sqrtf(steepness)), -1.0f), 1.0f);
  // (1 + cos(pi t)) / 2 = cos(pi t / 2)^2, without cancellation near the edge of the band.
  const float cosine = cospif(0.5f * centre / law.half_width);
  const float size = -law.strength * curvature * (cosine * cosine);
  out.fx[cell] = size * gx;
  out.fy[cell] = size * gy;
  out.fz[cell] = size * gz;
}

template <int N>
__global__ void __launch_bounds__(Policy::threads)
    band_forces(const float* __restrict__ phi, const Forces out, const __grid_constant__ lbm::Grid grid,
                const __grid_constant__ Law law) {
  constexpr int per_block = Policy::threads * Policy::packs * N;
  __shared__ unsigned short queue[per_block];
  __shared__ int queued;
  if (threadIdx.x == 0) queued = 0;
  const std::int64_t first = static_cast<std::int64_t>(blockIdx.x) * per_block;
  float values[Policy::packs][N];
#pragma unroll
  for (int p = 0; p < Policy::packs; ++p) {
    const std::int64_t cell = first + N * (p * Policy::threads + static_cast<int>(threadIdx.x));
    if (cell < grid.plane) lbm::load_pack(phi + cell, values[p]);
  }
  __syncthreads();
  const float nothing[N] = {};
#pragma unroll
  for (int p = 0; p < Policy::packs; ++p) {
    const int slot = N * (p * Policy::threads + static_cast<int>(threadIdx.x));
    const std::int64_t cell = first + slot;
    if (cell >= grid.plane) continue;
    lbm::store_pack(out.fx + cell, nothing);
    lbm::store_pack(out.fy + cell, nothing);
    lbm::store_pack(out.fz + cell, nothing);
#pragma unroll
    for (int n = 0; n < N; ++n) {
      if (fabsf(values[p][n]) < law.half_width)
        queue[atomicAdd(&queued, 1)] = static_cast<unsigned short>(slot + n);
    }
  }
  __syncthreads();  // after it, the zeros of the whole block are in place
  const int count = queued;
  for (int q = static_cast<int>(threadIdx.x); q < count; q += Policy::threads)
    write_force(phi, out, static_cast<int>(first) + queue[q], grid, law);
}

struct Reference {
  void allocate(const Inputs& in, const Outputs<float>&) { grid_of(in); }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const lbm::Grid grid = grid_of(in);
    const float per_dx = 1.0f / in.dx;
    const Law law{1.5f * in.dx, per_dx, in.sigma * per_dx * (per_dx / 1.5f)};
    const Forces forces{out.fx.data, out.fy.data, out.fz.data};
    const auto launch = [&](auto cells) {
      constexpr int N = decltype(cells)::value, per_block = Policy::threads * Policy::packs * N;
      const std::int64_t blocks = (grid.plane + per_block - 1) / per_block;
      band_forces<N><<<static_cast<unsigned>(blocks), Policy::threads>>>(in.phi.data, forces, grid, law);
    };
    if (lbm::in_packs<4>(in.phi.data, out.fx.data, grid.plane) &&
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
}  // namespace gpuphys::surface_tension_sdf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(surface_tension_sdf, surface_tension_sdf::Reference)
}
