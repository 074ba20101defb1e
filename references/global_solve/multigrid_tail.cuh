// The small levels of the multigrid cycle in one launch: a cluster of blocks walks down from the first small
// level to a single cell and back up, with cluster barriers between the stages.
//
// Bound by latency (a barrier and an L2 round trip per stage), so every stage does as much as it can without
// one: both half-sweeps of the descent are one stage, because starting from zero the red values around a
// black cell follow directly from the right-hand side.
#pragma once

#include <cooperative_groups.h>

#include "references/global_solve/multigrid_smooth.cuh"

namespace gpuphys::multigrid {

struct TailPolicy {
  static constexpr int blocks = 8;         // of the cluster; the portable limit
  static constexpr int threads = 1024;     // of a block
  static constexpr int cells = 5000;       // levels up to this many cells belong to the tail
  static constexpr int solo_cells = 1024;  // levels up to this many cells are left to one block
  static constexpr int max_levels = 24;
};

struct TailLevel {
  Matrix a;
  const Gates* gates;
  float *x, *rhs;
};

struct TailArgs {
  TailLevel level[TailPolicy::max_levels];
  int levels;  // the last one has one cell
  int solo;    // first level that one block does alone
  const int* done;
  float omega[2][2];  // relaxation on the way down and up, of red and black cells
};

/// Sum over the couplings of cell (i,j,k) of coupling times value(neighbour's entry).
template <class Value>
__device__ __forceinline__ float neighbour_sum(const Matrix& a, int i, int j, int k, int at, Value&& value) {
  float sum = 0;
  if (i + 1 < a.nx) sum += a.ax[at] * value(at + a.plane());
  if (i > 0) sum += a.ax[at - a.plane()] * value(at - a.plane());
  if (j + 1 < a.ny) sum += a.ay[at] * value(at + a.pitch);
  if (j > 0) sum += a.ay[at - a.pitch] * value(at - a.pitch);
  if (k + 1 < a.nz) sum += a.az[at] * value(at + 1);
  if (k > 0) sum += a.az[at - 1] * value(at - 1);
  return sum;
}

struct Cell {
  int i, j, k, at;
};
__device__ __forceinline__ Cell cell_of(const Matrix& a, int index) {
  const int k = index % a.nz, j = (index / a.nz) % a.ny, i = index / (a.nz * a.ny);
  return {i, j, k, a.at(i, j, k)};
}

/// One half-sweep; (i + j + k) even is red (0).
__device__ __forceinline__ void relax_colour(const TailLevel& l, int colour, float omega, int first,
                                             int stride) {
  const Matrix& a = l.a;
  const int half = (a.nz + 1) / 2;
  for (int q = first; q < a.nx * a.ny * half; q += stride) {
    const int row = q / half, i = row / a.ny, j = row - i * a.ny;
    const int k = 2 * (q - row * half) + ((i + j + colour) & 1);
    if (k >= a.nz) continue;
    const int at = a.at(i, j, k);
    const float diag = a.diag[at], x = l.x[at];
    const float r = l.rhs[at] - diag * x - neighbour_sum(a, i, j, k, at, [&](int n) { return l.x[n]; });
    if (diag > 0) l.x[at] = x + omega * reciprocal(diag) * r;
  }
}

__device__ __forceinline__ void relax_from_zero(const TailLevel& l, const float (&omega)[2], int first,
                                                int stride) {
  const Matrix& a = l.a;
  const auto red = [&](int n) { return a.diag[n] > 0 ? omega[0] * reciprocal(a.diag[n]) * l.rhs[n] : 0.0f; };
  for (int q = first; q < a.nx * a.ny * a.nz; q += stride) {
    const Cell c = cell_of(a, q);
    float x = 0;
    if (((c.i + c.j + c.k) & 1) == 0) {
      x = red(c.at);
    } else if (a.diag[c.at] > 0) {
      x = omega[1] * reciprocal(a.diag[c.at]) * (l.rhs[c.at] - neighbour_sum(a, c.i, c.j, c.k, c.at, red));
    }
    l.x[c.at] = x;
  }
}

/// Eight neighbouring lanes take the residuals of a coarse cell's children.
__device__ __forceinline__ void restrict_residual(const TailLevel& fine, const TailLevel& coarse, int first,
                                                  int stride) {
  const Matrix &a = fine.a, &b = coarse.a;
  const int lane = first % 32, children = 8 * b.nx * b.ny * b.nz;
  for (int q = first; q - lane < children; q += stride) {  // whole warps
    float r = 0;
    Cell c{};
    if (q < children) {
      c = cell_of(b, q / 8);
      const int i = 2 * c.i + ((q >> 2) & 1), j = 2 * c.j + ((q >> 1) & 1), k = 2 * c.k + (q & 1);
      if (i < a.nx && j < a.ny && k < a.nz) {
        const int at = a.at(i, j, k);
        r = fine.rhs[at] - a.diag[at] * fine.x[at] -
            neighbour_sum(a, i, j, k, at, [&](int n) { return fine.x[n]; });
      }
    }
#pragma unroll
    for (int offset = 4; offset; offset >>= 1) r += __shfl_xor_sync(0xffffffffu, r, offset);
    if (q < children && q % 8 == 0) coarse.rhs[c.at] = r;
  }
}

__device__ __forceinline__ void add_correction(const TailLevel& fine, const TailLevel& coarse, int first,
                                               int stride) {
  const Matrix &a = fine.a, &b = coarse.a;
  for (int q = first; q < a.nx * a.ny * a.nz; q += stride) {
    const Cell c = cell_of(a, q);
    const int parent = b.at(c.i >> 1, c.j >> 1, c.k >> 1);
    const unsigned gates = coarse.gates[parent];
    const float e = coarse.x[parent];
    float weight = 1.0f;
    const auto towards = [&](int index, int axis, int step) {
      const bool up = (index & 1) != 0;
      if (gates & ((up ? 1u : 2u) << (2 * axis))) return coarse.x[parent + (up ? step : -step)];
      weight *= wall_weight(gates);
      return e;
    };
    const float along_x = towards(c.i, 0, b.plane()), along_y = towards(c.j, 1, b.pitch),
                along_z = towards(c.k, 2, 1);
    fine.x[c.at] += weight * interpolate(e, along_x, along_y, along_z);
  }
}

template <class Sync>
__device__ __forceinline__ void descend(const TailArgs& g, int from, int to, int first, int stride,
                                        Sync&& sync) {
  for (int l = from; l < to; ++l) {
    relax_from_zero(g.level[l], g.omega[0], first, stride);
    sync();
    restrict_residual(g.level[l], g.level[l + 1], first, stride);
    sync();
  }
}

template <class Sync>
__device__ __forceinline__ void ascend(const TailArgs& g, int from, int to, int first, int stride,
                                       Sync&& sync) {
  for (int l = from - 1; l >= to; --l) {
    add_correction(g.level[l], g.level[l + 1], first, stride);
    sync();
    relax_colour(g.level[l], 0, g.omega[1][0], first, stride);
    sync();
    relax_colour(g.level[l], 1, g.omega[1][1], first, stride);
    sync();
  }
}

__global__ void __cluster_dims__(TailPolicy::blocks, 1, 1) __launch_bounds__(TailPolicy::threads, 1)
    solve_tail(const __grid_constant__ TailArgs g) {
  namespace cg = cooperative_groups;
  cg::cluster_group cluster = cg::this_cluster();
  if (*g.done) return;  // the same for every block
  const int thread = static_cast<int>(threadIdx.x), threads = static_cast<int>(blockDim.x);
  const int first = static_cast<int>(blockIdx.x) * threads + thread,
            stride = static_cast<int>(gridDim.x) * threads;
  const auto cluster_sync = [&] { cluster.sync(); };
  descend(g, 0, g.solo, first, stride, cluster_sync);
  if (blockIdx.x == 0) {
    const auto block_sync = [] { __syncthreads(); };
    const int bottom = g.levels - 1;
    descend(g, g.solo, bottom, thread, threads, block_sync);
    // One cell is left. In a singular system it has no equation: its right-hand side is what no solution
    // reaches.
    if (thread == 0) {
      const TailLevel& l = g.level[bottom];
      l.x[0] = l.a.diag[0] > 0 ? l.rhs[0] / l.a.diag[0] : 0.0f;
    }
    __syncthreads();
    ascend(g, bottom, g.solo, thread, threads, block_sync);
  }
  cluster.sync();
  ascend(g, g.solo, 0, first, stride, cluster_sync);
}

}  // namespace gpuphys::multigrid
