// D3Q19 and D3Q27 lattices for the references: velocity tables, two-relaxation-time (TRT) collision in
// registers, and periodic streaming whose stores are whole aligned lines. launch_step() changes cells and
// moves their populations, launch_collision() only changes cells, launch_streaming() only moves.
//
// Streaming by +-1 along z, the contiguous index, would shift a warp's store by one element: five sectors
// instead of four, two of them partial. Here a block owns whole rows along z, so that the shift (with its
// periodic wrap) is a permutation inside the block: a thread keeps two neighbouring cells, what leaves them
// along z passes through shared memory, and every store is as coalesced and aligned as the load. The shifts
// along x and y only choose another row.
// Streaming alone needs no whole cells: a thread shifts four neighbours in registers.
#pragma once

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <type_traits>

#include "core/contract/module.hpp"

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
inline Grid make_grid(std::int64_t nx, std::int64_t ny, std::int64_t nz) {
  const std::int64_t cells = nx * ny * nz;
  if (cells >= (std::int64_t{1} << 31)) throw std::runtime_error("2^31 cells and more are not supported");
  return {static_cast<int>(nx), static_cast<int>(ny), static_cast<int>(nz), cells};
}
inline Grid make_grid(const View<const float, 4>& f) {
  return make_grid(f.shape[1], f.shape[2], f.shape[3]);
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

/// Reads or writes N neighbouring floats, 1, 2 or 4, in one access.
template <int N>
__device__ __forceinline__ void load_pack(const float* from, float (&values)[N]) {
  static_assert(N == 1 || N == 2 || N == 4);
  if constexpr (N == 1) values[0] = __ldg(from);
  if constexpr (N == 2) {
    const float2 pack = __ldg(reinterpret_cast<const float2*>(from));
    values[0] = pack.x, values[1] = pack.y;
  }
  if constexpr (N == 4) {
    const float4 pack = __ldg(reinterpret_cast<const float4*>(from));
    values[0] = pack.x, values[1] = pack.y, values[2] = pack.z, values[3] = pack.w;
  }
}
template <int N>
__device__ __forceinline__ void store_pack(float* to, const float (&values)[N]) {
  if constexpr (N == 1) *to = values[0];
  // The compiler takes plain assignments of vectors apart.
  if constexpr (N == 2)
    asm volatile("st.global.v2.f32 [%0], {%1, %2};" ::"l"(to), "f"(values[0]), "f"(values[1]) : "memory");
  if constexpr (N == 4)
    asm volatile("st.global.v4.f32 [%0], {%1, %2, %3, %4};" ::"l"(to), "f"(values[0]), "f"(values[1]),
                 "f"(values[2]), "f"(values[3])
                 : "memory");
}

/// Are `floats` whole packs of N, and both arrays aligned to one?
template <int N>
bool in_packs(const void* f, const void* out, std::int64_t floats) {
  const auto addresses = reinterpret_cast<std::uintptr_t>(f) | reinterpret_cast<std::uintptr_t>(out);
  return floats % N == 0 && addresses % (N * sizeof(float)) == 0;
}

/// Blocks of whole rows along z, for a step. Evict-first loads and stores gained nothing and made the time
/// depend on where the arrays happen to lie: there are no such options.
template <int Threads, int BlocksPerSm>
struct RowPolicy {
  static constexpr int threads = Threads;            ///< a block: as many rows as they can own
  static constexpr int blocks_per_sm = BlocksPerSm;  ///< that must fit an SM (limits registers)
};

/// All populations of N neighbouring cells along z.
template <class L, int N>
__device__ __forceinline__ void load_cells(const float* __restrict__ from, const std::int64_t plane,
                                           float (&populations)[N][L::Q]) {
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    float pack[N];
    load_pack(from + q * plane, pack);
#pragma unroll
    for (int n = 0; n < N; ++n) populations[n][q] = pack[n];
  });
}

/// Changes N neighbouring cells along z, the first of which is (i,j,k). A change that depends on the place
/// takes all N at once.
template <class Cell, int N, int Q>
__device__ __forceinline__ void change_at(const Cell& change, float (&populations)[N][Q], int i, int j,
                                          int k) {
  if constexpr (requires { change(populations, i, j, k); }) {
    change(populations, i, j, k);
  } else {
#pragma unroll
    for (int n = 0; n < N; ++n) change(populations[n]);
  }
}

/// One step where a block owns whole rows: thread threadIdx.x of blockDim.x = nz / N has N neighbouring cells
/// of its row; threadIdx.y is one of blockDim.y neighbouring rows along y; blockIdx.y is x. Threads beyond
/// the last row repeat it and store nothing.
template <class L, class Policy, int N, class Cell>
__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    step_rows(const float* __restrict__ f, float* __restrict__ out, const __grid_constant__ Grid grid,
              const __grid_constant__ Cell change) {
  __shared__ float passed[L::slots][Policy::threads];
  const int t = static_cast<int>(threadIdx.x), k = N * t, i = static_cast<int>(blockIdx.y);
  const int row = static_cast<int>(blockIdx.x * blockDim.y + threadIdx.y);
  const int j = min(row, grid.ny - 1);
  const int first = static_cast<int>(threadIdx.y * blockDim.x);  // of this row in shared memory

  float populations[N][L::Q];
  load_cells<L, N>(f + ((i * grid.ny + j) * grid.nz + k), grid.plane, populations);
  change_at(change, populations, i, j, k);

  // Of the populations that change z, one leaves a thread's cells.
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value, cz = L::c(q, 2);
    if constexpr (cz != 0)
      passed[L::slot(q)][first + neighbour<cz>(t, static_cast<int>(blockDim.x))] =
          populations[cz > 0 ? N - 1 : 0][q];
  });
  // Those that stay at their z need not wait for the other warps.
  if (row < grid.ny) {
    unrolled<0, L::Q>([&](auto direction) {
      constexpr int q = decltype(direction)::value;
      if constexpr (L::c(q, 2) == 0) {
        float pack[N];
#pragma unroll
        for (int n = 0; n < N; ++n) pack[n] = populations[n][q];
        store_pack(out + q * grid.plane + (target_row<L, q>(grid, i, j) + k), pack);
      }
    });
  }
  __syncthreads();
  if (row < grid.ny) {
    unrolled<0, L::Q>([&](auto direction) {
      constexpr int q = decltype(direction)::value, cz = L::c(q, 2);
      if constexpr (cz != 0) {
        float pack[N];
        pack[cz > 0 ? 0 : N - 1] = passed[L::slot(q)][first + t];
#pragma unroll
        for (int n = 1; n < N; ++n) pack[cz > 0 ? n : n - 1] = populations[cz > 0 ? n - 1 : n][q];
        store_pack(out + q * grid.plane + (target_row<L, q>(grid, i, j) + k), pack);
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
  float populations[1][L::Q];
  load_cells<L, 1>(f + cell, grid.plane, populations);
  change_at(change, populations, i, j, k);
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    const int to = target_row<L, q>(grid, i, j) + neighbour<L::c(q, 2)>(k, grid.nz);
    out[q * grid.plane + to] = populations[0][q];
  });
}

/// A line of cells, for a collision.
template <int Threads, int Cells, int BlocksPerSm>
struct LinePolicy {
  static constexpr int threads = Threads;            ///< a block
  static constexpr int cells = Cells;                ///< a thread: 1, 2 or 4
  static constexpr int blocks_per_sm = BlocksPerSm;  ///< that must fit an SM (limits registers)
};

/// Applies `change` to every cell; populations stay where they are. A thread owns N neighbouring cells.
template <class L, class Policy, int N, class Cell>
__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    change_cells(const float* __restrict__ f, float* __restrict__ out, const std::int64_t plane,
                 const __grid_constant__ Cell change) {
  const std::int64_t first = N * (blockIdx.x * std::int64_t{Policy::threads} + threadIdx.x);
  if (first >= plane) return;
  float populations[N][L::Q];
  load_cells<L, N>(f + first, plane, populations);
#pragma unroll
  for (int n = 0; n < N; ++n) change(populations[n]);
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    float pack[N];
#pragma unroll
    for (int n = 0; n < N; ++n) pack[n] = populations[n][q];
    store_pack(out + q * plane + first, pack);
  });
}

/// Launches a collision without streaming.
template <class L, class Policy, class Cell>
void launch_collision(const View<const float, 4>& f, float* out, const Cell& change) {
  const std::int64_t plane = make_grid(f).plane;
  const auto launch = [&](auto cells) {
    constexpr int N = decltype(cells)::value, per_block = N * Policy::threads;
    change_cells<L, Policy, N, Cell>
        <<<static_cast<unsigned>((plane + per_block - 1) / per_block), Policy::threads>>>(f.data, out, plane,
                                                                                          change);
  };
  if (in_packs<Policy::cells>(f.data, out, plane)) {
    launch(std::integral_constant<int, Policy::cells>{});
  } else {
    launch(std::integral_constant<int, 1>{});
  }
}

/// Populations one after the other, for streaming.
template <int Threads, int Pieces>
struct CopyPolicy {
  static constexpr int threads = Threads;  ///< a block
  static constexpr int pieces = Pieces;    ///< of four populations that a thread moves
  /// For rows that are not whole pieces.
  using Rows = RowPolicy<Threads, 512 / Threads>;
};

/// Reads what moves to cells k ... k+3 of a row of nz cells along z, for velocity C along z. The fourth
/// value, from beside the aligned four, is in the cache: it is one of a neighbouring thread's.
template <int C>
__device__ __forceinline__ void load_moved(const float* row, int k, int nz, float (&values)[4]) {
  load_pack(row + k, values);
  if constexpr (C > 0) {
    values[3] = values[2], values[2] = values[1], values[1] = values[0];
    values[0] = __ldg(row + neighbour<-1>(k, nz));
  }
  if constexpr (C < 0) {
    values[0] = values[1], values[1] = values[2], values[2] = values[3];
    values[3] = __ldg(row + neighbour<1>(k + 3, nz));
  }
}

/// Streaming alone: a block copies a piece of one plane of constant x of one population, blockIdx.z, so that
/// few places of memory are open at a time; blockIdx.y is x. Rows along z are pieces of four, so that every
/// access but the one beside them is 16 aligned bytes. Threads beyond the last piece repeat it and store
/// nothing.
template <class L, class Policy>
__global__ void __launch_bounds__(Policy::threads)
    move_planes(const float* __restrict__ f, float* __restrict__ out, const __grid_constant__ Grid grid) {
  const int pieces = grid.nz / 4, count = grid.ny * pieces, i = static_cast<int>(blockIdx.y);
  const int first = static_cast<int>(blockIdx.x * (Policy::threads * Policy::pieces) + threadIdx.x);
  unrolled<0, L::Q>([&](auto direction) {
    constexpr int q = decltype(direction)::value;
    if (blockIdx.z != q) return;
    const float* from = f + q * grid.plane + static_cast<std::int64_t>(i) * grid.ny * grid.nz;
    float moved[Policy::pieces][4];
    int to[Policy::pieces];
#pragma unroll
    for (int n = 0; n < Policy::pieces; ++n) {
      const int item = min(first + n * Policy::threads, count - 1);
      const int j = item / pieces, k = 4 * (item - j * pieces);
      load_moved<L::c(q, 2)>(from + j * grid.nz, k, grid.nz, moved[n]);
      to[n] = target_row<L, q>(grid, i, j) + k;
    }
#pragma unroll
    for (int n = 0; n < Policy::pieces; ++n) {
      if (first + n * Policy::threads < count) store_pack(out + q * grid.plane + to[n], moved[n]);
    }
  });
}

/// Launches one step: `change` is applied to the populations of every cell, which then move by their
/// velocities.
template <class L, class Policy, class Cell>
void launch_step(const View<const float, 4>& f, float* out, const Cell& change) {
  const Grid grid = make_grid(f);
  const auto launch_rows = [&](auto cells) {
    constexpr int N = decltype(cells)::value;
    const int per_row = grid.nz / N, rows = std::min(Policy::threads / per_row, grid.ny);
    const dim3 block(static_cast<unsigned>(per_row), static_cast<unsigned>(rows));
    const dim3 blocks(static_cast<unsigned>((grid.ny + rows - 1) / rows), static_cast<unsigned>(grid.nx));
    step_rows<L, Policy, N, Cell><<<blocks, block>>>(f.data, out, grid, change);
  };
  const bool owned = grid.nx <= 65535;
  if (owned && grid.nz <= 2 * Policy::threads && in_packs<2>(f.data, out, grid.nz)) {
    launch_rows(std::integral_constant<int, 2>{});
  } else if (owned && grid.nz <= Policy::threads) {
    launch_rows(std::integral_constant<int, 1>{});
  } else {
    const std::int64_t blocks = (grid.plane + Policy::threads - 1) / Policy::threads;
    step_cells<L, Policy, Cell>
        <<<static_cast<unsigned>(blocks), Policy::threads>>>(f.data, out, grid, change);
  }
}

/// Launches streaming alone.
template <class L, class Policy>
void launch_streaming(const View<const float, 4>& f, float* out) {
  const Grid grid = make_grid(f);
  if (grid.nx > 65535 || !in_packs<4>(f.data, out, grid.nz)) {
    launch_step<L, typename Policy::Rows>(f, out, NoCollision<L>{});
    return;
  }
  constexpr int per_block = Policy::threads * Policy::pieces;
  const std::int64_t blocks = (std::int64_t{grid.ny} * (grid.nz / 4) + per_block - 1) / per_block;
  const dim3 shape(static_cast<unsigned>(blocks), static_cast<unsigned>(grid.nx), L::Q);
  move_planes<L, Policy><<<shape, Policy::threads>>>(f.data, out, grid);
}

/// What the references of the tasks have in common: no memory of their own, and a grid that must be small
/// enough.
struct Stateless {
  void allocate(const auto& in, const auto&) { make_grid(in.f); }
};

/// What is best for streaming in both lattices.
#ifdef GPUPHYS_OTHER_BLOCKS
using StreamingPolicy = CopyPolicy<64, 1>;
#else
using StreamingPolicy = CopyPolicy<256, 4>;
#endif

/// Reference of a task that streams.
template <class L, class Policy>
struct Streaming : Stateless {
  void compute(const auto& in, const auto& out) { launch_streaming<L, Policy>(in.f, out.f.data); }
};

/// Reference of a task that collides.
template <class L, class Policy>
struct Collision : Stateless {
  void compute(const auto& in, const auto& out) {
    launch_collision<L, Policy>(in.f, out.f.data, TrtCollision<L>::make(in.tau_plus, in.magic));
  }
};

/// Reference of a task that collides, then streams.
template <class L, class Policy>
struct CollisionThenStreaming : Stateless {
  void compute(const auto& in, const auto& out) {
    launch_step<L, Policy>(in.f, out.f.data, TrtCollision<L>::make(in.tau_plus, in.magic));
  }
};

}  // namespace gpuphys::lbm
