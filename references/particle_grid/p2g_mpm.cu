// p2g_mpm: momentum and elastic forces of particles to grid velocities, quadratic B-splines, FP32.
//
// For every node: u = (sum_p w m v - dt sum_p V0 tau grad w) / sum_p w m, tau the Kirchhoff stress of fixed
// corotated elasticity; 0 where no mass arrives.
//
// Passes over data in random order:
//   count      a thread for four particles: position -> tile of 4^3 cells; an atomic counts it there
//   plan       a thread a tile: reserves its slots, cuts its list into pieces, clears node blocks
//   place      a thread a particle: an atomic takes a slot of its tile's list; stress from F; the packed
//              record {offset 3, v 3, tau 6, padding 4} goes there, written by four lanes at once
//   scatter    a block for a piece of a list: sorts it by cell in shared memory; a thread owns one cell and
//              one of the three node planes along x and sums nine nodes' {mass, momentum} in registers;
//              columns of cells are added up by shuffles, columns of the tile through shared memory; one
//              vector reduction for each of the tile's 216 nodes goes out to L2
//   normalise  a thread for four nodes: divides, writes zeros where no block reached
//
// What bounds it (16.86M particles): atomics at L2 in count, some 55 G/s whatever their addresses, and
// 0.20 GB; DRAM in place, 1.01 GB read and 1.08 GB written at random places; instructions (113 for each of a
// particle's three planes, half as many again around them) and shared memory wavefronts in scatter, with
// 1.08 GB read meanwhile; 201 MB written at the end.
//
// What pays: a stress is computed once a particle in a pass that waits for memory anyway; the slots, asked
// for before it, come meanwhile. A record is two whole sectors and leaves in one instruction: as three
// 16-byte stores at random places, records kept DRAM busy with row changes (NOTES.md). The next piece's list
// is on its way while the present one is summed. Summing in registers first leaves about 14 shared stores
// and 8 loads a cell instead of 864 atomics; factoring the 27 weights (x outside, z inside), with the sum of
// three nodes in place of the middle one, takes 10 multiply-adds and additions a node for all four sums.
#include <cuda_pipeline.h>

#include <algorithm>

#include "cases/particle_grid/p2g_mpm.hpp"
#include "references/common/quadratic_bspline.cuh"
#include "references/particle_grid/fixed_corotated.cuh"
#include "references/particle_grid/particle_binning.cuh"

namespace gpuphys::p2g_mpm {
namespace {

using particle_grid::BinningView;
using particle_grid::kTileNodes;
using particle_grid::kTileSide;
using particle_grid::TileGrid;
using particle_grid::WorkItem;

struct Policy {
  static constexpr int count_threads = 256;
  static constexpr int count_per_thread = 4;  // independent atomics in flight
  static constexpr int plan_threads = 256;
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int place_threads = 256;
  static constexpr int place_blocks_per_sm = 4;
  static constexpr int piece = 320;
  static constexpr int scatter_blocks_per_sm = 3;
#else
  static constexpr int place_threads = 128;
  static constexpr int place_blocks_per_sm = 9;  // 36 warps in 56 registers; ten blocks spill
  static constexpr int piece =
      576;  // particles of a tile that a block takes: eight a cell, and room for chance
  static constexpr int scatter_blocks_per_sm = 4;
#endif
  static constexpr int normalise_threads = 256;
};

constexpr int kPlanes = 3;                                 // nodes a particle reaches along an axis
constexpr int kSide = kTileSide + kPlanes - 1;             // nodes of a tile with its halo
constexpr int kCells = kTileSide * kTileSide * kTileSide;  // of a tile
constexpr int kColumns = kTileSide * kTileSide * kPlanes;  // (cell x, cell y, plane)
constexpr int kScatterThreads = kColumns * kTileSide;      // one for each cell of each column
constexpr int kRecord = 3;                                 // float4 a particle
constexpr int kStride = 4;                                 // the same in memory: two whole sectors
constexpr int kRounds = (Policy::piece + kScatterThreads - 1) / kScatterThreads;
constexpr int kWarpColumns = 32 / kTileSide;
static_assert(kColumns % kWarpColumns == 0, "shuffles need whole columns in a warp");

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

// Rows of Width floats, one for each thread of the warp, from memory in whole lines to registers.
template <int Width>
__device__ __forceinline__ void load_rows(const float* __restrict__ rows, std::int64_t first, std::int64_t n,
                                          float (&in_flight)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t begin = Width * first, end = Width * n;
#pragma unroll
  for (int s = 0; s < Width; ++s) {
    const std::int64_t i = begin + s * 32 + lane;
    in_flight[s] = i < end ? __ldcs(rows + i) : 0.0f;
  }
}

// The rows to shared memory: the lane's own begins at stage[lane * Width], from the next __syncwarp() on.
template <int Width>
__device__ __forceinline__ void stage_rows(float* __restrict__ stage, const float (&in_flight)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
#pragma unroll
  for (int s = 0; s < Width; ++s) stage[s * 32 + lane] = in_flight[s];
}

template <int Width>
__device__ __forceinline__ void transpose_rows(float* __restrict__ stage, float (&values)[Width]) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  stage_rows(stage, values);
  __syncwarp();
#pragma unroll
  for (int s = 0; s < Width; ++s) values[s] = stage[lane * Width + s];
}

__global__ void __launch_bounds__(Policy::place_threads, Policy::place_blocks_per_sm)
    place(const __grid_constant__ TileGrid grid, const __grid_constant__ Particles particles, Moduli moduli,
          int* __restrict__ next, float4* __restrict__ records) {
  constexpr int per_warp = 32 * (3 + 3 + 9);
  constexpr int per_store = 32 / kStride;  // records that a warp writes at once
  __shared__ __align__(16) float staging[Policy::place_threads / 32][per_warp];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::place_threads + threadIdx.x;
  const std::int64_t first = p - lane;
  float x[3], v[3], f[9];
  load_rows(particles.x, first, particles.n, x);
  load_rows(particles.v, first, particles.n, v);
  load_rows(particles.f, first, particles.n, f);
  transpose_rows(stage, x);
  const particle_grid::Place at = particle_grid::locate(grid, x[0], x[1], x[2]);
  const int tile = particle_grid::listed_tile(at, p, particles.n);
  // Nothing waits for the answer until the record is written: the stress hides it.
  const int slot = tile >= 0 ? atomicAdd(next + tile, 1) : -1;
  // What the stress does not need waits in the lane's own rows: registers decide how many warps are resident.
#pragma unroll
  for (int d = 0; d < 3; ++d) stage[lane * 3 + d] = at.offset[d];
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

constexpr int kFetchRecords = kScatterThreads / kRecord;  // that the block's threads fetch at once
constexpr int kFetches = (Policy::piece + kFetchRecords - 1) / kFetchRecords;
static_assert(kScatterThreads % kRecord == 0);

// Sums of the cell columns: [node along y, of the cell's three][node along z, of the tile's six][column].
constexpr int kPlaneColumns = kColumns + 1;  // padded: nodes along z lie in different banks
constexpr int kRowSums = kSide * kPlaneColumns;

// Memory for the list of a piece; later the sums of the cell columns.
struct ListMemory {
  float4 data[std::max(kRecord * Policy::piece, kPlanes* kRowSums)];
};

struct ScatterShared {
  ListMemory lists[2];  // one in work, one on its way
  int counts[kCells];
  int starts[kCells + 1];
  unsigned short order[Policy::piece];
};

// Sums of one thread: nine nodes, {mass, momentum}, mass in units of a particle's. While particles are being
// added, index 1 of y and z stands for the sum over the three nodes along that axis: three weights add up to
// 1 and three slopes to 0, so that it takes no weight. resolve() leaves the middle node there. No digits
// matter: the middle weight is 1/2 to 3/4 of the three.
struct Sums {
  float s[kPlanes][kPlanes][4];  // [node along y][node along z]
};

__device__ __forceinline__ void add_particle(Sums& sums, const bspline::Branch& branch,
                                             const float (&centre)[3], const float4& a, const float4& b,
                                             const float4& c) {
  float wx, slope_x;
  bspline::evaluate(branch, a.x - centre[0], wx, slope_x);
  const bspline::Weights y = bspline::quadratic(a.y - centre[1]), z = bspline::quadratic(a.z - centre[2]);
  const float velocity[3] = {a.w, b.x, b.y};
  const float tau[3][3] = {{b.z, c.y, c.z}, {c.y, b.w, c.w}, {c.z, c.w, c.x}};
#pragma unroll
  for (int oy = 0; oy < kPlanes; ++oy) {
    const float wxy = oy == 1 ? wx : wx * y.w[oy];
    sums.s[oy][0][0] += wxy * z.w[0];
    sums.s[oy][1][0] += wxy;
    sums.s[oy][2][0] += wxy * z.w[2];
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const float along_x = wx * velocity[d] + slope_x * tau[d][0];
    const float along_y = wx * tau[d][1], along_z = wx * tau[d][2];
#pragma unroll
    for (int oy = 0; oy < kPlanes; ++oy) {
      const float plain = oy == 1 ? along_x : y.w[oy] * along_x + y.slope[oy] * along_y;
      const float sloped = oy == 1 ? along_z : y.w[oy] * along_z;
      sums.s[oy][0][1 + d] += z.w[0] * plain;
      sums.s[oy][0][1 + d] += z.slope[0] * sloped;
      sums.s[oy][1][1 + d] += plain;
      sums.s[oy][2][1 + d] += z.w[2] * plain;
      sums.s[oy][2][1 + d] += z.slope[2] * sloped;
    }
  }
}

__device__ __forceinline__ void resolve(Sums& sums) {
#pragma unroll
  for (int q = 0; q < 4; ++q) {
#pragma unroll
    for (int oy = 0; oy < kPlanes; ++oy) sums.s[oy][1][q] -= sums.s[oy][0][q] + sums.s[oy][2][q];
#pragma unroll
    for (int oz = 0; oz < kPlanes; ++oz) sums.s[1][oz][q] -= sums.s[0][oz][q] + sums.s[2][oz][q];
  }
}

// 16 bytes to shared memory, past the registers. Spelled out: with one 32-bit address for all copies of a
// thread their distances become constants of the instructions.
__device__ __forceinline__ void copy_async(unsigned to_shared, const float4* from) {
  asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" : : "r"(to_shared), "l"(from) : "memory");
}

// Asks for the records of a piece: three threads a record, nothing of the padding.
__device__ __forceinline__ void fetch(ListMemory& list, const float4* __restrict__ records, int first,
                                      int count) {
  const int thread = static_cast<int>(threadIdx.x);
  const int record = thread / kRecord, part = thread % kRecord;
  const float4* from = records + static_cast<std::int64_t>(kStride) * (first + record) + part;
  const auto to = static_cast<unsigned>(__cvta_generic_to_shared(list.data + thread));
#pragma unroll
  for (int s = 0; s < kFetches; ++s) {
    if (record + s * kFetchRecords < count)
      copy_async(to + s * kScatterThreads * sizeof(float4), from + s * kStride * kFetchRecords);
  }
  __pipeline_commit();
}

// Sorts the piece's records by cell: order[starts[cell] ..) lists them.
__device__ __forceinline__ void sort_by_cell(ScatterShared& shared, const ListMemory& list, int count) {
  const int thread = static_cast<int>(threadIdx.x);
  int cell[kRounds], rank[kRounds];
#pragma unroll
  for (int s = 0; s < kRounds; ++s) {
    const int p = thread + s * kScatterThreads;
    if (p < count) {
      const float4 a = list.data[kRecord * p];
      cell[s] = (particle_grid::cell_of(a.x) * kTileSide + particle_grid::cell_of(a.y)) * kTileSide +
                particle_grid::cell_of(a.z);
      rank[s] = atomicAdd(&shared.counts[cell[s]], 1);
    }
  }
  __syncthreads();
  if (thread < 32) {
    const int low = shared.counts[2 * thread], high = shared.counts[2 * thread + 1];
    int sum = low + high;
#pragma unroll
    for (int step = 1; step < 32; step *= 2) {
      const int below = __shfl_up_sync(0xffffffffu, sum, static_cast<unsigned>(step));
      if (thread >= step) sum += below;
    }
    shared.starts[2 * thread] = sum - low - high;
    shared.starts[2 * thread + 1] = sum - high;
    if (thread == 31) shared.starts[kCells] = sum;
  }
  __syncthreads();
#pragma unroll
  for (int s = 0; s < kRounds; ++s) {
    const int p = thread + s * kScatterThreads;
    if (p < count) shared.order[shared.starts[cell[s]] + rank[s]] = static_cast<unsigned short>(p);
  }
  __syncthreads();
}

// Adds up a column's four cells (eight lanes apart) and leaves its six nodes in shared memory.
__device__ __forceinline__ void store_columns(ListMemory& list, const Sums& sums, int column, int cell_z) {
#pragma unroll
  for (int oy = 0; oy < kPlanes; ++oy) {
    float own[4], next[4];  // node cell_z, complete; node cell_z + 1 without the cell above's lowest plane
#pragma unroll
    for (int q = 0; q < 4; ++q) {
      const float top_below = __shfl_up_sync(0xffffffffu, sums.s[oy][2][q], kWarpColumns);
      next[q] = sums.s[oy][1][q] + (cell_z > 0 ? top_below : 0.0f);
      const float next_below = __shfl_up_sync(0xffffffffu, next[q], kWarpColumns);
      own[q] = sums.s[oy][0][q] + (cell_z > 0 ? next_below : 0.0f);
    }
    float4* nodes = list.data + oy * kRowSums + cell_z * kPlaneColumns + column;
    nodes[0] = make_float4(own[0], own[1], own[2], own[3]);
    if (cell_z == kTileSide - 1) {
      nodes[kPlaneColumns] = make_float4(next[0], next[1], next[2], next[3]);
      nodes[2 * kPlaneColumns] =
          make_float4(sums.s[oy][2][0], sums.s[oy][2][1], sums.s[oy][2][2], sums.s[oy][2][3]);
    }
  }
}

// Adds up the columns that reach each node of the tile and its halo, and adds the node to the grid.
__device__ __forceinline__ void flush_nodes(const ListMemory& list, const TileGrid& grid, const int4& tile,
                                            float4* __restrict__ accumulators) {
  for (int node = static_cast<int>(threadIdx.x); node < kSide * kSide * kSide; node += kScatterThreads) {
    const int x = node / (kSide * kSide), y = node / kSide % kSide, z = node % kSide;
    const float4* base = list.data + z * kPlaneColumns;
    float4 sum = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
#pragma unroll
    for (int ox = 0; ox < kPlanes; ++ox) {
#pragma unroll
      for (int oy = 0; oy < kPlanes; ++oy) {
        const int cx = x - ox, cy = y - oy;
        if (cx < 0 || cx >= kTileSide || cy < 0 || cy >= kTileSide) continue;
        const int column = (cx * kTileSide + cy) * kPlanes + ox;
        const float4 part = base[oy * kRowSums + column];
        sum.x += part.x;
        sum.y += part.y;
        sum.z += part.z;
        sum.w += part.w;
      }
    }
    if (!(sum.x > 0.0f)) continue;
    const int i = kTileSide * tile.x - 2 + x, j = kTileSide * tile.y - 2 + y, k = kTileSide * tile.z - 2 + z;
    if (i < 0 || i >= grid.nodes[0] || j < 0 || j >= grid.nodes[1] || k < 0 || k >= grid.nodes[2]) continue;
    const int block = grid.tile(tile.x + x / kTileSide, tile.y + y / kTileSide, tile.z + z / kTileSide);
    const int local = (x % kTileSide * kTileSide + y % kTileSide) * kTileSide + z % kTileSide;
    particle_grid::reduce_add(accumulators + static_cast<std::size_t>(block) * kTileNodes + local, sum);
  }
}

__global__ void __launch_bounds__(kScatterThreads, Policy::scatter_blocks_per_sm)
    scatter(const __grid_constant__ TileGrid grid, const WorkItem* __restrict__ items,
            const int* __restrict__ item_count, const float4* __restrict__ records,
            float4* __restrict__ accumulators) {
  extern __shared__ float4 memory[];
  ScatterShared& shared = *reinterpret_cast<ScatterShared*>(memory);
  const int thread = static_cast<int>(threadIdx.x);
  // Neighbouring lanes share cells, three planes each: they read the same records.
  const int cell_z = thread % 32 / kWarpColumns, column = thread / 32 * kWarpColumns + thread % kWarpColumns;
  const int plane = column % kPlanes, cell_xy = column / kPlanes;
  const int cell = cell_xy * kTileSide + cell_z;
  const bspline::Branch branch = bspline::quadratic_branch(plane);
  // The middle node of the cell's three, from the tile's first.
  const float centre[3] = {static_cast<float>(cell_xy / kTileSide + 1),
                           static_cast<float>(cell_xy % kTileSide + 1), static_cast<float>(cell_z + 1)};
  const int n_items = *item_count, step = static_cast<int>(gridDim.x);
  int i = static_cast<int>(blockIdx.x);
  if (i >= n_items) return;
  int count = items[i].count;
  fetch(shared.lists[0], records, items[i].first, count);
  for (int buffer = 0;; buffer ^= 1) {
    ListMemory& list = shared.lists[buffer];
    if (thread < kCells) shared.counts[thread] = 0;
    const int next = i + step;
    const int next_first = next < n_items ? items[next].first : 0;
    const int next_count = next < n_items ? items[next].count : 0;
    __pipeline_wait_prior(0);
    __syncthreads();  // the list is there, and the other list's sums are read
    sort_by_cell(shared, list, count);
    fetch(shared.lists[buffer ^ 1], records, next_first, next_count);

    Sums sums{};
    const int last = shared.starts[cell + 1];
    for (int q = shared.starts[cell]; q < last; ++q) {
      const float4* record = list.data + kRecord * shared.order[q];
      add_particle(sums, branch, centre, record[0], record[1], record[2]);
    }
    const int4 tile = items[i].tile;
    resolve(sums);
    __syncthreads();  // the list is read: its memory takes the sums
    store_columns(list, sums, column, cell_z);
    __syncthreads();
    flush_nodes(list, grid, tile, accumulators);
    if (next >= n_items) break;
    i = next;
    count = next_count;
  }
}

struct Result {
  float* __restrict__ u[3];
};

// One thread for node (j, k) of four consecutive planes i: the ones of a node block.
__global__ void __launch_bounds__(Policy::normalise_threads)
    normalise(const __grid_constant__ TileGrid grid, const unsigned char* __restrict__ touched,
              const float4* __restrict__ accumulators, const __grid_constant__ Result result) {
  const std::int64_t e = static_cast<std::int64_t>(blockIdx.x) * Policy::normalise_threads + threadIdx.x;
  const std::int64_t row = e / grid.nodes[2];
  const int k = static_cast<int>(e - row * grid.nodes[2]);
  const int tile_x = static_cast<int>(row / grid.nodes[1]), j = static_cast<int>(row % grid.nodes[1]);
  if (tile_x >= grid.tiles[0]) return;
  const int block = grid.tile(tile_x, (j + 2) / kTileSide, (k + 2) / kTileSide);
  const int local = (j + 2) % kTileSide * kTileSide + (k + 2) % kTileSide;
  const float4* nodes = accumulators + static_cast<std::size_t>(block) * kTileNodes + local;
  const bool any = touched[block] != 0;
  float4 node[kTileSide];
#pragma unroll
  for (int s = 0; s < kTileSide; ++s)
    node[s] = any ? __ldcs(nodes + s * kTileSide * kTileSide) : make_float4(0.0f, 0.0f, 0.0f, 0.0f);
#pragma unroll
  for (int s = 0; s < kTileSide; ++s) {
    const int i = kTileSide * tile_x - 2 + s;
    if (i < 0 || i >= grid.nodes[0]) continue;
    const std::int64_t at = (static_cast<std::int64_t>(i) * grid.nodes[1] + j) * grid.nodes[2] + k;
    const bool has_mass = node[s].x > 0.0f;
    __stcs(result.u[0] + at, has_mass ? node[s].y / node[s].x : 0.0f);
    __stcs(result.u[1] + at, has_mass ? node[s].z / node[s].x : 0.0f);
    __stcs(result.u[2] + at, has_mass ? node[s].w / node[s].x : 0.0f);
  }
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>& out) {
    const std::int64_t n = in.x.shape[0];
    const TileGrid grid = grid_of(in, out);
    bins_ = particle_grid::Binning(grid, n, Policy::piece);
    records_ = DeviceBuffer<float4>(static_cast<std::size_t>(kStride * n));
    accumulators_ = DeviceBuffer<float4>(static_cast<std::size_t>(grid.tile_count()) * kTileNodes);
    int device = 0, processors = 0, resident = 0;
    GPUPHYS_CUDA(cudaGetDevice(&device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
    GPUPHYS_CUDA(cudaFuncSetAttribute(scatter, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(sizeof(ScatterShared))));
    GPUPHYS_CUDA(cudaFuncSetAttribute(scatter, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      static_cast<int>(cudaSharedmemCarveoutMaxShared)));
    GPUPHYS_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&resident, scatter, kScatterThreads,
                                                               sizeof(ScatterShared)));
    scatter_blocks_ = processors * std::max(resident, 1);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const std::int64_t n = in.x.shape[0];
    const TileGrid grid = grid_of(in, out);
    const BinningView bins = bins_.view();
    const auto blocks = [](std::int64_t items, int per_block) {
      return static_cast<unsigned>(std::max<std::int64_t>(1, (items + per_block - 1) / per_block));
    };
    bins_.clear();
    constexpr int per_block = Policy::count_threads * Policy::count_per_thread;
    particle_grid::count_particles<Policy::count_threads, Policy::count_per_thread>
        <<<blocks(n, per_block), Policy::count_threads>>>(grid, in.x.data, n, bins.counts);
    particle_grid::plan_tiles<Policy::plan_threads>
        <<<blocks(grid.tile_count(), Policy::plan_threads), Policy::plan_threads>>>(grid, bins, Policy::piece,
                                                                                    accumulators_.get());
    const Particles particles{in.x.data, in.v.data, in.F.data, n};
    const float impulse = -in.dt * (in.V0 / in.mass_p) / in.dx;
    const Moduli moduli{2.0f * in.mu * impulse, in.lambda * impulse};
    place<<<blocks(n, Policy::place_threads), Policy::place_threads>>>(grid, particles, moduli, bins.next,
                                                                       records_.get());
    scatter<<<static_cast<unsigned>(scatter_blocks_), kScatterThreads, sizeof(ScatterShared)>>>(
        grid, bins.items, bins.cursors + 1, records_.get(), accumulators_.get());
    const std::int64_t columns = static_cast<std::int64_t>(grid.tiles[0]) * grid.nodes[1] * grid.nodes[2];
    normalise<<<blocks(columns, Policy::normalise_threads), Policy::normalise_threads>>>(
        grid, bins.touched, accumulators_.get(), Result{{out.ux.data, out.uy.data, out.uz.data}});
  }

 private:
  static TileGrid grid_of(const Inputs& in, const Outputs<float>& out) {
    return particle_grid::make_tile_grid(out.ux.shape[0], out.ux.shape[1], out.ux.shape[2], in.dx);
  }

  particle_grid::Binning bins_;
  DeviceBuffer<float4> records_, accumulators_;
  int scatter_blocks_ = 0;
};

}  // namespace
}  // namespace gpuphys::p2g_mpm

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(p2g_mpm, p2g_mpm::Reference)
}
