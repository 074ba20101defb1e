// particle_sdf: distance from every cell centre to the nearest particle, less the radius, clamped; FP32.
//
// A cell is the set of points that are nearer to its centre than to any other. So a particle lies at least
// half a cell from all centres but its own, and where the particles of a cell come nearer to its centre than
// that, the other cells need not be looked at. With eight particles in a cell that settles 997 of 1000 cells
// inside the liquid, by one atomic minimum per particle. What is left is a shell around the surface:
//
//   fill        clamp everywhere, and the scratch memory to zero
//   own_cells   a thread per four particles: the distance to the own centre, by atomic minimum. phi itself
//   holds
//               the minima, in final form, so that cells far from particles are written once
//   list_tiles  tiles of 8 x 8 x 16 cells with particles, or beside one with particles
//   classify    a block per such tile: which cells are open, that is, may be nearer to a particle of another
//               cell, and which cells' particles these are. The triangle inequality bounds the search: a cell
//               at distance D whose own minimum is m has a particle within D + m
//   collect     a thread per four particles: those asked for go to their cell's bucket
//   gather      a warp per open cell: the nearest particle in the buckets around
//
// Particles outside the grid, and those for which a bucket is full, go to all centres within their reach by
// atomics; so do all particles where the reach is longer than eight cells. That is always right and only
// slow.
//
// What bounds it: the scattered atomics of own_cells and the scattered tests of collect (L2), and two
// readings of the positions.
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <stdexcept>

#include "cases/collision_query/particle_sdf.hpp"
#include "core/contract/module.hpp"
#include "references/common/alignment.hpp"
#include "references/common/approximate.cuh"
#include "references/common/block_sum.cuh"
#include "references/common/dependent_launch.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/machine.cuh"

namespace gpuphys::particle_sdf {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int threads = 128;
  static constexpr int tile_x = 8, tile_y = 16, tile_z = 8;
#else
  static constexpr int threads = 256;
  static constexpr int tile_x = 8, tile_y = 8, tile_z = 16;
#endif
  static constexpr int most_halo = 8;  // cells of reach; no more than a tile has
  static constexpr int gather_blocks_per_sm = 8;
};
static_assert(Policy::tile_z + 2 * Policy::most_halo <= 32, "a column of a tile is a word of bits");
static_assert(Policy::tile_x >= Policy::most_halo && Policy::tile_y >= Policy::most_halo &&
              Policy::tile_z >= Policy::most_halo);

// Cells compare distances in units of dx; what rounding can do to them is far below this.
constexpr float kSlack = 0x1p-14f;

struct Geometry {
  int n[3], tiles[3];
  float dx, inverse_dx;
  float dx_high, dx_low;  // dx: 11 leading bits, whose product with a centre's number is exact, and the rest
  float r, clamp;
  float reach;  // in cells
  int halo;     // cells that this is, at most

  __device__ __forceinline__ int cell(int i, int j, int k) const { return (i * n[1] + j) * n[2] + k; }
  __device__ __forceinline__ bool inside(int i, int j, int k) const {
    return static_cast<unsigned>(i) < static_cast<unsigned>(n[0]) &&
           static_cast<unsigned>(j) < static_cast<unsigned>(n[1]) &&
           static_cast<unsigned>(k) < static_cast<unsigned>(n[2]);
  }
  /// From x to centre number i of an axis: nearly as if rounded once.
  __device__ __forceinline__ float to_centre(int i, float x) const {
    const float c = static_cast<float>(i) + 0.5f;
    return (c * dx_high - x) + c * dx_low;
  }
  /// phi of a distance whose square this is.
  __device__ __forceinline__ float phi_of(float square) const { return approximate_sqrt(square) - r; }
};

// ---- Particles ----

struct Particle {
  int cell[3];    // may lie outside the grid
  float away[3];  // from the particle to the centre of its cell
  bool near;      // enough to the grid to matter
  bool inside;    // the grid
};

__device__ __forceinline__ Particle locate(const Geometry& g, const float (&x)[3]) {
  Particle p;
  p.near = true;
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    const float t = x[d] * g.inverse_dx, margin = static_cast<float>(g.halo + 2);
    p.near = p.near && t > -margin && t < static_cast<float>(g.n[d]) + margin;
    int i = static_cast<int>(floorf(fminf(fmaxf(t, -margin), static_cast<float>(g.n[d]) + margin)));
    float away = g.to_centre(i, x[d]);
    // The quotient is rounded. The right cell is that of the nearest centre.
    if (fabsf(away) > 0.5f * g.dx) {
      i += away > 0.0f ? -1 : 1;
      away = g.to_centre(i, x[d]);
    }
    p.cell[d] = i;
    p.away[d] = away;
  }
  p.inside = p.near && g.inside(p.cell[0], p.cell[1], p.cell[2]);
  return p;
}

__device__ __forceinline__ float square_of(float a, float b, float c) {
  return a * a + b * b + c * c;
}

// Floats of one sign are in the order of their bits; among the negative ones the largest bits are least.
__device__ __forceinline__ void take_minimum(float* place, float value) {
  if (__float_as_int(value) >= 0)
    atomicMin(reinterpret_cast<int*>(place), __float_as_int(value));
  else
    atomicMax(reinterpret_cast<unsigned*>(place), __float_as_uint(value));
}

// Lowers phi at number `item` of the (2 halo + 1)^3 centres around cell (i, j, k), which holds a particle at
// x.
__device__ __forceinline__ void lower_around(const Geometry& g, int3 cell, float3 x, int item, float* phi) {
  const int width = 2 * g.halo + 1;
  const int i = cell.x - g.halo + item / (width * width), j = cell.y - g.halo + item / width % width,
            k = cell.z - g.halo + item % width;
  if (!g.inside(i, j, k)) return;
  const float v = g.phi_of(square_of(g.to_centre(i, x.x), g.to_centre(j, x.y), g.to_centre(k, x.z)));
  if (v < g.clamp) take_minimum(phi + g.cell(i, j, k), v);
}
__device__ __noinline__ void lower_all_around(const Geometry& g, int3 cell, float3 x, float* phi) {
  const int width = 2 * g.halo + 1;
  for (int item = 0; item < width * width * width; ++item) lower_around(g, cell, x, item, phi);
}

// Calls body(x) for the thread's particles, four at most. before() comes when they are under way.
template <class Before, class Body>
__device__ __forceinline__ void each_particle(const float* __restrict__ positions, int count, Before&& before,
                                              Body&& body) {
  const int first = 4 * static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float x[4][3] = {};
  if (first + 4 <= count) {
    const float4* const from = reinterpret_cast<const float4*>(positions) + 3 * (first / 4);
    const float4 a = from[0], b = from[1], c = from[2];
    const float words[12] = {a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, c.y, c.z, c.w};
#pragma unroll
    for (int w = 0; w < 12; ++w) x[w / 3][w % 3] = words[w];
  } else {
#pragma unroll
    for (int w = 0; w < 12; ++w) {
      if (first + w / 3 < count) x[w / 3][w % 3] = positions[3 * static_cast<std::int64_t>(first) + w];
    }
  }
  before();
#pragma unroll
  for (int q = 0; q < 4; ++q) {
    if (first + q < count) body(x[q]);
  }
}

// ---- Scratch memory ----

// The particles of a cell that open cells ask for.
struct alignas(128) Bucket {
  static constexpr int kSize = 10;
  float x[kSize], y[kSize], z[kSize];
  int count;  // may exceed kSize
};

struct Open {
  int cell;
  float within;  // a particle lies within so many cells of its centre, if any lies within reach
};

struct Scratch {
  unsigned char* touched;  // of each tile: holds particles
  unsigned* asked;         // a bit per cell: its particles are asked for
  int* bucket_of;          // of each cell that is asked for
  Bucket* buckets;
  int* tiles;  // listed
  Open* open;
  int* counts;       // how many: tiles, open cells, buckets
  int bucket_count;  // there is room for
};
constexpr int kTiles = 0, kOpen = 1, kBuckets = 2, kCounts = 3;

__global__ void __launch_bounds__(Policy::threads)
    fill(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s, float* phi) {
  allow_next();
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  const int cells = g.n[0] * g.n[1] * g.n[2], tiles = g.tiles[0] * g.tiles[1] * g.tiles[2];
  const float4 clamp = make_float4(g.clamp, g.clamp, g.clamp, g.clamp);
  for (int c = thread; c < cells / 4; c += stride) reinterpret_cast<float4*>(phi)[c] = clamp;
  if (thread < cells % 4) phi[cells / 4 * 4 + thread] = g.clamp;
  for (int w = thread; w < (cells + 31) / 32; w += stride) s.asked[w] = 0;
  for (int t = thread; t < tiles; t += stride) s.touched[t] = 0;
  if (thread < kCounts) s.counts[thread] = 0;
}

// Of a cell inside the grid.
__device__ __forceinline__ int tile_of(const Geometry& g, const int (&cell)[3]) {
  const unsigned i = static_cast<unsigned>(cell[0]) / Policy::tile_x,
                 j = static_cast<unsigned>(cell[1]) / Policy::tile_y,
                 k = static_cast<unsigned>(cell[2]) / Policy::tile_z;
  return (static_cast<int>(i) * g.tiles[1] + static_cast<int>(j)) * g.tiles[2] + static_cast<int>(k);
}

__global__ void __launch_bounds__(Policy::threads)
    own_cells(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s,
              const float* __restrict__ positions, int count, float* phi) {
  allow_next();
  each_particle(
      positions, count, [] { wait_for_previous(); },
      [&](const float(&x)[3]) {
        const Particle p = locate(g, x);
        if (p.inside) {
          const float v = g.phi_of(square_of(p.away[0], p.away[1], p.away[2]));
          if (!(v < g.clamp)) return;  // and all other centres are farther
          take_minimum(phi + g.cell(p.cell[0], p.cell[1], p.cell[2]), v);
          unsigned char& touched = s.touched[tile_of(g, p.cell)];
          if (touched == 0) touched = 1;  // mostly read, and found in L1
        } else if (p.near) {
          lower_all_around(g, {p.cell[0], p.cell[1], p.cell[2]}, {x[0], x[1], x[2]}, phi);
        }
      });
}

/// Appends for all threads of a warp that have `mine`: the place, or anything.
__device__ __forceinline__ int append(bool mine, int* count) {
  const unsigned who = __ballot_sync(0xffffffffu, mine);
  const int lane = static_cast<int>(threadIdx.x % 32);
  int first = 0;
  if (lane == 0 && who != 0) first = atomicAdd(count, __popc(who));
  return __shfl_sync(0xffffffffu, first, 0) + __popc(who & ((1u << lane) - 1u));
}

__global__ void __launch_bounds__(Policy::threads)
    list_tiles(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s) {
  allow_next();
  wait_for_previous();
  const int tile = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  bool near = false;
  if (tile < g.tiles[0] * g.tiles[1] * g.tiles[2]) {
    const int i = tile / g.tiles[2] / g.tiles[1], j = tile / g.tiles[2] % g.tiles[1], k = tile % g.tiles[2];
    for (int a = max(i - 1, 0); a <= min(i + 1, g.tiles[0] - 1); ++a) {
      for (int b = max(j - 1, 0); b <= min(j + 1, g.tiles[1] - 1); ++b) {
        for (int c = max(k - 1, 0); c <= min(k + 1, g.tiles[2] - 1); ++c)
          near = near || s.touched[(a * g.tiles[1] + b) * g.tiles[2] + c] != 0;
      }
    }
  }
  const int place = append(near, s.counts + kTiles);
  if (near) s.tiles[place] = tile;
}

// ---- Open cells ----

// Square of the distance, in cells, from a centre to the nearest point of the cell (a, b, c) away.
__device__ __forceinline__ float square_to_cell(int a, int b, int c) {
  return square_of(fmaxf(fabsf(static_cast<float>(a)) - 0.5f, 0.0f),
                   fmaxf(fabsf(static_cast<float>(b)) - 0.5f, 0.0f),
                   fmaxf(fabsf(static_cast<float>(c)) - 0.5f, 0.0f));
}
// A particle there may be within `within` cells.
__device__ __forceinline__ bool may_hold(int a, int b, int c, float within) {
  const float bound = within + kSlack;
  return square_to_cell(a, b, c) < bound * bound;
}

// A tile and its halo in shared memory.
struct Window {
  int size[3];  // with the halo
  float* phi;
  unsigned *occupied, *asked;  // of each column a word, a bit per cell along z

  __host__ __device__ static int columns(int halo) {
    return (Policy::tile_x + 2 * halo) * (Policy::tile_y + 2 * halo);
  }
  __host__ __device__ static int bytes(int halo) {
    return columns(halo) * (Policy::tile_z + 2 * halo + 2) * static_cast<int>(sizeof(float));
  }
  __device__ __forceinline__ Window(void* shared, int halo)
      : size{Policy::tile_x + 2 * halo, Policy::tile_y + 2 * halo, Policy::tile_z + 2 * halo} {
    occupied = static_cast<unsigned*>(shared);
    asked = occupied + columns(halo);
    phi = reinterpret_cast<float*>(asked + columns(halo));
  }

  /// Calls body(a, b, c, cell's phi) for the occupied cells (a, b, c) away from the one at (i, j, k) of the
  /// window, itself excepted.
  template <class Body>
  __device__ __forceinline__ void each_occupied(int i, int j, int k, int halo, Body&& body) const {
    const unsigned range = 2u * static_cast<unsigned>(halo) + 1u;  // at most 17
    for (int a = -halo; a <= halo; ++a) {
      for (int b = -halo; b <= halo; ++b) {
        const int column = (i + a) * size[1] + j + b;
        unsigned bits = occupied[column] >> (k - halo) & ((1u << range) - 1u);
        if (a == 0 && b == 0) bits &= ~(1u << halo);
        for (; bits != 0; bits &= bits - 1) {
          const int c = __ffs(static_cast<int>(bits)) - 1 - halo;
          body(a, b, c, phi[column * size[2] + k + c]);
        }
      }
    }
  }
};

// One after the other: the tiles of the list.
__global__ void __launch_bounds__(Policy::threads)
    classify(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s, const float* phi) {
  constexpr int cells = Policy::tile_x * Policy::tile_y * Policy::tile_z;
  constexpr int each = cells / Policy::threads;
  static_assert(cells % Policy::threads == 0);
  extern __shared__ float4 dynamic_shared[];
  __shared__ int warps[2][Policy::threads / 32], first_open, first_bucket;
  allow_next();
  wait_for_previous();
  const Window w(dynamic_shared, g.halo);
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32;
  const int columns = w.size[0] * w.size[1], tiles = s.counts[kTiles];
  for (int t = static_cast<int>(blockIdx.x); t < tiles; t += static_cast<int>(gridDim.x)) {
    const int tile = s.tiles[t];
    const int low[3] = {tile / g.tiles[2] / g.tiles[1] * Policy::tile_x - g.halo,
                        tile / g.tiles[2] % g.tiles[1] * Policy::tile_y - g.halo,
                        tile % g.tiles[2] * Policy::tile_z - g.halo};
    // A warp per column.
    for (int column = thread / 32; column < columns; column += Policy::threads / 32) {
      const int i = low[0] + column / w.size[1], j = low[1] + column % w.size[1], k = low[2] + lane;
      float v = g.clamp;
      if (lane < w.size[2] && g.inside(i, j, k)) v = phi[g.cell(i, j, k)];
      if (lane < w.size[2]) w.phi[column * w.size[2] + lane] = v;
      const unsigned bits = __ballot_sync(0xffffffffu, v < g.clamp);
      if (lane == 0) w.occupied[column] = bits, w.asked[column] = 0;
    }
    __syncthreads();

    Open open[each];
    unsigned is_open = 0;
#pragma unroll
    for (int e = 0; e < each; ++e) {
      const int item = thread + e * Policy::threads;
      const int i = g.halo + item / Policy::tile_z / Policy::tile_y,
                j = g.halo + item / Policy::tile_z % Policy::tile_y, k = g.halo + item % Policy::tile_z;
      if (!g.inside(low[0] + i, low[1] + j, low[2] + k)) continue;
      const float own = w.phi[(i * w.size[1] + j) * w.size[2] + k];
      float within = own < g.clamp ? (own + g.r) * g.inverse_dx : g.reach;
      if (within < 0.5f - kSlack) continue;
      w.each_occupied(i, j, k, g.halo, [&](int a, int b, int c, float there) {
        const float away = approximate_sqrt(static_cast<float>(a * a + b * b + c * c));
        within = fminf(within, away + (there + g.r) * g.inverse_dx);
      });
      bool any = false;
      w.each_occupied(i, j, k, g.halo, [&](int a, int b, int c, float) {
        if (!may_hold(a, b, c, within)) return;
        any = true;
        atomicOr(w.asked + (i + a) * w.size[1] + j + b, 1u << (k + c));
      });
      open[e] = {g.cell(low[0] + i, low[1] + j, low[2] + k), within};
      is_open |= any ? 1u << e : 0u;
    }
    __syncthreads();

    // Cells that no other tile has asked for get a bucket.
    int fresh = 0;
    for (int column = thread; column < columns; column += Policy::threads) {
      unsigned news = 0;
      for (unsigned bits = w.asked[column]; bits != 0; bits &= bits - 1) {
        const int k = __ffs(static_cast<int>(bits)) - 1;
        const int cell = g.cell(low[0] + column / w.size[1], low[1] + column % w.size[1], low[2] + k);
        const unsigned bit = 1u << cell % 32;
        if ((atomicOr(s.asked + cell / 32, bit) & bit) == 0) news |= 1u << k;
      }
      w.asked[column] = news;  // the thread's own
      fresh += __popc(news);
    }
    const int opens = __popc(is_open);
    int bucket = sum_before<Policy::threads>(fresh, warps[0]);
    int place = sum_before<Policy::threads>(opens, warps[1]);
    if (thread == Policy::threads - 1) {
      first_bucket = bucket + fresh > 0 ? atomicAdd(s.counts + kBuckets, bucket + fresh) : 0;
      first_open = place + opens > 0 ? atomicAdd(s.counts + kOpen, place + opens) : 0;
    }
    __syncthreads();
    bucket += first_bucket;
    place += first_open;
    for (int column = thread; column < columns; column += Policy::threads) {
      for (unsigned bits = w.asked[column]; bits != 0; bits &= bits - 1) {
        const int k = __ffs(static_cast<int>(bits)) - 1;
        s.bucket_of[g.cell(low[0] + column / w.size[1], low[1] + column % w.size[1], low[2] + k)] = bucket;
        if (bucket < s.bucket_count) s.buckets[bucket].count = 0;
        ++bucket;
      }
    }
#pragma unroll
    for (int e = 0; e < each; ++e) {
      if ((is_open >> e & 1u) != 0) s.open[place++] = open[e];
    }
    __syncthreads();
  }
}

__global__ void __launch_bounds__(Policy::threads)
    collect(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s,
            const float* __restrict__ positions, int count, float* phi) {
  allow_next();
  each_particle(
      positions, count, [] { wait_for_previous(); },
      [&](const float(&x)[3]) {
        const Particle p = locate(g, x);
        if (!p.inside) return;
        const int cell = g.cell(p.cell[0], p.cell[1], p.cell[2]);
        if ((s.asked[cell / 32] >> cell % 32 & 1u) == 0) return;
        const int bucket = s.bucket_of[cell];
        if (bucket < s.bucket_count) {
          Bucket& own = s.buckets[bucket];
          const int slot = atomicAdd(&own.count, 1);
          if (slot < Bucket::kSize) {
            own.x[slot] = x[0];
            own.y[slot] = x[1];
            own.z[slot] = x[2];
            return;
          }
        }
        lower_all_around(g, {p.cell[0], p.cell[1], p.cell[2]}, {x[0], x[1], x[2]}, phi);
      });
}

// A warp after the other: the open cells.
__global__ void __launch_bounds__(Policy::threads)
    gather(const __grid_constant__ Geometry g, const __grid_constant__ Scratch s, float* phi) {
  constexpr unsigned all = 0xffffffffu;
  constexpr int at_once = 32 / Bucket::kSize;
  allow_next();
  wait_for_previous();
  const int lane = static_cast<int>(threadIdx.x % 32);
  const int first = static_cast<int>((blockIdx.x * blockDim.x + threadIdx.x) / 32);
  const int stride = static_cast<int>(gridDim.x * blockDim.x / 32), opens = s.counts[kOpen];
  Open next{};
  if (first < opens) next = s.open[first];
  for (int o = first; o < opens; o += stride) {
    const Open open = next;
    next = s.open[min(o + stride, opens - 1)];
    const int i = open.cell / g.n[2] / g.n[1], j = open.cell / g.n[2] % g.n[1], k = open.cell % g.n[2];
    const int halo = min(g.halo, static_cast<int>(open.within + 0.5f + kSlack)), width = 2 * halo + 1;
    float least = __int_as_float(0x7f800000);
    for (int from = 0; from < width * width * width; from += 32) {
      // A cell per lane.
      const int item = from + lane;
      const int a = item / (width * width) - halo, b = item / width % width - halo, c = item % width - halo;
      int bucket = -1, size = 0;
      if (a <= halo && g.inside(i + a, j + b, k + c) && may_hold(a, b, c, open.within)) {
        const int cell = g.cell(i + a, j + b, k + c);
        if ((s.asked[cell / 32] >> cell % 32 & 1u) != 0) bucket = s.bucket_of[cell];
        if (bucket >= s.bucket_count) bucket = -1;
        if (bucket >= 0) size = min(s.buckets[bucket].count, Bucket::kSize);
      }
      // A particle per lane.
      unsigned cells = __ballot_sync(all, size > 0);
      while (cells != 0) {
        int source = 0;
#pragma unroll
        for (int q = 0; q < at_once; ++q) {
          if (lane / Bucket::kSize == q) source = cells != 0 ? __ffs(static_cast<int>(cells)) - 1 : -1;
          cells &= cells - 1;
        }
        const int held = __shfl_sync(all, size, max(source, 0)),
                  at = __shfl_sync(all, bucket, max(source, 0));
        const int slot = lane % Bucket::kSize;
        if (source >= 0 && lane < at_once * Bucket::kSize && slot < held) {
          const Bucket& there = s.buckets[at];
          least = fminf(least, square_of(g.to_centre(i, there.x[slot]), g.to_centre(j, there.y[slot]),
                                         g.to_centre(k, there.z[slot])));
        }
      }
    }
    least = __uint_as_float(__reduce_min_sync(all, __float_as_uint(least)));
    if (lane == 0) phi[open.cell] = fminf(phi[open.cell], g.phi_of(least));
  }
}

// A block per particle, for reaches beyond the halo of a tile.
__global__ void __launch_bounds__(Policy::threads)
    scatter_far(const __grid_constant__ Geometry g, const float* __restrict__ positions, int count,
                float* phi) {
  allow_next();
  wait_for_previous();
  const int width = 2 * g.halo + 1;
  for (int q = static_cast<int>(blockIdx.x); q < count; q += static_cast<int>(gridDim.x)) {
    const float* const own = positions + 3 * static_cast<std::int64_t>(q);
    const float x[3] = {own[0], own[1], own[2]};
    const Particle p = locate(g, x);
    if (!p.near) continue;
    for (int item = static_cast<int>(threadIdx.x); item < width * width * width; item += Policy::threads)
      lower_around(g, {p.cell[0], p.cell[1], p.cell[2]}, {x[0], x[1], x[2]}, item, phi);
  }
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0];
    const double size = static_cast<double>(in.nx) * in.ny * in.nz;
    if (n > (1 << 29)) throw std::runtime_error("particle_sdf: more than 2^29 particles");
    if (size >= 2147483648.0 || in.nx < 1 || in.ny < 1 || in.nz < 1)
      throw std::runtime_error("particle_sdf: the grid must have 1 to 2^31 - 1 cells");
    g_.n[0] = in.nx, g_.n[1] = in.ny, g_.n[2] = in.nz;
    const int edge[3] = {Policy::tile_x, Policy::tile_y, Policy::tile_z};
    for (int d = 0; d < 3; ++d) g_.tiles[d] = (g_.n[d] + edge[d] - 1) / edge[d];
    g_.dx = in.dx, g_.r = in.r, g_.clamp = in.clamp;
    g_.inverse_dx = 1.0f / in.dx;
    std::uint32_t bits;
    std::memcpy(&bits, &in.dx, sizeof bits);
    bits &= ~0x1fffu;
    std::memcpy(&g_.dx_high, &bits, sizeof bits);
    g_.dx_low = in.dx - g_.dx_high;
    g_.reach = (in.r + in.clamp) / in.dx;
    if (!(g_.reach >= 0.0f && g_.reach <= 64.01f))
      throw std::runtime_error("particle_sdf: r + clamp must be between 0 and 64 dx");
    g_.halo = static_cast<int>(g_.reach + 0.5f + kSlack);

    const auto cells = static_cast<std::size_t>(size);
    const auto tiles = static_cast<std::size_t>(tile_count());
    // Cells that hold particles at most; mostly few are asked for.
    s_.bucket_count = static_cast<int>(std::min<std::int64_t>(n, 65536 + n / 4));
    touched_ = DeviceBuffer<unsigned char>(tiles);
    asked_ = DeviceBuffer<unsigned>((cells + 31) / 32);
    bucket_of_ = DeviceBuffer<int>(cells);
    buckets_ = DeviceBuffer<Bucket>(static_cast<std::size_t>(s_.bucket_count));
    tiles_ = DeviceBuffer<int>(tiles);
    open_ = DeviceBuffer<Open>(cells);
    counts_ = DeviceBuffer<int>(kCounts);
    s_.touched = touched_.get(), s_.asked = asked_.get(), s_.bucket_of = bucket_of_.get();
    s_.buckets = buckets_.get(), s_.tiles = tiles_.get(), s_.open = open_.get(), s_.counts = counts_.get();
    processors_ = multiprocessors();
    GPUPHYS_CUDA(cudaFuncSetAttribute(classify, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      Window::bytes(Policy::most_halo)));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("particle_sdf", "x", in.x.data);
    require_aligned("particle_sdf", "phi", out.phi.data);
    constexpr int threads = Policy::threads;
    const auto blocks = [](std::int64_t items) {
      return static_cast<unsigned>((items + threads - 1) / threads);
    };
    const int count = static_cast<int>(in.x.shape[0]);
    float* const phi = out.phi.data;
    const auto wave = static_cast<unsigned>(processors_ * 8);
    fill<<<std::min(blocks(out.phi.size() / 4 + 1), wave), threads>>>(g_, s_, phi);
    if (g_.halo > Policy::most_halo) {
      launch_dependent(scatter_far, std::min(static_cast<unsigned>(count), 16 * wave), threads, 0, g_,
                       in.x.data, count, phi);
      return;
    }
    const unsigned particles = blocks((count + 3) / 4);
    launch_dependent(own_cells, particles, threads, 0, g_, s_, in.x.data, count, phi);
    launch_dependent(list_tiles, blocks(tile_count()), threads, 0, g_, s_);
    launch_dependent(classify, static_cast<unsigned>(std::min<std::int64_t>(tile_count(), wave)), threads,
                     static_cast<std::size_t>(Window::bytes(g_.halo)), g_, s_, phi);
    launch_dependent(collect, particles, threads, 0, g_, s_, in.x.data, count, phi);
    launch_dependent(gather, static_cast<unsigned>(processors_ * Policy::gather_blocks_per_sm), threads, 0,
                     g_, s_, phi);
  }

 private:
  std::int64_t tile_count() const { return std::int64_t{g_.tiles[0]} * g_.tiles[1] * g_.tiles[2]; }

  Geometry g_{};
  Scratch s_{};
  int processors_ = 1;
  DeviceBuffer<unsigned char> touched_;
  DeviceBuffer<unsigned> asked_;
  DeviceBuffer<int> bucket_of_, tiles_, counts_;
  DeviceBuffer<Bucket> buckets_;
  DeviceBuffer<Open> open_;
};

}  // namespace
}  // namespace gpuphys::particle_sdf

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(particle_sdf, particle_sdf::Reference)
}
