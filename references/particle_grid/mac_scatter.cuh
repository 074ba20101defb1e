// From particles to the faces of a MAC grid: what p2g_pic_flip (hat kernel, order 1) and p2g_apic (quadratic
// B-splines, order 2) share. FP32.
//
// Passes, after the particles have their slots (references/blocks/particle_tiles.cuh):
//   pack       a thread a particle: a record {place in the cell 3, number of the cell, what each component
//   takes}
//              goes to its slot, whole records at once
//   scatter    a block of four warps for a piece of a tile's list, 4 x 4 x 8 cells: sort it by cell in shared
//              memory; then for each component a thread owns a cell and sums {mass, momentum} of the faces
//              its particles reach in registers. A warp is a plane of cells across x: cells side by side
//              along z and y are added up by shuffles, planes through shared memory, and one sum a face goes
//              to L2
//   normalise  a thread a face: divides, or writes 0
//
// Which faces a cell reaches, along an axis, from the cell's number (faces of the component's own axis lie on
// whole cells, the others in the middle):
//
//   cell        [ 0 ........ 1 )
//   own, hat      0          1                  two faces, weights 1 - f and f
//   other, hat  -1    0     +1                  of the lower and the upper one, one has weight 0
//   own, B-spline -1    0    1    2             of the first and the last, one has weight 0
//   other, B-spline -1    0     +1              all three
//
// Where there are three, their weights add up to 1 and their first moments to 0, so that the middle one takes
// no weight: sums run over all three, and the middle is what the outer two leave (at least half: no digits
// are lost). A particle's place is kept from the nearest whole cell, so that no weight loses digits where it
// vanishes.
#pragma once

#include <cuda_pipeline.h>

#include <algorithm>

#include "core/contract/view.hpp"
#include "references/blocks/particle_tiles.cuh"
#include "references/blocks/tile_sums.cuh"
#include "references/common/alignment.hpp"
#include "references/common/device_buffer.cuh"
#include "references/common/warp_rows.cuh"

namespace gpuphys::mac_scatter {

constexpr int kSideX = 4, kSideY = 4, kSideZ = 8;  // cells of a tile: a warp for each x, lanes (y, z)
constexpr int kCells = kSideX * kSideY * kSideZ;
constexpr int kThreads = kCells;
constexpr int kComponents = 3;

template <int Order>
using Tiling = tiles::Tiling<kSideX, kSideY, kSideZ, Order, true>;

/// Device memory of node sums: [node block][component][node of the block], float2 {mass, momentum}.
constexpr int kBlockSums = kComponents * kCells;
constexpr int kQuadsOfBlock = kBlockSums / 2;

struct Faces {
  float* __restrict__ u[3];
  int extent[3][3];  ///< of component c along axis d
};

/// Faces that a cell reaches along an axis.
template <int Order, bool Own>
struct Reach {
  static constexpr int count = Own ? (Order == 1 ? 2 : 4) : 3;
  static constexpr int lowest = Own && Order == 1 ? 0 : -1;
};

/// Weights of those faces, and moments weight * (face - particle) in cells. Of three faces the middle one's
/// are not used.
template <int Count>
struct Along {
  float w[Count], m[Count];
};

/// `s`: place from the nearest whole cell, below 0 in the upper half of the cell.
template <int Order, bool Own>
__device__ __forceinline__ Along<Reach<Order, Own>::count> along(float s) {
  const float upper = s < 0.0f ? 1.0f : 0.0f;
  const float above = s + upper, below = (1.0f - upper) - s;  // from the cell's two ends
  Along<Reach<Order, Own>::count> a{};
  if constexpr (Order == 1 && Own) {
    a.w[0] = below;
    a.w[1] = above;
  } else if constexpr (Order == 1) {
    const float from_middle = s + (upper - 0.5f);
    a.w[0] = fmaxf(-from_middle, 0.0f);
    a.w[2] = fmaxf(from_middle, 0.0f);
  } else if constexpr (Own) {
    const float low = 0.5f - s, high = 0.5f + s;
    const float w[3] = {0.5f * low * low, 0.75f - s * s, 0.5f * high * high};
    const float m[3] = {-w[0] * (1.0f + s), -w[1] * s, w[2] * (1.0f - s)};
#pragma unroll
    for (int o = 0; o < 4; ++o) {
      const float lower_w = o < 3 ? w[o] : 0.0f, lower_m = o < 3 ? m[o] : 0.0f;
      const float upper_w = o > 0 ? w[o - 1] : 0.0f, upper_m = o > 0 ? m[o - 1] : 0.0f;
      a.w[o] = s < 0.0f ? upper_w : lower_w;
      a.m[o] = s < 0.0f ? upper_m : lower_m;
    }
  } else {
    const float from_middle = s + (upper - 0.5f);
    a.w[0] = 0.5f * below * below;
    a.w[2] = 0.5f * above * above;
    a.m[0] = -a.w[0] * (1.0f + from_middle);
    a.m[2] = a.w[2] * (1.0f - from_middle);
  }
  return a;
}

/// Sums of one thread for component C: mass and momentum of the faces that its cell reaches. Until resolve(),
/// the middle of three stands for all three.
template <int Order, int C>
struct Sums {
  static constexpr int nx = Reach<Order, C == 0>::count, ny = Reach<Order, C == 1>::count,
                       nz = Reach<Order, C == 2>::count;
  float mass[nx][ny][nz], momentum[nx][ny][nz];
};

/// `value`: the component's velocity at the particle, and (order 2) its change a cell along each axis.
template <int Order, int C>
__device__ __forceinline__ void add_particle(Sums<Order, C>& sums, const float4& place, const float4& value) {
  using S = Sums<Order, C>;
  const auto x = along<Order, C == 0>(place.x);
  const auto y = along<Order, C == 1>(place.y);
  const auto z = along<Order, C == 2>(place.z);
#pragma unroll
  for (int i = 0; i < S::nx; ++i) {
    const bool all_x = C != 0 && i == 1;
    const float wx = all_x ? 1.0f : x.w[i];
    float plain_x = all_x ? value.x : wx * value.x;
    if (Order == 2 && !all_x) plain_x += x.m[i] * value.y;
    const float slope_y = all_x ? value.z : wx * value.z, slope_z = all_x ? value.w : wx * value.w;
#pragma unroll
    for (int j = 0; j < S::ny; ++j) {
      const bool all_y = C != 1 && j == 1;
      const float wxy = all_y ? wx : wx * y.w[j];
      float plain = all_y ? plain_x : y.w[j] * plain_x;
      if (Order == 2 && !all_y) plain += y.m[j] * slope_y;
      const float slope = all_y ? slope_z : y.w[j] * slope_z;
#pragma unroll
      for (int k = 0; k < S::nz; ++k) {
        if (C != 2 && k == 1) {
          sums.mass[i][j][k] += wxy;
          sums.momentum[i][j][k] += plain;
        } else {
          sums.mass[i][j][k] += wxy * z.w[k];
          sums.momentum[i][j][k] += plain * z.w[k];
          if (Order == 2) sums.momentum[i][j][k] += z.m[k] * slope;
        }
      }
    }
  }
}

/// Leaves the middle face where the sum of three was.
template <int Nx, int Ny, int Nz>
__device__ __forceinline__ void resolve(float (&s)[Nx][Ny][Nz], bool in_x, bool in_y, bool in_z) {
#pragma unroll
  for (int i = 0; i < Nx; ++i) {
#pragma unroll
    for (int j = 0; j < Ny; ++j) {
      if (in_z) s[i][j][1] -= s[i][j][0] + s[i][j][Nz - 1];
    }
#pragma unroll
    for (int k = 0; k < Nz; ++k) {
      if (in_y) s[i][1][k] -= s[i][0][k] + s[i][Ny - 1][k];
    }
  }
#pragma unroll
  for (int j = 0; j < Ny; ++j) {
#pragma unroll
    for (int k = 0; k < Nz; ++k) {
      if (in_x) s[1][j][k] -= s[0][j][k] + s[Nx - 1][j][k];
    }
  }
}

/// Adds up the cells of a warp along z, then y.
template <int Nx, int Ny, int Nz>
__device__ __forceinline__ void add_plane(float (&s)[Nx][Ny][Nz], bool below_y, bool below_z) {
#pragma unroll
  for (int i = 0; i < Nx; ++i) {
#pragma unroll
    for (int j = 0; j < Ny; ++j) {
      if constexpr (Nz == 2) tiles::add_along<1>(below_z, s[i][j][0], s[i][j][1]);
      if constexpr (Nz == 3) tiles::add_along<1>(below_z, s[i][j][0], s[i][j][1], s[i][j][2]);
      if constexpr (Nz == 4) tiles::add_along<1>(below_z, s[i][j][0], s[i][j][1], s[i][j][2], s[i][j][3]);
    }
#pragma unroll
    for (int k = 0; k < Nz; ++k) {
      if constexpr (Ny == 2) tiles::add_along<8>(below_y, s[i][0][k], s[i][1][k]);
      if constexpr (Ny == 3) tiles::add_along<8>(below_y, s[i][0][k], s[i][1][k], s[i][2][k]);
      if constexpr (Ny == 4) tiles::add_along<8>(below_y, s[i][0][k], s[i][1][k], s[i][2][k], s[i][3][k]);
    }
  }
}

/// Faces of component C that a tile reaches along an axis.
template <int Order, int C>
__host__ __device__ constexpr int span(int axis) {
  const int count = axis == C ? Reach<Order, true>::count : Reach<Order, false>::count;
  return (axis == 0 ? kSideX : axis == 1 ? kSideY : kSideZ) + count - 1;
}
/// Most sums of planes that a component has: [face across x, of the cell's][cell along x][face along y][z].
template <int Order, int C>
__host__ __device__ constexpr int plane_sums() {
  return Sums<Order, C>::nx * kSideX * span<Order, C>(1) * span<Order, C>(2);
}
template <int Order>
__host__ __device__ constexpr int most_plane_sums() {
  const int x = plane_sums<Order, 0>(), y = plane_sums<Order, 1>(), z = plane_sums<Order, 2>();
  return x > y ? (x > z ? x : z) : (y > z ? y : z);
}

template <int Order, int Quads, int Piece>
struct Shared {
  float4 list[Quads * Piece];
  float2 planes[most_plane_sums<Order>()];
  tiles::CellOrder<kCells, Piece> cells;
};

/// Stores a thread's sums: its lowest face along y and z is whole; those beyond the tile's last cells as
/// well.
template <int Order, int C>
__device__ __forceinline__ void store_plane(float2* __restrict__ planes, const Sums<Order, C>& sums,
                                            int cell_x, int cell_y, int cell_z) {
  using S = Sums<Order, C>;
  constexpr int row = span<Order, C>(2), plane = span<Order, C>(1) * row;
#pragma unroll
  for (int i = 0; i < S::nx; ++i) {
    float2* nodes = planes + (i * kSideX + cell_x) * plane + cell_y * row + cell_z;
#pragma unroll
    for (int j = 0; j < S::ny; ++j) {
#pragma unroll
      for (int k = 0; k < S::nz; ++k) {
        if ((j > 0 && cell_y != kSideY - 1) || (k > 0 && cell_z != kSideZ - 1)) continue;
        nodes[j * row + k] = make_float2(sums.mass[i][j][k], sums.momentum[i][j][k]);
      }
    }
  }
}

/// Adds up the planes that meet in each face, and adds the face to the grid's sums.
template <int Order, int C>
__device__ __forceinline__ void flush(const float2* __restrict__ planes, const tiles::TileGrid& grid,
                                      const int4& tile, float2* __restrict__ accumulators) {
  using S = Sums<Order, C>;
  constexpr int row = span<Order, C>(2), plane = span<Order, C>(1) * row, faces = span<Order, C>(0) * plane;
  // From the node block's first, which lies one below the tile's first cell.
  constexpr int first[3] = {Reach<Order, C == 0>::lowest + 1, Reach<Order, C == 1>::lowest + 1,
                            Reach<Order, C == 2>::lowest + 1};
  for (int at = static_cast<int>(threadIdx.x); at < faces; at += kThreads) {
    const int x = at / plane, in_plane = at - x * plane;
    float2 sum = make_float2(0.0f, 0.0f);
#pragma unroll
    for (int i = 0; i < S::nx; ++i) {
      const int cell = x - i;
      if (cell < 0 || cell >= kSideX) continue;
      const float2 part = planes[(i * kSideX + cell) * plane + in_plane];
      sum.x += part.x;
      sum.y += part.y;
    }
    if (!(sum.x > 0.0f)) continue;
    const int node[3] = {x + first[0], in_plane / row + first[1], in_plane % row + first[2]};
    const int block[3] = {tile.x + node[0] / kSideX, tile.y + node[1] / kSideY, tile.z + node[2] / kSideZ};
    if (block[0] >= grid.tiles[0] || block[1] >= grid.tiles[1] || block[2] >= grid.tiles[2]) continue;
    const int local = (node[0] % kSideX * kSideY + node[1] % kSideY) * kSideZ + node[2] % kSideZ;
    const auto number = static_cast<std::size_t>(grid.tile(block[0], block[1], block[2]));
    reduce_add(accumulators + (number * kBlockSums + C * kCells + local), sum);
  }
}

template <int Order, int Quads, int Piece, int C>
__device__ __forceinline__ void sum_component(Shared<Order, Quads, Piece>& shared, Sums<Order, C>& sums,
                                              int cell) {
  const int last = shared.cells.starts[cell + 1];
  // Volatile, so that the next number is on its way while a record is added, not asked for when it is needed.
  const volatile unsigned short* order = shared.cells.order;
  int q = shared.cells.starts[cell], at = order[q];
  while (q < last) {
    const float4* record = shared.list + Quads * at;
    at = order[++q];
    float4 value;
    if constexpr (Order == 1) {
      const float4 velocity = record[1];
      value.x = C == 0 ? velocity.x : C == 1 ? velocity.y : velocity.z;
      value.y = value.z = value.w = 0.0f;
    } else {
      value = record[1 + C];
    }
    add_particle<Order, C>(sums, record[0], value);
  }
}

template <int Order, int C>
__device__ __forceinline__ void add_cells(Sums<Order, C>& sums, int cell_y, int cell_z) {
  resolve(sums.mass, C != 0, C != 1, C != 2);
  resolve(sums.momentum, C != 0, C != 1, C != 2);
  add_plane(sums.mass, cell_y > 0, cell_z > 0);
  add_plane(sums.momentum, cell_y > 0, cell_z > 0);
}

/// Asks for the records of a piece.
template <int Quads>
__device__ __forceinline__ void fetch(float4* list, const float4* __restrict__ records, int first,
                                      int count) {
  const float4* from = records + static_cast<std::int64_t>(Quads) * first;
  for (int i = static_cast<int>(threadIdx.x); i < Quads * count; i += kThreads)
    __pipeline_memcpy_async(list + i, from + i, sizeof(float4));
  __pipeline_commit();
}

template <int Order, int Quads, int Piece, int BlocksPerSm>
__global__ void __launch_bounds__(kThreads, BlocksPerSm)
    scatter(const __grid_constant__ tiles::TileGrid grid, const tiles::WorkItem* __restrict__ items,
            const int* __restrict__ item_count, const float4* __restrict__ records,
            float2* __restrict__ accumulators) {
  extern __shared__ float4 memory[];
  auto& shared = *reinterpret_cast<Shared<Order, Quads, Piece>*>(memory);
  const int cell = static_cast<int>(threadIdx.x);
  const int cell_x = cell / 32, cell_y = cell / 8 % 4, cell_z = cell % 8;
  const int n_items = *item_count, step = static_cast<int>(gridDim.x);
  int i = static_cast<int>(blockIdx.x);
  if (i < n_items) fetch<Quads>(shared.list, records, items[i].first, items[i].count);
  for (; i < n_items; i += step) {
    shared.cells.counts[cell] = 0;
    const int count = items[i].count;
    const int4 tile = items[i].tile;
    __pipeline_wait_prior(0);
    __syncthreads();  // the list is there
    tiles::sort_by_cell<kThreads>(
        shared.cells, count, [&](int p) { return __float_as_int(shared.list[Quads * p].w) & (kCells - 1); });
    {
      Sums<Order, 0> sums{};
      sum_component<Order, Quads, Piece, 0>(shared, sums, cell);
      add_cells<Order, 0>(sums, cell_y, cell_z);
      store_plane<Order, 0>(shared.planes, sums, cell_x, cell_y, cell_z);
    }
    __syncthreads();
    flush<Order, 0>(shared.planes, grid, tile, accumulators);
    {
      Sums<Order, 1> sums{};
      sum_component<Order, Quads, Piece, 1>(shared, sums, cell);
      add_cells<Order, 1>(sums, cell_y, cell_z);
      __syncthreads();  // the planes before are read
      store_plane<Order, 1>(shared.planes, sums, cell_x, cell_y, cell_z);
    }
    __syncthreads();
    flush<Order, 1>(shared.planes, grid, tile, accumulators);
    {
      Sums<Order, 2> sums{};
      sum_component<Order, Quads, Piece, 2>(shared, sums, cell);
      __syncthreads();  // the list is read, and the planes before
      const int next = i + step;
      if (next < n_items) fetch<Quads>(shared.list, records, items[next].first, items[next].count);
      add_cells<Order, 2>(sums, cell_y, cell_z);
      store_plane<Order, 2>(shared.planes, sums, cell_x, cell_y, cell_z);
    }
    __syncthreads();
    flush<Order, 2>(shared.planes, grid, tile, accumulators);
    // The next piece stores planes after three barriers of its sort.
  }
}

/// A block for the faces of a component (blockIdx.y) that share x and a row of node blocks along z; a thread
/// for the four of them that share z too.
template <int Order, int Threads>
__global__ void __launch_bounds__(Threads)
    normalise(const __grid_constant__ tiles::TileGrid grid, const unsigned char* __restrict__ touched,
              const float2* __restrict__ accumulators, const __grid_constant__ Faces faces) {
  using T = Tiling<Order>;
  const int c = static_cast<int>(blockIdx.y);
  const int i = static_cast<int>(blockIdx.x) / grid.tiles[1],
            block_y = static_cast<int>(blockIdx.x) - i * grid.tiles[1];
  const int* const extent = faces.extent[c];
  if (i >= extent[0]) return;
  // From the first node block's first face.
  const int x = i - T::first(0) - T::lowest;
  const int first_j = block_y * kSideY + T::first(1) + T::lowest;
  const int row = grid.tile(x / kSideX, block_y, 0);
  for (int k = static_cast<int>(threadIdx.x); k < extent[2]; k += Threads) {
    const int z = k - T::first(2) - T::lowest;
    const int block = row + z / kSideZ;
    float2 sums[kSideY] = {};
    if (touched[block] != 0) {
      const float2* faces_of_block = accumulators + static_cast<std::size_t>(block) * kBlockSums +
                                     (c * kCells + x % kSideX * kSideY * kSideZ + z % kSideZ);
#pragma unroll
      for (int y = 0; y < kSideY; ++y) sums[y] = __ldcs(faces_of_block + y * kSideZ);
    }
#pragma unroll
    for (int y = 0; y < kSideY; ++y) {
      const int j = first_j + y;
      if (j < 0 || j >= extent[1]) continue;
      __stcs(faces.u[c] + (static_cast<std::int64_t>(i) * extent[1] + j) * extent[2] + k,
             sums[y].x > 0.0f ? sums[y].y / sums[y].x : 0.0f);
    }
  }
}

/// The passes in their order. Pack is a kernel (grid, particles of the task, bins, records) that writes
/// records of Quads float4, the first of them {place in the cell, cell number}.
template <class Policy, int Order, int Quads>
class Transfer {
 public:
  using T = Tiling<Order>;

  void allocate(const tiles::TileGrid& grid, std::int64_t n) {
    int device = 0, processors = 0, resident = 0, shared = 0;
    GPUPHYS_CUDA(cudaGetDevice(&device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&shared, cudaDevAttrMaxSharedMemoryPerBlockOptin, device));
    shared = std::min(shared, Policy::count_shared) - 1024;  // for what the kernel declares by itself
    bins_ = tiles::Binning(grid, n, Policy::piece, static_cast<std::size_t>(shared), processors);
    GPUPHYS_CUDA(cudaFuncSetAttribute(count, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    GPUPHYS_CUDA(cudaFuncSetAttribute(assign, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    records_ = DeviceBuffer<float4>(static_cast<std::size_t>(Quads * n));
    accumulators_ = DeviceBuffer<float4>(static_cast<std::size_t>(grid.tile_count()) * kQuadsOfBlock);
    GPUPHYS_CUDA(cudaFuncSetAttribute(sum, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(kSharedBytes)));
    GPUPHYS_CUDA(cudaFuncSetAttribute(sum, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      static_cast<int>(cudaSharedmemCarveoutMaxShared)));
    GPUPHYS_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&resident, sum, kThreads, kSharedBytes));
    scatter_blocks_ = processors * std::max(resident, 1);
  }

  /// `pack(bins, records)` launches the task's own kernel.
  template <class Pack>
  void compute(const tiles::TileGrid& grid, const float* x, std::int64_t n, const Faces& faces, Pack&& pack) {
    const tiles::BinningView& bins = bins_.view();
    bins_.clear();
    const auto parts = static_cast<unsigned>(bins.parts);
    mark<<<blocks(n, Policy::mark_threads * Policy::mark_stride), Policy::mark_threads>>>(grid, bins, x, n);
    count<<<parts, Policy::count_threads, tiles::count_shared_bytes(bins)>>>(grid, bins, x, n);
    plan<<<blocks(grid.tile_count(), Policy::plan_threads), Policy::plan_threads>>>(grid, bins, Policy::piece,
                                                                                    accumulators_.get());
    assign<<<parts, Policy::count_threads, sizeof(int) * static_cast<std::size_t>(bins.indexed)>>>(bins, n);
    pack(bins, records_.get());
    auto* sums = reinterpret_cast<float2*>(accumulators_.get());
    sum<<<static_cast<unsigned>(scatter_blocks_), kThreads, kSharedBytes>>>(
        grid, bins.items, bins.cursors + 1, records_.get(), sums);
    const dim3 rows(static_cast<unsigned>(grid.nodes[0]) * static_cast<unsigned>(grid.tiles[1]), kComponents);
    divide<<<rows, Policy::normalise_threads>>>(grid, bins.touched, sums, faces);
  }

  static unsigned blocks(std::int64_t items, int per_block) {
    return static_cast<unsigned>(std::max<std::int64_t>(1, (items + per_block - 1) / per_block));
  }

  template <class Outputs>
  static tiles::TileGrid grid_of(const Outputs& out, float dx) {
    return tiles::make_tile_grid<T>(out.ux.shape[0], out.uy.shape[1], out.uz.shape[2], dx);
  }

  template <class Outputs>
  static Faces faces_of(const Outputs& out) {
    Faces f{};
    const View<float, 3> u[3] = {out.ux, out.uy, out.uz};
    for (int c = 0; c < kComponents; ++c) {
      f.u[c] = u[c].data;
      for (int d = 0; d < 3; ++d) f.extent[c][d] = static_cast<int>(u[c].shape[d]);
    }
    return f;
  }

 private:
  static constexpr auto mark = tiles::mark_tiles<T, Policy::mark_threads, Policy::mark_stride>;
  static constexpr auto count = tiles::count_particles<T, Policy::count_threads>;
  static constexpr auto plan = tiles::plan_tiles<T, Policy::plan_threads, kQuadsOfBlock>;
  static constexpr auto assign = tiles::assign_slots<Policy::count_threads>;
  static constexpr auto sum = scatter<Order, Quads, Policy::piece, Policy::scatter_blocks_per_sm>;
  static constexpr auto divide = normalise<Order, Policy::normalise_threads>;
  static constexpr std::size_t kSharedBytes = sizeof(Shared<Order, Quads, Policy::piece>);

  tiles::Binning bins_;
  DeviceBuffer<float4> records_, accumulators_;
  int scatter_blocks_ = 0;
};

}  // namespace gpuphys::mac_scatter
