// Building block: values of a grid to particles in random order. A task's own file says what a particle takes
// from the samples around it, and what becomes of that.
//
//   bin      particles to tiles of cells (particle_tiles.cuh): a slot in its tile's list for each particle
//   place    a thread a particle: {place in its cell 3, number of the cell} to its slot, 16 bytes
//   gather   a block for a piece of a tile's list: brings the tile's samples and their halo to shared memory,
//   sorts the
//            piece by cell, so that the lanes of a warp ask for the same few samples, and a thread for each
//            particle evaluates. Results leave in the order of the slots, in whole lines
//   finish   the task's own: a thread a particle, in the order of the input again, fetches its result from
//   its slot
//
//   particles  0 1 2 3 4 ...  --place-->  | tile a: 4 0 7 | tile b: 3 9 | ...  --gather-->  results
//   --finish-->  0 1 2 3
//
// Why not straight from the grid: 27 nodes of 16 bytes in 9 rows are 18 sectors of 32 bytes, 576 bytes a
// particle from L2 (where a grid of 256^3 nodes does not fit: from DRAM). Here a particle costs 16 bytes out
// and in for its place, some 12 for its tile, and its result twice.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "core/contract/module.hpp"
#include "references/blocks/particle_tiles.cuh"
#include "references/blocks/tile_sums.cuh"
#include "references/common/device_buffer.cuh"

namespace gpuphys::tiles {

/// A source of samples: how many arrays there are, their extents, and a sample of one by its place in the
/// array. This one has its samples in memory; a task may bring a source of its own, which computes them.
template <int Arrays>
struct Samples {
  static constexpr int arrays = Arrays;
  const float* __restrict__ values[Arrays];
  int extent[Arrays][3];

  __device__ __forceinline__ float at(int array, std::int64_t i) const { return __ldg(values[array] + i); }
};

/// A tile's samples and their halo along an axis, from `lowest` on.
template <class Tiling>
__host__ __device__ constexpr int halo_side(int d) {
  return Tiling::side(d) + Tiling::highest - Tiling::lowest;
}

/// Samples around a tile in shared memory, z fastest; those outside of an array are its nearest ones.
template <class Tiling, int Arrays>
struct Tile {
  static constexpr int kRow = halo_side<Tiling>(2), kPlane = halo_side<Tiling>(1) * kRow,
                       kSamples = halo_side<Tiling>(0) * kPlane;
  float values[Arrays][kSamples];

  /// The lowest sample that cell number `cell` of the tile reaches.
  static __device__ __forceinline__ int lowest_of(int cell) {
    constexpr int sy = Tiling::side(1), sz = Tiling::side(2);
    return cell / (sy * sz) * kPlane + cell / sz % sy * kRow + cell % sz;
  }
};

/// Weights of three samples in a row along an axis, and what else they are weighted with: slopes or moments,
/// whose sum is 0.
struct Along3 {
  float w[3], d[3];
};

struct Sum27 {
  float value;     ///< sum w u
  float first[3];  ///< the same with d in place of w along x, y, z
};

/// Sums over 27 samples, the lowest one at `samples`. The middle sample is taken off all of them first:
/// nothing that they have in common is rounded.
template <class Tile>
__device__ __forceinline__ Sum27 sum_27(const float* __restrict__ samples, const Along3& x, const Along3& y,
                                        const Along3& z) {
  const float middle = samples[Tile::kPlane + Tile::kRow + 1];
  Sum27 sum{};
#pragma unroll
  for (int i = 0; i < 3; ++i) {
    float value = 0.0f, along_y = 0.0f, along_z = 0.0f;
#pragma unroll
    for (int j = 0; j < 3; ++j) {
      const float* row = samples + i * Tile::kPlane + j * Tile::kRow;
      // Of three weights that add up to 1, and of three others that add up to 0, the middle ones are not
      // needed.
      const float a = row[0] - row[1], c = row[2] - row[1];
      const float plain = (row[1] - middle) + (z.w[0] * a + z.w[2] * c), other = z.d[0] * a + z.d[2] * c;
      value += y.w[j] * plain;
      along_y += y.d[j] * plain;
      along_z += y.w[j] * other;
    }
    sum.value += x.w[i] * value;
    sum.first[0] += x.d[i] * value;
    sum.first[1] += x.w[i] * along_y;
    sum.first[2] += x.w[i] * along_z;
  }
  sum.value += middle;
  return sum;
}

/// What place() leaves for gather().
struct Placed {
  float place[3];  ///< in the cell, as Place::offset
  int cell;
};

/// Writes the places of the particles to their slots, and slots that had to be asked for to bins.slots. A
/// thread a particle.
template <class Tiling, int Threads>
__global__ void __launch_bounds__(Threads)
    place_particles(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins,
                    const float* __restrict__ x, std::int64_t n, float4* __restrict__ places) {
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Threads + threadIdx.x;
  if (p >= n) return;
  const Place at = locate<Tiling>(grid, x[3 * p], x[3 * p + 1], x[3 * p + 2]);
  const int assigned = bins.slots[p];
  const int slot = assigned >= 0 ? assigned : atomicAdd(bins.next + at.tile, 1);
  if (assigned < 0) bins.slots[p] = slot;
  places[slot] = make_float4(at.offset[0], at.offset[1], at.offset[2], __int_as_float(at.cell));
}

template <class Tiling, int Arrays, int Piece, int Quads>
struct GatherShared {
  float4 results[Piece * Quads];
  float4 places[Piece];
  Tile<Tiling, Arrays> tile;
  CellOrder<Tiling::cells, Piece> cells;
};

template <class Tiling, int Threads, class Source>
__device__ __forceinline__ void load_tile(Tile<Tiling, Source::arrays>& tile, const Source& source,
                                          const int4& at) {
  using T = Tile<Tiling, Source::arrays>;
  const int first[3] = {at.x * Tiling::side(0) + Tiling::first(0) + Tiling::lowest,
                        at.y * Tiling::side(1) + Tiling::first(1) + Tiling::lowest,
                        at.z * Tiling::side(2) + Tiling::first(2) + Tiling::lowest};
  for (int s = static_cast<int>(threadIdx.x); s < T::kSamples; s += Threads) {
    const int i = first[0] + s / T::kPlane, j = first[1] + s / T::kRow % halo_side<Tiling>(1),
              k = first[2] + s % T::kRow;
#pragma unroll
    for (int a = 0; a < Source::arrays; ++a) {
      const int(&extent)[3] = source.extent[Tiling::staggered ? a : 0];
      const int ci = min(max(i, 0), extent[0] - 1), cj = min(max(j, 0), extent[1] - 1),
                ck = min(max(k, 0), extent[2] - 1);
      tile.values[a][s] = source.at(a, (static_cast<std::int64_t>(ci) * extent[1] + cj) * extent[2] + ck);
    }
  }
}

/// Where gather() reads places: as place_particles() writes them. Others bring their own stride and reading.
struct OwnPlaces {
  static constexpr int stride = 1;  ///< float4 from one to the next
  static __device__ __forceinline__ Placed placed(const float4& at) {
    return {{at.x, at.y, at.z}, __float_as_int(at.w)};
  }
};

/// Evaluates pieces of lists. `Transfer::evaluate(tile, placed, result)` fills the Transfer::quads float4 of
/// a result, which lie Transfer::stride float4 apart in memory (what is between them is written too: whole
/// sectors leave).
template <class Transfer, class Tiling, class Source, int Threads, int Piece, int BlocksPerSm,
          class Places = OwnPlaces>
__global__ void __launch_bounds__(Threads, BlocksPerSm)
    gather(const __grid_constant__ Source source, const WorkItem* __restrict__ items,
           const int* __restrict__ item_count, const float4* __restrict__ places,
           float4* __restrict__ results) {
  constexpr int quads = Transfer::quads, stride = Transfer::stride;
  constexpr int rounds = (Piece + Threads - 1) / Threads;
  static_assert(Threads >= Tiling::cells);
  extern __shared__ float4 memory[];
  auto& shared = *reinterpret_cast<GatherShared<Tiling, Source::arrays, Piece, quads>*>(memory);
  const int thread = static_cast<int>(threadIdx.x);
  const int n_items = *item_count, step = static_cast<int>(gridDim.x);
  for (int i = static_cast<int>(blockIdx.x); i < n_items; i += step) {
    const WorkItem item = items[i];
    if (thread < Tiling::cells) shared.cells.counts[thread] = 0;
    const float4* from = places + static_cast<std::int64_t>(Places::stride) * item.first;
#pragma unroll
    for (int s = 0; s < rounds; ++s) {
      const int p = thread + s * Threads;
      if (p < item.count) shared.places[p] = __ldcs(from + Places::stride * p);
    }
    load_tile<Tiling, Threads>(shared.tile, source, item.tile);
    __syncthreads();
    sort_by_cell<Threads>(shared.cells, item.count, [&](int p) {
      return Places::placed(shared.places[p]).cell & (Tiling::cells - 1);  // beyond the list: any cell
    });
#pragma unroll 1
    for (int q = thread; q < item.count; q += Threads) {
      const int p = shared.cells.order[q];
      float result[4 * quads];
      Transfer::evaluate(shared.tile, Places::placed(shared.places[p]), result);
#pragma unroll
      for (int e = 0; e < quads; ++e) {
        shared.results[quads * p + e] =
            make_float4(result[4 * e], result[4 * e + 1], result[4 * e + 2], result[4 * e + 3]);
      }
    }
    __syncthreads();  // also: places, tile and order are read
    float4* to = results + static_cast<std::int64_t>(stride) * item.first;
    for (int q = thread; q < stride * item.count; q += Threads) {
      const int part = q % stride;
      to[q] = part < quads ? shared.results[q / stride * quads + part] : make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    }
    // The next piece's results come after the barriers of its sort.
  }
}

/// Brings the results of a warp's particles from their slots to `packed`, Quads float4 each of Stride in
/// memory: the lane's own at packed[Quads * lane], from the next __syncwarp() on. Neighbouring lanes read a
/// whole result at once. A slot below 0 brings none.
template <int Quads, int Stride>
__device__ __forceinline__ void read_results(const float4* __restrict__ results, int slot,
                                             float4* __restrict__ packed) {
  static_assert(Quads <= Stride);
  const int lane = static_cast<int>(threadIdx.x) % 32;
#pragma unroll
  for (int s = 0; s < Stride; ++s) {
    const int item = (32 * s + lane) / Stride, part = (32 * s + lane) % Stride;
    const int from = __shfl_sync(0xffffffffu, slot, item);
    if (from >= 0 && part < Quads)
      packed[Quads * item + part] = __ldcs(results + static_cast<std::int64_t>(Stride) * from + part);
  }
}

/// The passes up to the task's own last one, and their memory.
///
/// Policy: mark_threads, mark_stride, plan_threads, count_threads, count_shared, place_threads,
/// gather_threads, piece, gather_blocks_per_sm.
template <class Policy, class Transfer, class Tiling, class Source>
class TileGather {
 public:
  void allocate(const TileGrid& grid, std::int64_t n) {
    int device = 0, processors = 0, resident = 0, shared = 0;
    GPUPHYS_CUDA(cudaGetDevice(&device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device));
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&shared, cudaDevAttrMaxSharedMemoryPerBlockOptin, device));
    shared = std::min(shared, Policy::count_shared) - 1024;  // for what the kernel declares by itself
    bins_ = Binning(grid, n, Policy::piece, static_cast<std::size_t>(shared), processors);
    GPUPHYS_CUDA(cudaFuncSetAttribute(count, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    GPUPHYS_CUDA(cudaFuncSetAttribute(assign, cudaFuncAttributeMaxDynamicSharedMemorySize, shared));
    places_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    results_ = DeviceBuffer<float4>(static_cast<std::size_t>(Transfer::stride * n));
    GPUPHYS_CUDA(cudaFuncSetAttribute(evaluate, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(kSharedBytes)));
    GPUPHYS_CUDA(cudaFuncSetAttribute(evaluate, cudaFuncAttributePreferredSharedMemoryCarveout,
                                      static_cast<int>(cudaSharedmemCarveoutMaxShared)));
    GPUPHYS_CUDA(cudaOccupancyMaxActiveBlocksPerMultiprocessor(&resident, evaluate, Policy::gather_threads,
                                                               kSharedBytes));
    gather_blocks_ = processors * std::max(resident, 1);
  }

  /// Leaves each particle's result at its slot.
  void compute(const TileGrid& grid, const float* x, std::int64_t n, const Source& source) {
    const BinningView& bins = bins_.view();
    bins_.clear();
    const auto parts = static_cast<unsigned>(bins.parts);
    mark<<<blocks(n, Policy::mark_threads * Policy::mark_stride), Policy::mark_threads>>>(grid, bins, x, n);
    count<<<parts, Policy::count_threads, count_shared_bytes(bins)>>>(grid, bins, x, n);
    plan<<<blocks(grid.tile_count(), Policy::plan_threads), Policy::plan_threads>>>(grid, bins, Policy::piece,
                                                                                    nullptr);
    assign<<<parts, Policy::count_threads, sizeof(int) * static_cast<std::size_t>(bins.indexed)>>>(bins, n);
    place<<<blocks(n, Policy::place_threads), Policy::place_threads>>>(grid, bins, x, n, places_.get());
    evaluate<<<static_cast<unsigned>(gather_blocks_), Policy::gather_threads, kSharedBytes>>>(
        source, bins.items, bins.cursors + 1, places_.get(), results_.get());
  }

  const int* slots() const { return bins_.view().slots; }
  const float4* results() const { return results_.get(); }

  static unsigned blocks(std::int64_t items, int per_block) {
    return static_cast<unsigned>(std::max<std::int64_t>(1, (items + per_block - 1) / per_block));
  }

 private:
  static constexpr auto mark = mark_tiles<Tiling, Policy::mark_threads, Policy::mark_stride>;
  static constexpr auto count = count_particles<Tiling, Policy::count_threads>;
  static constexpr auto plan = plan_tiles<Tiling, Policy::plan_threads, 0>;
  static constexpr auto assign = assign_slots<Policy::count_threads>;
  static constexpr auto place = place_particles<Tiling, Policy::place_threads>;
  static constexpr auto evaluate =
      gather<Transfer, Tiling, Source, Policy::gather_threads, Policy::piece, Policy::gather_blocks_per_sm>;
  static constexpr std::size_t kSharedBytes =
      sizeof(GatherShared<Tiling, Source::arrays, Policy::piece, Transfer::quads>);

  Binning bins_;
  DeviceBuffer<float4> places_, results_;
  int gather_blocks_ = 0;
};

}  // namespace gpuphys::tiles
