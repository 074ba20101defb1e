// D3Q19 and D3Q27 lattices for the references: velocity tables, two-relaxation-time (TRT) collision in
// registers, and periodic streaming whose stores are whole aligned lines.
//
// Streaming by +-1 along z, the contiguous index, would shift a warp's store by one element: five sectors
// instead of four, two of them partial. Here a block owns whole rows along z, so that the shift (with its
// periodic wrap) is a permutation inside the block: populations that change z pass through shared memory and
// every store is as coalesced and aligned as the load. The shifts along x and y only choose another row.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <type_traits>

#include "core/module.hpp"

namespace gpuphys::lbm {

/// Calls body(integral_constant<int, i>) for i in [Begin, End): indices of register arrays stay constants.
template <int Begin, int End, class Body>
__host__ __device__ __forceinline__ constexpr void unrolled(Body&& body) {
  if constexpr (Begin < End) {
    body(std::integral_constant<int, Begin>{});
    unrolled<Begin + 1, End>(body);
  }
}

/// Velocities in the order of the specification: rest, axes, edges in the xy, xz and yz planes, corners.
/// Directions 2p+1 and 2p+2 are opposite for every pair p.
template <int Size>
struct Lattice {
  static_assert(Size == 19 || Size == 27);
  static constexpr int Q = Size;
  static constexpr int pairs = Q / 2;
  static constexpr int axis_pairs = 3, edge_pairs = 6, corner_pairs = pairs - 9;

  /// Component `axis` of velocity q.
  __host__ __device__ static constexpr int c(int q, int axis) {
    // clang-format off
    constexpr signed char first[13][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                                          {1, 1, 0}, {1, -1, 0}, {1, 0, 1}, {1, 0, -1}, {0, 1, 1}, {0, 1, -1},
                                          {1, 1, 1}, {1, 1, -1}, {1, -1, 1}, {-1, 1, 1}};
    // clang-format on
    return q == 0 ? 0 : q % 2 == 1 ? first[q / 2][axis] : -first[q / 2 - 1][axis];
  }

  /// Weight of a velocity with `nonzero` non-zero components.
  __host__ __device__ static constexpr double weight(int nonzero) {
    constexpr double d3q19[4] = {1.0 / 3, 1.0 / 18, 1.0 / 36, 0};
    constexpr double d3q27[4] = {8.0 / 27, 2.0 / 27, 1.0 / 54, 1.0 / 216};
    return Q == 19 ? d3q19[nonzero] : d3q27[nonzero];
  }
  __host__ __device__ static constexpr int nonzero(int q) {
    return c(q, 0) * c(q, 0) + c(q, 1) * c(q, 1) + c(q, 2) * c(q, 2);
  }

  /// Number of velocities before q that have a z component: q's slot in shared memory.
  __host__ __device__ static constexpr int slot(int q) {
    int n = 0;
    for (int p = 0; p < q; ++p) n += c(p, 2) != 0 ? 1 : 0;
    return n;
  }
  static constexpr int slots = Q == 19 ? 10 : 18;
};
static_assert(Lattice<19>::slot(19) == Lattice<19>::slots && Lattice<27>::slot(27) == Lattice<27>::slots);

/// x, -x or 0.
template <int C>
__device__ __forceinline__ float signed_term(float x) {
  return C > 0 ? x : C < 0 ? -x : 0.0f;
}

/// sum + C x without a multiplication.
template <int C>
__device__ __forceinline__ float plus_signed(float sum, float x) {
  if constexpr (C > 0) return sum + x;
  if constexpr (C < 0) return sum - x;
  return sum;
}

/// c_q . u.
template <class L, int q>
__device__ __forceinline__ float along(const float (&u)[3]) {
  if constexpr (L::c(q, 0) != 0)
    return plus_signed<L::c(q, 2)>(plus_signed<L::c(q, 1)>(signed_term<L::c(q, 0)>(u[0]), u[1]), u[2]);
  if constexpr (L::c(q, 0) == 0 && L::c(q, 1) != 0)
    return plus_signed<L::c(q, 2)>(signed_term<L::c(q, 1)>(u[1]), u[2]);
  return signed_term<L::c(q, 2)>(u[2]);
}

/// Two-relaxation-time collision with the second-order equilibrium, one cell in registers.
///
/// Opposite populations a, b are relaxed together: with s = a + b and d = a - b,
///     a' = a - (s - s_eq)/(2 tau+) - (d - d_eq)/(2 tau-),   b' = b - (s - s_eq)/(2 tau+) + (d - d_eq)/(2
///     tau-), s_eq = 2 w rho (1 - 3/2 u.u + 9/2 (c.u)^2),           d_eq = 6 w rho c.u.
/// Sums and differences of pairs also are all that density and momentum need.
template <class L>
struct TrtCollision {
  float rate_plus, half_plus, half_minus;  ///< 1/tau+, 1/(2 tau+), 1/(2 tau-)

  static TrtCollision make(float tau_plus, float magic) {
    const float tau_minus = 0.5f + magic / (tau_plus - 0.5f);
    return {1.0f / tau_plus, 0.5f / tau_plus, 0.5f / tau_minus};
  }

  __device__ __forceinline__ void operator()(float (&f)[L::Q]) const {
    // Each class of speeds on its own: terms of one size, short sums.
    float mass[3] = {0.0f, 0.0f, 0.0f}, momentum[3][3] = {};
    unrolled<0, L::pairs>([&](auto pair) {
      constexpr int p = decltype(pair)::value, a = 2 * p + 1, b = a + 1, kind = L::nonzero(a) - 1;
      const float sum = f[a] + f[b], difference = f[a] - f[b];
      mass[kind] += sum;
      momentum[kind][0] = plus_signed<L::c(a, 0)>(momentum[kind][0], difference);
      momentum[kind][1] = plus_signed<L::c(a, 1)>(momentum[kind][1], difference);
      momentum[kind][2] = plus_signed<L::c(a, 2)>(momentum[kind][2], difference);
    });
    const float rho = f[0] + (mass[0] + (mass[1] + mass[2]));
    const float volume = 1.0f / rho;
    float u[3];
    unrolled<0, 3>([&](auto axis) {
      constexpr int d = decltype(axis)::value;
      u[d] = (momentum[0][d] + (momentum[1][d] + momentum[2][d])) * volume;
    });
    const float isotropic = 1.0f - 1.5f * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);

    constexpr float rest_weight = static_cast<float>(L::weight(0));
    f[0] -= rate_plus * (f[0] - rest_weight * rho * isotropic);
    unrolled<0, L::pairs>([&](auto pair) {
      constexpr int p = decltype(pair)::value, a = 2 * p + 1, b = a + 1;
      constexpr float two_weights = static_cast<float>(2 * L::weight(L::nonzero(a)));
      const float cu = along<L, a>(u), scale = two_weights * rho;
      const float even = half_plus * ((f[a] + f[b]) - scale * (isotropic + 4.5f * cu * cu));
      const float odd = half_minus * ((f[a] - f[b]) - scale * 3.0f * cu);
      f[a] -= even + odd;
      f[b] -= even - odd;
    });
  }
};

/// Leaves populations as they are: streaming alone.
template <class L>
struct NoCollision {
  __device__ __forceinline__ void operator()(float (&)[L::Q]) const {}
};

/// A periodic grid of nx x ny x nz cells; `plane` is the number of cells, the distance between populations.
struct Grid {
  int nx, ny, nz;
  std::int64_t plane;
};

/// Throws when a cell's index would not fit in 31 bits.
inline Grid make_grid(const View<const float, 4>& f) {
  const std::int64_t cells = f.shape[1] * f.shape[2] * f.shape[3];
  if (cells >= (std::int64_t{1} << 31)) throw std::runtime_error("2^31 cells and more are not supported");
  return {static_cast<int>(f.shape[1]), static_cast<int>(f.shape[2]), static_cast<int>(f.shape[3]), cells};
}

/// index + c on a periodic axis of n cells, |c| <= 1.
template <int C>
__device__ __forceinline__ int neighbour(int index, int n) {
  if constexpr (C > 0) return index + 1 == n ? 0 : index + 1;
  if constexpr (C < 0) return index == 0 ? n - 1 : index - 1;
  return index;
}

/// First cell of the row along z that velocity q leads to from row (i,j).
template <class L, int q>
__device__ __forceinline__ int target_row(const Grid& grid, int i, int j) {
  return (neighbour<L::c(q, 0)>(i, grid.nx) * grid.ny + neighbour<L::c(q, 1)>(j, grid.ny)) * grid.nz;
}

template <class Policy>
__device__ __forceinline__ float load(const float* p) {
  if constexpr (Policy::streaming_loads) return __ldcs(p);
  return __ldg(p);
}
template <class Policy>
__device__ __forceinline__ void store(float* p, float value) {
  if constexpr (Policy::streaming_stores) {
    __stcs(p, value);
  } else {
    *p = value;
  }
}

/// All populations of a cell.
template <class L, class Policy>
__device__ __forceinline__ void load_cell(const float* __restrict__ f, const Grid& grid, int cell,
                                          float (&populations)[L::Q]) {
  const float* from = f + cell;
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    populations[q] = load<Policy>(from + q * grid.plane);
  });
}

/// One step where a block owns whole rows: threadIdx.x is z, blockDim.x = nz; threadIdx.y is one of
/// blockDim.y neighbouring rows along y; blockIdx.y is x. Threads beyond the last row repeat it and store
/// nothing.
template <class L, class Policy, class Cell>
__global__ void __launch_bounds__(Policy::longest_row, Policy::blocks_per_sm)
    step_rows(const float* __restrict__ f, float* __restrict__ out, const __grid_constant__ Grid grid,
              const __grid_constant__ Cell change) {
  __shared__ float shifted[L::slots][Policy::longest_row];
  const int k = static_cast<int>(threadIdx.x), i = static_cast<int>(blockIdx.y);
  const int row = static_cast<int>(blockIdx.x * blockDim.y + threadIdx.y);
  const int j = min(row, grid.ny - 1);
  const int first = static_cast<int>(threadIdx.y * blockDim.x);  // of this row in shared memory

  float populations[L::Q];
  load_cell<L, Policy>(f, grid, (i * grid.ny + j) * grid.nz + k, populations);
  change(populations);

  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    if constexpr (L::c(q, 2) != 0)
      shifted[L::slot(q)][first + neighbour<L::c(q, 2)>(k, grid.nz)] = populations[q];
  });
  // Those that stay at their z need not wait for the other warps.
  if (row < grid.ny) {
    unrolled<0, L::Q>([&](auto direction) {
      constexpr int q = decltype(direction)::value;
      if constexpr (L::c(q, 2) == 0)
        store<Policy>(out + q * grid.plane + (target_row<L, q>(grid, i, j) + k), populations[q]);
    });
  }
  __syncthreads();
  if (row < grid.ny) {
    unrolled<0, L::Q>([&](auto direction) {
      constexpr int q = decltype(direction)::value;
      if constexpr (L::c(q, 2) != 0) {
        store<Policy>(out + q * grid.plane + (target_row<L, q>(grid, i, j) + k),
                      shifted[L::slot(q)][first + k]);
      }
    });
  }
}

/// One step with a thread a cell in any order, for rows that no block can own: stores are not aligned.
template <class L, class Policy, class Cell>
__global__ void __launch_bounds__(Policy::threads)
    step_cells(const float* __restrict__ f, float* __restrict__ out, const __grid_constant__ Grid grid,
               const __grid_constant__ Cell change) {
  const unsigned cell = blockIdx.x * static_cast<unsigned>(Policy::threads) + threadIdx.x;
  if (cell >= grid.plane) return;
  const int rows = static_cast<int>(cell) / grid.nz, k = static_cast<int>(cell) - rows * grid.nz;
  const int i = rows / grid.ny, j = rows - i * grid.ny;
  float populations[L::Q];
  load_cell<L, Policy>(f, grid, static_cast<int>(cell), populations);
  change(populations);
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    const int to = target_row<L, q>(grid, i, j) + neighbour<L::c(q, 2)>(k, grid.nz);
    store<Policy>(out + q * grid.plane + to, populations[q]);
  });
}

/// Launches one step: `change` is applied to the populations of every cell, which then move by their
/// velocities.
///
/// Policy: `longest_row`, the longest row that a block owns (a multiple of 32; also sizes shared memory);
/// `threads`, what several short rows or the cells of long ones are gathered to; `blocks_per_sm`, blocks of
/// longest_row that must fit an SM (limits registers); `streaming_loads` and `streaming_stores`, evict-first.
template <class L, class Policy, class Cell>
void launch_step(const View<const float, 4>& f, float* out, const Cell& change) {
  static_assert(Policy::threads <= Policy::longest_row);
  const Grid grid = make_grid(f);
  if (grid.nz <= Policy::longest_row && grid.nx <= 65535) {
    int rows = Policy::threads / grid.nz;
    rows = rows < 1 ? 1 : rows > grid.ny ? grid.ny : rows;
    const dim3 block(static_cast<unsigned>(grid.nz), static_cast<unsigned>(rows));
    const dim3 blocks(static_cast<unsigned>((grid.ny + rows - 1) / rows), static_cast<unsigned>(grid.nx));
    step_rows<L, Policy, Cell><<<blocks, block>>>(f.data, out, grid, change);
  } else {
    const std::int64_t blocks = (grid.plane + Policy::threads - 1) / Policy::threads;
    step_cells<L, Policy, Cell>
        <<<static_cast<unsigned>(blocks), Policy::threads>>>(f.data, out, grid, change);
  }
}

}  // namespace gpuphys::lbm
