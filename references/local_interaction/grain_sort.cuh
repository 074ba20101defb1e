// Grains in the order of cells, for the search of their contacts: what the neighbour grid sorts, and a code
// of four bytes per sphere that the search reads in place of it.
#pragma once

#include <cuda_runtime.h>

#include "references/blocks/neighbour_grid.cuh"
#include "references/common/approximate.cuh"
#include "references/common/machine.cuh"

namespace gpuphys::granular {

#ifdef GPUPHYS_OTHER_BLOCKS
struct GridPolicy : neighbour_grid::DefaultPolicy {
  static constexpr int bounds_threads = 256;
  static constexpr int bounds_blocks_per_sm = 1;
  static constexpr int split_threads = 128;
  static constexpr int split_each = 2;
  static constexpr int split_blocks_per_sm = 8;
  static constexpr int bin_cells = 384;
  static constexpr int bin_items = 352;
  static constexpr int bin_threads = 128;
  static constexpr int bin_blocks_per_sm = 8;
  static constexpr int z_cells = 1;
};
#else
using GridPolicy = neighbour_grid::DefaultPolicy;
#endif

// A grain, one sector.
struct alignas(32) Grain {
  float4 sphere;  // centre, radius
  float4 motion;  // velocity, index in the input as bits
};

// ---- Codes: a sphere in four bytes, for a search that never misses a contact ----
//
// Lengths are counted in quanta of 2 largest / resolution. Bytes from the lowest up:
//   0     w, with w^2 <= (2 S e - e^2), where e = largest - r and S = largest + smallest. A contact with any
//         grain of radius r_i needs d^2 < (r_i + r)^2 = R^2 - 2 R e + e^2 <= R^2 - w^2 with R = r_i +
//         largest.
//   1..3  minus the numbers of the quanta that hold x, y and z, modulo 256.
// A grain adds its own numbers (probe_of()) to the code of a candidate: one addition, and the bytes are w and
// the three differences, to within a quantum for x and 1.5 for y and z, into which the byte below may carry.
// The sum of their squares (dp4a) is then compared with (R + slack)^2. Wrapped differences are only smaller
// than the true ones, so they may add candidates, but lose none.

// Quanta in the largest diameter: finer is sharper, until differences wrap within the cells searched.
constexpr float resolution = 80.0f;

__device__ __forceinline__ float quanta_per_metre(const neighbour_grid::Grid& grid) {
  return __fdividef(resolution, 2.0f * grid.largest);
}

__device__ __forceinline__ unsigned code_of(const neighbour_grid::Grid& grid, const float4& sphere) {
  const float per_metre = quanta_per_metre(grid);
  const int x = static_cast<int>(floorf((sphere.x - grid.low[0]) * per_metre));
  const int y = static_cast<int>(floorf((sphere.y - grid.low[1]) * per_metre));
  const int z = static_cast<int>(floorf((sphere.z - grid.low[2]) * per_metre));
  const float smaller = grid.largest - sphere.w;
  const float square = smaller * (2.0f * (grid.largest + grid.smallest) - smaller);
  const int w = static_cast<int>(approximate_sqrt(fmaxf(square, 0.0f)) * per_metre * 0.99999f);  // below 60
  return static_cast<unsigned>(w) | (0u - static_cast<unsigned>(x)) % 256u << 8 |
         (0u - static_cast<unsigned>(y)) % 256u << 16 | (0u - static_cast<unsigned>(z)) << 24;
}

// Halves centre the carries.
__device__ __forceinline__ unsigned probe_of(const neighbour_grid::Grid& grid, const float4& sphere) {
  const float per_metre = quanta_per_metre(grid);
  const int x = static_cast<int>(floorf((sphere.x - grid.low[0]) * per_metre));
  const int y = static_cast<int>(floorf((sphere.y - grid.low[1]) * per_metre - 0.5f));
  const int z = static_cast<int>(floorf((sphere.z - grid.low[2]) * per_metre - 0.5f));
  return static_cast<unsigned>(x) % 256u << 8 | static_cast<unsigned>(y) % 256u << 16 |
         static_cast<unsigned>(z) << 24;
}

// What dp4a of a true contact stays below. sqrt(1 + 1.5^2 + 1.5^2) quanta of rounding down, and the rounding
// of the positions in quanta, which lets everything pass where the box is too wide for the numbers.
__device__ __forceinline__ int code_bound(const neighbour_grid::Grid& grid, float radius) {
  const float per_metre = quanta_per_metre(grid);
  const float slack = 2.35f + grid.extent * per_metre * 0x1p-20f;
  const float reach = (radius + grid.largest) * per_metre * 1.00001f + slack;
  return static_cast<int>(fminf(reach * reach, 2e9f)) + 1;
}

// Codes behind the last grain's: they may be read, but are not grains.
constexpr int kPadding = 8;

// The Source of the neighbour grid.
struct Grains {
  using Record = Grain;
  const float* __restrict__ x;
  const float* __restrict__ v;
  const float* __restrict__ r;
  Grain* __restrict__ split;
  float4* __restrict__ sorted;
  unsigned* __restrict__ codes;
  int count;

  __device__ __forceinline__ const float* positions() const { return x; }
  __device__ __forceinline__ const float* radii() const { return r; }
  // As they are: 96 words of x, 96 of v, 32 radii; 56 pieces of 16 bytes.
  static constexpr int chunk_v = 3 * 32, chunk_r = 6 * 32, chunk_floats = 7 * 32;
  __device__ __forceinline__ void prefetch(float* chunk, int first, int end) const {
    const unsigned lane = threadIdx.x % 32, ufirst = static_cast<unsigned>(first);
    const unsigned uend = static_cast<unsigned>(end);
    constexpr unsigned piece_v = chunk_v / 4, piece_r = chunk_r / 4, pieces = chunk_floats / 4;
#pragma unroll
    for (unsigned part = 0; part < 2; ++part) {
      const unsigned piece = lane + 32u * part;
      const float* const array = piece < piece_v ? x : piece < piece_r ? v : r;
      const unsigned word = piece < piece_v   ? 3u * ufirst + 4u * piece
                            : piece < piece_r ? 3u * ufirst + 4u * (piece - piece_v)
                                              : ufirst + 4u * (piece - piece_r);
      const unsigned last = piece < piece_r ? 3u * uend : uend;
      const unsigned bytes = word < last ? min(4u * (last - word), 16u) : 0u;
      if (piece < pieces) copy_async(chunk + 4u * piece, array + (bytes > 0u ? word : 0u), bytes);
    }
  }
  __device__ __forceinline__ Grain record(const float* chunk, int i) const {
    const unsigned lane = threadIdx.x % 32;
    const float* const own = chunk + 3u * lane;
    return {make_float4(own[0], own[1], own[2], chunk[chunk_r + lane]),
            make_float4(own[chunk_v], own[chunk_v + 1], own[chunk_v + 2], __int_as_float(i))};
  }
  __device__ __forceinline__ float3 position(const Grain& grain) const {
    return {grain.sphere.x, grain.sphere.y, grain.sphere.z};
  }
  __device__ __forceinline__ void placed(const neighbour_grid::Grid& grid, int slot,
                                         const Grain& grain) const {
    codes[slot] = code_of(grid, grain.sphere);
    if (slot > 0) return;
#pragma unroll 1  // a branch for nearly all threads, instead of stores without an effect
    for (int k = 0; k < kPadding; ++k) codes[count + k] = 0;
  }
};

}  // namespace gpuphys::granular
