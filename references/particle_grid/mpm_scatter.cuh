// Momentum and elastic forces of particles to sums over nodes, quadratic B-splines on a collocated grid: what
// p2g_mpm and mpm_explicit share. FP32. p2g_mpm.cu describes the passes.
#pragma once

#include <cuda_pipeline.h>

#include <algorithm>

#include "references/blocks/particle_tiles.cuh"
#include "references/blocks/tile_sums.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/quadratic_bspline.cuh"
#include "references/common/warp_rows.cuh"
#include "references/particle_grid/fixed_corotated.cuh"

namespace gpuphys::mpm_scatter {

using tiles::BinningView;
using tiles::TileGrid;
using tiles::WorkItem;

struct Policy {
  static constexpr int mark_threads = 256;
  static constexpr int mark_stride = 32;  // one row of 32 particles in so many
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int plan_threads = 128;
  static constexpr int run = 3;
  static constexpr int count_threads = 512;
  static constexpr int count_shared = 128 * 1024;  // takes half the tiles of the paper's size
  static constexpr int place_threads = 256;
  static constexpr int place_blocks_per_sm = 4;
  static constexpr int piece = 320;
  static constexpr int scatter_blocks_per_sm = 3;
#else
  static constexpr int plan_threads = 256;
  static constexpr int run = 8;  // pieces, mostly of tiles side by side, that a block takes in a row
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int place_threads = 128;
  static constexpr int place_blocks_per_sm = 9;  // 36 warps in 56 registers; ten blocks spill
  static constexpr int piece =
      560;  // particles of a tile that a block takes: eight a cell, and room for chance
  static constexpr int scatter_blocks_per_sm = 6;
#endif
  static constexpr int normalise_threads = 256;
};

constexpr int kTileSide = 4, kTileNodes = kTileSide * kTileSide * kTileSide;
/// Clamped: particles that no node reaches have a slot as well.
template <bool Clamped>
using Tiling = tiles::Tiling<kTileSide, kTileSide, kTileSide, 2, false, Clamped, Clamped>;
constexpr int kReach = 3;                                  // nodes a particle reaches along an axis
constexpr int kSide = kTileSide + kReach - 1;              // nodes of a tile with its halo
constexpr int kCells = kTileSide * kTileSide * kTileSide;  // of a tile
constexpr int kScatterThreads = kCells;
constexpr int kRecord = 3;  // float4 a particle
constexpr int kStride = 4;  // the same in memory: two whole sectors
constexpr int kRounds = (Policy::piece + kScatterThreads - 1) / kScatterThreads;

struct Particles {
  const float* __restrict__ x;
  const float* __restrict__ v;
  const float* __restrict__ f;
  std::int64_t n;
};

// -dt V0 / (mass_p dx) times 2 mu and lambda: stress as velocity per unit slope.
struct Moduli {
  float two_mu, lambda;
};

/// Position from the tile's first node, in cells.
template <class Tiling>
__device__ __forceinline__ float from_tile(const tiles::Place& at, int axis) {
  if constexpr (!Tiling::clamped) return at.offset[axis];
  const int cell = axis == 0   ? at.cell / (kTileSide * kTileSide)
                   : axis == 1 ? at.cell / kTileSide % kTileSide
                               : at.cell % kTileSide;
  return static_cast<float>(cell + 1) + at.offset[axis];
}

template <class Tiling>
__global__ void __launch_bounds__(Policy::place_threads, Policy::place_blocks_per_sm)
    place(const __grid_constant__ TileGrid grid, const __grid_constant__ Particles particles, Moduli moduli,
          int* __restrict__ slots, int* __restrict__ next, float4* __restrict__ records) {
  constexpr int per_warp = 32 * (3 + 3 + 9);
  constexpr int per_store = 32 / kStride;  // records that a warp writes at once
  __shared__ __align__(16) float staging[Policy::place_threads / 32][per_warp];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::place_threads + threadIdx.x;
  const std::int64_t first = p - lane;
  int slot = p < particles.n ? __ldcs(slots + p) : tiles::kNoSlot;
  float x[3], v[3], f[9];
  load_rows(particles.x, first, particles.n, x);
  load_rows(particles.v, first, particles.n, v);
  load_rows(particles.f, first, particles.n, f);
  transpose_rows(stage, x);
  const tiles::Place at = tiles::locate<Tiling>(grid, x[0], x[1], x[2]);
  const int tile = tiles::listed_tile(at, p, particles.n);
  // Rare: nothing waits for the answer until the record is written.
  if (slot < 0 && tile >= 0) {
    slot = atomicAdd(next + tile, 1);
    if (Tiling::clamped) slots[p] = slot;  // for who gathers from the same lists
  }
  // What the stress does not need waits in the lane's own rows: registers decide how many warps are
  // resident.
#pragma unroll
  for (int d = 0; d < 3; ++d) stage[lane * 3 + d] = from_tile<Tiling>(at, d);
  stage_rows(stage + 32 * 3, v);
  transpose_rows(stage + 32 * 6, f);
  const polar::Matrix3 deformation{{{f[0], f[1], f[2]}, {f[3], f[4], f[5]}, {f[6], f[7], f[8]}}};
  elasticity::SymmetricMatrix tau{};
  if (tile >= 0) tau = elasticity::fixed_corotated(deformation, moduli.two_mu, moduli.lambda);
  float kept[6];  // offset, v
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    kept[d] = stage[lane * 3 + d];
    kept[3 + d] = stage[(32 + lane) * 3 + d];
  }
  __syncwarp();  // the rows are read: their memory takes the records

  float4* packed = reinterpret_cast<float4*>(stage);
  packed[kRecord * lane] = make_float4(kept[0], kept[1], kept[2], kept[3]);
  packed[kRecord * lane + 1] = make_float4(kept[4], kept[5], tau.xx, tau.yy);
  packed[kRecord * lane + 2] = make_float4(tau.zz, tau.xy, tau.xz, tau.yz);
  __syncwarp();
  const int part = lane % kStride;
#pragma unroll
  for (int s = 0; s < kStride; ++s) {
    const int item = s * per_store + lane / kStride;
    const int to = __shfl_sync(0xffffffffu, slot, item);
    if (to < 0) continue;
    records[static_cast<std::int64_t>(kStride) * to + part] =
        part < kRecord ? packed[kRecord * item + part] : make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  }
}

// Sums of the cells' y-z-rows: [node plane along x, of the cell's three][cell along x][node along y][z].
constexpr int kRowNodes = kSide * kSide;
constexpr int kRows = kReach * kTileSide;

// The pieces in runs for blocks, some longer by one: run r begins with piece begin(r).
struct Runs {
  int count, length, longer;

  __device__ __forceinline__ int begin(int run) const { return length * run + min(run, longer); }
};

__device__ __forceinline__ Runs runs_of(int pieces, int blocks) {
  const int rounds = max((pieces + Policy::run * blocks - 1) / (Policy::run * blocks), 1);
  const int count = rounds * blocks;
  return {count, pieces / count, pieces % count};
}

constexpr int kHalo = kReach - 1;
constexpr int kNodes = kSide * kSide * kSide;  // of a tile with its halo

struct ScatterShared {
  float4 list[kRecord * Policy::piece];
  float4 sums[kRows * kRowNodes];
  float4 carry[2][kRowNodes * kHalo];  // highest nodes along z, for the next piece; in turns
  Runs runs;
  tiles::CellOrder<kCells, Policy::piece> cells;
};

// Sums of one thread: the 27 nodes of its cell, {mass, momentum}, mass in units of a particle's. While
// particles are being added, index 1 stands for the sum over the three nodes along that axis: three weights
// add up to 1 and three slopes to 0, so that it takes no weight. resolve() leaves the middle node there. No
// digits matter: the middle weight is 1/2 to 3/4 of the three.
struct Sums {
  float s[kReach][kReach][kReach][4];  // [node along x][y][z]
};

__device__ __forceinline__ void add_particle(Sums& sums, const float (&centre)[3], const float4& a,
                                             const float4& b, const float4& c) {
  const bspline::Weights x = bspline::quadratic(a.x - centre[0]), y = bspline::quadratic(a.y - centre[1]),
                         z = bspline::quadratic(a.z - centre[2]);
  const float velocity[3] = {a.w, b.x, b.y};
  const float tau[3][3] = {{b.z, c.y, c.z}, {c.y, b.w, c.w}, {c.z, c.w, c.x}};
#pragma unroll
  for (int ox = 0; ox < kReach; ++ox) {
    const float wx = ox == 1 ? 1.0f : x.w[ox];
#pragma unroll
    for (int oy = 0; oy < kReach; ++oy) {
      const float wxy = oy == 1 ? wx : wx * y.w[oy];
      sums.s[ox][oy][0][0] += wxy * z.w[0];
      if (ox != 1 || oy != 1) sums.s[ox][oy][1][0] += wxy;  // else 1 a particle
      sums.s[ox][oy][2][0] += wxy * z.w[2];
    }
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) {
#pragma unroll
    for (int ox = 0; ox < kReach; ++ox) {
      const float along_x = ox == 1 ? velocity[d] : x.w[ox] * velocity[d] + x.slope[ox] * tau[d][0];
      const float along_y = ox == 1 ? tau[d][1] : x.w[ox] * tau[d][1];
      const float along_z = ox == 1 ? tau[d][2] : x.w[ox] * tau[d][2];
#pragma unroll
      for (int oy = 0; oy < kReach; ++oy) {
        const float plain = oy == 1 ? along_x : y.w[oy] * along_x + y.slope[oy] * along_y;
        const float sloped = oy == 1 ? along_z : y.w[oy] * along_z;
        sums.s[ox][oy][0][1 + d] += z.w[0] * plain;
        sums.s[ox][oy][0][1 + d] += z.slope[0] * sloped;
        sums.s[ox][oy][1][1 + d] += plain;
        sums.s[ox][oy][2][1 + d] += z.w[2] * plain;
        sums.s[ox][oy][2][1 + d] += z.slope[2] * sloped;
      }
    }
  }
}

__device__ __forceinline__ void resolve(Sums& sums) {
#pragma unroll
  for (int q = 0; q < 4; ++q) {
#pragma unroll
    for (int one = 0; one < kReach; ++one) {
#pragma unroll
      for (int two = 0; two < kReach; ++two)
        sums.s[one][two][1][q] -= sums.s[one][two][0][q] + sums.s[one][two][2][q];
    }
#pragma unroll
    for (int one = 0; one < kReach; ++one) {
#pragma unroll
      for (int two = 0; two < kReach; ++two)
        sums.s[one][1][two][q] -= sums.s[one][0][two][q] + sums.s[one][2][two][q];
    }
#pragma unroll
    for (int one = 0; one < kReach; ++one) {
#pragma unroll
      for (int two = 0; two < kReach; ++two)
        sums.s[1][one][two][q] -= sums.s[0][one][two][q] + sums.s[2][one][two][q];
    }
  }
}

// 16 bytes to shared memory, past the registers. Spelled out: with one 32-bit address for all copies of a
// thread their distances become constants of the instructions.
__device__ __forceinline__ void copy_async(unsigned to_shared, const float4* from) {
  asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" : : "r"(to_shared), "l"(from) : "memory");
}

// An address that the compiler cannot look into: it keeps it, and adds constants to it, where it would
// compute each of many related ones anew.
__device__ __forceinline__ unsigned opaque_shared(const float4* shared) {
  unsigned address;
  asm volatile("cvt.u32.u64 %0, %1;" : "=r"(address) : "l"(__cvta_generic_to_shared(shared)));
  return address;
}

__device__ __forceinline__ const float4* opaque(const float4* from) {
  const float4* address;
  asm volatile("mov.u64 %0, %1;" : "=l"(address) : "l"(from));
  return address;
}

// Asks for the records of a piece, nothing of the padding. As many records as threads take three copies each,
// at addresses that differ from those of the records before by constants.
__device__ __forceinline__ void fetch(ScatterShared& shared, const float4* __restrict__ records, int first,
                                      int count) {
  const int thread = static_cast<int>(threadIdx.x);
  const unsigned to = opaque_shared(shared.list + thread);
#pragma unroll
  for (int third = 0; third < kRecord; ++third) {
    const int copy = thread + third * kScatterThreads;
    const int record = copy / kRecord, part = copy % kRecord, left = count - record;
    const float4* from = opaque(records + part + static_cast<std::int64_t>(first + record) * kStride);
#pragma unroll
    for (int s = 0; s < kRounds; ++s) {
      if (s * kScatterThreads < left) {
        copy_async(to + (kRecord * s + third) * kScatterThreads * sizeof(float4),
                   from + s * kStride * kScatterThreads);
      }
    }
  }
  __pipeline_commit();
}

/// Number of the cell in the tile, from a record's first float4.
__device__ __forceinline__ int cell_of(const float4& offset) {
  using T = Tiling<false>;
  return (tiles::cell_of<T>(0, offset.x) * kTileSide + tiles::cell_of<T>(1, offset.y)) * kTileSide +
         tiles::cell_of<T>(2, offset.z);
}

// Sorts the piece's records by cell.
__device__ __forceinline__ void sort_by_cell(ScatterShared& shared, int count) {
  tiles::sort_by_cell<kScatterThreads>(shared.cells, count,
                                       [&](int p) { return cell_of(shared.list[kRecord * p]); });
}

// Adds up the cells of each y-z-plane of the tile and leaves their nodes in shared memory. Along y cells are
// one lane apart, along z eight.
__device__ __forceinline__ void store_rows(ScatterShared& shared, Sums& sums, int cell_x, int cell_y,
                                           int cell_z) {
#pragma unroll
  for (int ox = 0; ox < kReach; ++ox) {
#pragma unroll
    for (int q = 0; q < 4; ++q) {
#pragma unroll
      for (int oy = 0; oy < kReach; ++oy)
        tiles::add_along<8>(cell_z > 0, sums.s[ox][oy][0][q], sums.s[ox][oy][1][q], sums.s[ox][oy][2][q]);
#pragma unroll
      for (int oz = 0; oz < kReach; ++oz)
        tiles::add_along<1>(cell_y > 0, sums.s[ox][0][oz][q], sums.s[ox][1][oz][q], sums.s[ox][2][oz][q]);
    }
    float4* nodes = shared.sums + (ox * kTileSide + cell_x) * kRowNodes + cell_y * kSide + cell_z;
#pragma unroll
    for (int oy = 0; oy < kReach; ++oy) {
#pragma unroll
      for (int oz = 0; oz < kReach; ++oz) {
        if ((oy > 0 && cell_y != kTileSide - 1) || (oz > 0 && cell_z != kTileSide - 1)) continue;
        const float(&node)[4] = sums.s[ox][oy][oz];
        nodes[oy * kSide + oz] = make_float4(node[0], node[1], node[2], node[3]);
      }
    }
  }
}

// Adds up the planes that meet in each node of the tile and its halo, and adds the node to the grid. Where
// the block's next piece lies one tile on along z, the nodes that both reach wait for it.
__device__ __forceinline__ void flush_nodes(ScatterShared& shared, const TileGrid& grid, int piece,
                                            const int4& tile, bool from_last, bool to_next,
                                            float4* __restrict__ accumulators) {
  constexpr int rounds = (kNodes + kScatterThreads - 1) / kScatterThreads;
  const int thread = static_cast<int>(threadIdx.x);
  float4 sums[rounds];
#pragma unroll
  for (int s = 0; s < rounds; ++s) {
    const auto at = static_cast<unsigned>(min(thread + s * kScatterThreads, kNodes - 1));
    sums[s] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
#pragma unroll
    for (unsigned ox = 0; ox < kReach; ++ox) {
      // Which x a round has is known to the compiler, and with it most of the answers.
      constexpr unsigned threads = kScatterThreads, side = kTileSide;
      const unsigned first_x = s * threads / kRowNodes,
                     last_x = min((s + 1) * threads - 1, kNodes - 1u) / kRowNodes;
      if (last_x < ox || first_x >= ox + side) continue;
      const bool meets = (first_x >= ox && last_x < ox + side) || at / kRowNodes - ox < side;
      // Node x of the tile in plane ox of cell x - ox: (ox * kTileSide + x - ox) rows of nodes on. Read even
      // where there is no such cell: branches would wait for one plane after the other.
      const float4 part = shared.sums[at + ox * (kTileSide - 1) * kRowNodes];
      sums[s].x += meets ? part.x : 0.0f;
      sums[s].y += meets ? part.y : 0.0f;
      sums[s].z += meets ? part.z : 0.0f;
      sums[s].w += meets ? part.w : 0.0f;
    }
  }
#pragma unroll
  for (int s = 0; s < rounds; ++s) {
    const auto at = static_cast<unsigned>(thread + s * kScatterThreads);
    if (at >= kNodes) break;
    const unsigned x = at / kRowNodes, y = at / kSide % kSide, z = at % kSide;
    float4 sum = sums[s];
    const unsigned column = at / kSide * kHalo;
    if (from_last && z < kHalo) {
      const float4 part = shared.carry[piece % 2][column + z];
      sum.x += part.x;
      sum.y += part.y;
      sum.z += part.z;
      sum.w += part.w;
    }
    if (to_next && z >= kTileSide) {
      shared.carry[(piece + 1) % 2][column + z - kTileSide] = sum;
      continue;
    }
    if (!(sum.x > 0.0f)) continue;
    // A node outside the array has a place in its block all the same, unless the block is missing too.
    const int block_x = tile.x + static_cast<int>(x / kTileSide),
              block_y = tile.y + static_cast<int>(y / kTileSide),
              block_z = tile.z + static_cast<int>(z / kTileSide);
    if (block_x >= grid.tiles[0] || block_y >= grid.tiles[1] || block_z >= grid.tiles[2]) continue;
    const auto block = static_cast<unsigned>(grid.tile(block_x, block_y, block_z));
    const unsigned local = (x % kTileSide * kTileSide + y % kTileSide) * kTileSide + z % kTileSide;
    reduce_add(accumulators + (static_cast<std::size_t>(block) * kTileNodes + local), sum);
  }
}

struct Result {
  float* __restrict__ u[3];
};

// Zeros where no block of particles reaches: row j of the node blocks tile_x, row = (tile_x, j).
__device__ __forceinline__ void clear_row(const TileGrid& grid, const unsigned char* __restrict__ touched,
                                          const Result& result, int row) {
  const int tile_x = row / grid.nodes[1], j = row - tile_x * grid.nodes[1];
  const unsigned char* blocks = touched + grid.tile(tile_x, (j + 2) / kTileSide, 0);
  constexpr int at_once = 4;
  const int first = max(kTileSide * tile_x - 2, 0), end = min(kTileSide * tile_x + 2, grid.nodes[0]);
  for (int k = static_cast<int>(threadIdx.x); k < grid.nodes[2]; k += at_once * kScatterThreads) {
    bool clear[at_once];
#pragma unroll
    for (int s = 0; s < at_once; ++s) {
      const int node = k + s * kScatterThreads;
      clear[s] = node < grid.nodes[2] && blocks[(node + 2) / kTileSide] == 0;
    }
#pragma unroll 1
    for (int i = first; i < end; ++i) {
      const std::int64_t at = (static_cast<std::int64_t>(i) * grid.nodes[1] + j) * grid.nodes[2] + k;
#pragma unroll
      for (int d = 0; d < 3; ++d) {
#pragma unroll
        for (int s = 0; s < at_once; ++s) {
          if (clear[s]) __stcs(result.u[d] + at + s * kScatterThreads, 0.0f);
        }
      }
    }
  }
}

/// `Clears`: writes zeros to the result where no particle reaches.
template <bool Clears>
__global__ void __launch_bounds__(kScatterThreads, Policy::scatter_blocks_per_sm)
    scatter(const __grid_constant__ TileGrid grid, const WorkItem* __restrict__ items,
            const int* __restrict__ item_count, const float4* __restrict__ records,
            float4* __restrict__ accumulators, const unsigned char* __restrict__ touched,
            const __grid_constant__ Result result) {
  extern __shared__ float4 memory[];
  ScatterShared& shared = *reinterpret_cast<ScatterShared*>(memory);
  const int thread = static_cast<int>(threadIdx.x);
  const int cell_y = thread % 4, cell_x = thread / 32 * 2 + thread / 4 % 2, cell_z = thread / 8 % 4;
  const int cell = (cell_x * kTileSide + cell_y) * kTileSide + cell_z;
  // The middle node of the cell's three, from the tile's first.
  const float centre[3] = {static_cast<float>(cell_x + 1), static_cast<float>(cell_y + 1),
                           static_cast<float>(cell_z + 1)};
  const int n_items = *item_count, step = static_cast<int>(gridDim.x);
  const int rows = grid.tiles[0] * grid.nodes[1];
  int row = static_cast<int>(blockIdx.x), run = row;
  if (thread == 0) shared.runs = runs_of(n_items, step);
  __syncthreads();
  int i = shared.runs.begin(run);
  bool from_last = false;
  int count = i < n_items ? items[i].count : 0;
  if (i < n_items) fetch(shared, records, items[i].first, count);
  while (i < n_items) {
    shared.cells.counts[thread] = 0;
    int next = i + 1;
    if (next == shared.runs.begin(run + 1)) {
      run += step;
      next = run < shared.runs.count ? shared.runs.begin(run) : n_items;
    }
    const int next_first = next < n_items ? items[next].first : 0;
    const int next_count = next < n_items ? items[next].count : 0;
    // The list is on its way: time for the part of the array that no particle reaches.
    if (Clears && row < rows) clear_row(grid, touched, result, row);
    row += step;
    __pipeline_wait_prior(0);
    __syncthreads();  // the list is there
    sort_by_cell(shared, count);

    Sums sums{};
    const int last = shared.cells.starts[cell + 1];
    // Volatile, so that the next number is on its way while a record is added, not asked for when it is
    // needed.
    const volatile unsigned short* order = shared.cells.order;
    int q = shared.cells.starts[cell], at = order[q];
    while (q < last) {
      const float4* record = shared.list + kRecord * at;
      at = order[++q];
      add_particle(sums, centre, record[0], record[1], record[2]);
    }
    sums.s[1][1][1][0] = static_cast<float>(last - shared.cells.starts[cell]);
    const int4 tile = items[i].tile;
    __syncthreads();  // the list is read, and the sums before
    fetch(shared, records, next_first, next_count);
    resolve(sums);
    store_rows(shared, sums, cell_x, cell_y, cell_z);
    __syncthreads();
    const bool to_next = tile.w != 0 && next == i + 1;
    flush_nodes(shared, grid, i, tile, from_last, to_next, accumulators);
    from_last = to_next;
    i = next;
    count = next_count;
  }
  for (; Clears && row < rows; row += step) clear_row(grid, touched, result, row);
}

template <class Inputs>
Particles particles_of(const Inputs& in) {
  return {in.x.data, in.v.data, in.F.data, in.x.shape[0]};
}

template <class Inputs>
Moduli moduli_of(const Inputs& in) {
  const float impulse = -in.dt * (in.V0 / in.mass_p) / in.dx;
  return {2.0f * in.mu * impulse, in.lambda * impulse};
}

inline unsigned blocks(std::int64_t items, int per_block) {
  return static_cast<unsigned>(std::max<std::int64_t>(1, (items + per_block - 1) / per_block));
}

/// The passes up to the sums {mass, momentum} of the nodes in whole blocks of them, and their memory.
/// `Clamped`: every particle has a slot; no zeros are written then.
template <bool Clamped>
class Scatter {
 public:
  using T = Tiling<Clamped>;

  void allocate(const TileGrid& grid, std::int64_t n) {
    int device = 0, processors = 0, resident = 0, shared = 0;
    GPUPHYS_CUDA(cudaGetDevice(&device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&shared, cudaDevAttrMaxSharedMemoryPerBlockOptin, device));
    shared = std::min(shared, Policy::count_shared) - 1024;  // for what the kernel declares by itself
    bins_ = tiles::Binning(grid, n, Policy::piece, static_cast<std::size_t>(shared), processors);
    GPUPHYS_CUDA(cudaFuncSetAttribute(count, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    GPUPHYS_CUDA(cudaFuncSetAttribute(assign, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    records_ = DeviceBuffer<float4>(static_cast<std::size_t>(kStride * n));
    accumulators_ = DeviceBuffer<float4>(static_cast<std::size_t>(grid.tile_count()) * kTileNodes);
    GPUPHYS_CUDA(cudaFuncSetAttribute(sum, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(sizeof(ScatterShared))));
    GPUPHYS_CUDA(cudaFuncSetAttribute(sum, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      static_cast<int>(cudaSharedmemCarveoutMaxShared)));
    GPUPHYS_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&resident, sum, kScatterThreads,
                                                               sizeof(ScatterShared)));
    scatter_blocks_ = processors * std::max(resident, 1);
  }

  void compute(const TileGrid& grid, const Particles& particles, const Moduli& moduli, const Result& result) {
    const std::int64_t n = particles.n;
    const BinningView& bins = bins_.view();
    bins_.clear();
    const auto parts = static_cast<unsigned>(bins.parts);
    mark<<<blocks(n, Policy::mark_threads * Policy::mark_stride), Policy::mark_threads>>>(grid, bins,
                                                                                          particles.x, n);
    count<<<parts, Policy::count_threads, tiles::count_shared_bytes(bins)>>>(grid, bins, particles.x, n);
    plan<<<blocks(grid.tile_count(), Policy::plan_threads), Policy::plan_threads>>>(grid, bins, Policy::piece,
                                                                                    accumulators_.get());
    assign<<<parts, Policy::count_threads, sizeof(int) * static_cast<std::size_t>(bins.indexed)>>>(bins, n);
    pack<<<blocks(n, Policy::place_threads), Policy::place_threads>>>(grid, particles, moduli, bins.slots,
                                                                      bins.next, records_.get());
    sum<<<static_cast<unsigned>(scatter_blocks_), kScatterThreads, sizeof(ScatterShared)>>>(
        grid, bins.items, bins.cursors + 1, records_.get(), accumulators_.get(), bins.touched, result);
  }

  const BinningView& bins() const { return bins_.view(); }
  const float4* records() const { return records_.get(); }
  const float4* sums() const { return accumulators_.get(); }

  static TileGrid grid_of(std::int64_t nx, std::int64_t ny, std::int64_t nz, float dx) {
    return tiles::make_tile_grid<T>(nx, ny, nz, dx);
  }

 private:
  static constexpr auto mark = tiles::mark_tiles<T, Policy::mark_threads, Policy::mark_stride>;
  static constexpr auto count = tiles::count_particles<T, Policy::count_threads>;
  static constexpr auto plan = tiles::plan_tiles<T, Policy::plan_threads, kTileNodes>;
  static constexpr auto assign = tiles::assign_slots<Policy::count_threads>;
  static constexpr auto pack = place<T>;
  static constexpr auto sum = scatter<!Clamped>;

  tiles::Binning bins_;
  DeviceBuffer<float4> records_, accumulators_;
  int scatter_blocks_ = 0;
};

}  // namespace gpuphys::mpm_scatter
