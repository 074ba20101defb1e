// The neighbours of fluid particles: sorted once by the cells of a grid, found again after each move, and
// kept in a list for those sweeps that see the same positions.
//
// A particle of the paper's sets has 33 neighbours among 180 candidates in nine columns of cells. What a
// sweep does with a neighbour costs some 30 instructions, so candidates are told apart by four:
//
//   places    Positions as integers, in units of at most 2^-23 h, modulo 2^32: differences are exact wherever
//             the fluid is, and a particle that moves is one load of 16 bytes, with a word to spare.
//   codes     Eight bits of each coordinate, about 1/64 of h a step, in four bytes:   | -z | -y | -x | 0 |
//   candidate load the code, add one's own numbers, dot product with itself (dp4a), shift in the sign:
//             0 0 1 1 0 1 ...   a word of bits per column, the hits; may hold a few too many, never too few
//   queue     words that are not empty wait in shared memory, until all columns are searched
//   sweep     over the queue, so that the lanes of a warp, with 33 +- 4 neighbours each, are mostly busy
//
// Exact distances decide what a hit is worth: all kernels are zero from h on. They come from differences of
// the input where nothing moves, of places where particles do. (Where cells had to be made so wide that
// places of candidates may wrap around, from x and shift, two loads.)
//
// x stays as it came; shift is what was moved since, and is added at the end. Sorting again costs a third of
// a search. A search in the old order instead would have to reach further by how far anybody has moved since,
// half of h in five iterations: thrice the candidates.
#pragma once

#include <cuda_runtime.h>

#include <cmath>
#include <cstddef>

#include "references/blocks/neighbour_grid.cuh"
#include "references/common/machine.cuh"

namespace gpuphys::fluid {

#ifdef GPUPHYS_OTHER_BLOCKS
struct GridPolicy : neighbour_grid::DefaultPolicy {
  static constexpr int bounds_threads = 256;
  static constexpr int split_threads = 128;
  static constexpr int split_each = 2;
  static constexpr int split_blocks_per_sm = 8;
  static constexpr int bin_cells = 128;
  static constexpr int bin_items = 640;
  static constexpr int bin_threads = 128;
  static constexpr int bin_blocks_per_sm = 8;
  static constexpr int z_cells = 1;
};
struct Policy {
  static constexpr int threads = 64;
  static constexpr int blocks_per_sm = 8;
  static constexpr int reading_blocks_per_sm = 12;
  static constexpr int first_candidates = 8;
  static constexpr int candidates_per_look = 2;
  static constexpr int longest_run = 16;
  static constexpr int queue_entries = 5;
  static constexpr int listed = 24;
};
#else
struct GridPolicy : neighbour_grid::DefaultPolicy {
  static constexpr int bin_cells = 320;  // of 4 particles each
  static constexpr float cells_per_item = 0.5f;
};
struct Policy {
  static constexpr int threads = 128;
  static constexpr int blocks_per_sm = 7;
  static constexpr int reading_blocks_per_sm = 9;  // of sweeps that read lists
  static constexpr int first_candidates = 16;      // of a column, before the first look at its length
  static constexpr int candidates_per_look = 4;    // and from then on
  static constexpr int longest_run = 32;           // of a queue entry: its bits
  static constexpr int queue_entries = 16;
  static constexpr int listed = 64;  // hits of a particle that its list has room for
};
#endif
static_assert(Policy::longest_run <= 32 &&
              (Policy::longest_run - Policy::first_candidates) % Policy::candidates_per_look == 0);
static_assert(Policy::queue_entries >= neighbour_grid::kColumns && Policy::threads % 32 == 0);

/// Codes behind the last particle's: they may be read, but are nobody's.
constexpr int padding = Policy::first_candidates > Policy::candidates_per_look ? Policy::first_candidates
                                                                               : Policy::candidates_per_look;

// ---- Places and codes ----

/// Units of length: h is between 2^23 and 2^24 of places' units, and between 42 and 84 steps of a code's.
struct Units {
  float per_metre;  // units of a place, a power of two: the product with a float32 is exact
  int step;         // of a code: 2^step units
};
inline Units units_of(float h) {
  int exponent = 0;
  const float fraction = std::frexp(h, &exponent);  // in [1/2, 1)
  if (fraction == 0.5f) --exponent;                 // h = 2^exponent, or less
  const float per_metre = std::ldexp(1.0f, 24 - exponent);
  return {per_metre, h * per_metre > 84 * 0x1p17f ? 18 : 17};
}

/// A coordinate and a displacement in units, each rounded once, modulo 2^32.
__device__ __forceinline__ int place_along(const Units& units, float x, float shift) {
  return static_cast<int>(__float2ll_rn(x * units.per_metre) + __float2ll_rn(shift * units.per_metre));
}
__device__ __forceinline__ int4 place_of(const Units& units, const float4& x, const float4& shift) {
  return make_int4(place_along(units, x.x, shift.x), place_along(units, x.y, shift.y),
                   place_along(units, x.z, shift.z), 0);
}

/// Differences of codes wrap at 256 steps, 3 h or more: beyond what a search meets, and otherwise they may
/// only let pass too many.
__device__ __forceinline__ unsigned code_of(const Units& units, const int4& place) {
  const unsigned x = static_cast<unsigned>(place.x >> units.step);
  const unsigned y = static_cast<unsigned>(place.y >> units.step);
  const unsigned z = static_cast<unsigned>(place.z >> units.step);
  return (0u - x) % 256u << 8 | (0u - y) % 256u << 16 | (0u - z) << 24;
}

/// What is added to a candidate's code. The sum holds differences to within a step for x and 1.5 for y and z,
/// into which the byte below may carry; the halves centre that.
__device__ __forceinline__ unsigned probe_of(const Units& units, const int4& place) {
  const int half = 1 << units.step >> 1;
  const unsigned x = static_cast<unsigned>(place.x >> units.step);
  const unsigned y = (static_cast<unsigned>(place.y) - static_cast<unsigned>(half)) >> units.step;
  const unsigned z = (static_cast<unsigned>(place.z) - static_cast<unsigned>(half)) >> units.step;
  return x % 256u << 8 | y % 256u << 16 | z << 24;
}

/// What the dot product of a true neighbour stays below: sqrt(1 + 1.5^2 + 1.5^2) steps of rounding down.
__device__ __forceinline__ int code_bound(const Units& units, float h) {
  const float steps = h * units.per_metre / static_cast<float>(1 << units.step) + 2.35f;
  return static_cast<int>(steps * steps * 1.00001f) + 1;
}

// ---- Sorting ----

struct alignas(32) Particle {
  float4 x;      // position in the input, index there as bits
  float4 other;  // velocity or displacement
};

/// What becomes the second half of a sorted particle.
enum class With {
  nothing,   // zeroes
  velocity,  // v
  step       // dt (v + dt g); the cell is that of the position it leads to
};

/// Particles that were sorted before, in that order.
struct Before {
  const float4* x;
  const float4* shift;
};

/// A Source for the neighbour grid (neighbour_grid.cuh): the input or, where before.x is not null, particles
/// that were sorted before and have moved.
template <With with>
struct Particles {
  using Record = Particle;
  const float* __restrict__ x;
  const float* __restrict__ v;    // not read With::nothing
  const float* __restrict__ now;  // where they are, x, y, z: for the box
  Before before;
  float h, dt;
  float3 g;
  Units units;
  Particle* __restrict__ split;
  float4* __restrict__ sorted;
  unsigned* __restrict__ codes;
  int4* __restrict__ places;  // not written With::velocity
  int count;

  __device__ __forceinline__ const float* positions() const { return now; }
  __device__ __forceinline__ float radius() const { return 0.5f * h; }
  static constexpr int chunk_v = 3 * 32, chunk_floats = with == With::nothing ? chunk_v : 2 * chunk_v;
  __device__ __forceinline__ void prefetch(float* chunk, int first, int end) const {
    if (before.x != nullptr) return;
    const unsigned lane = threadIdx.x % 32, last = 3u * static_cast<unsigned>(end);
    constexpr unsigned piece_v = chunk_v / 4, pieces = chunk_floats / 4;
#pragma unroll
    for (unsigned part = 0; part < (pieces + 31) / 32; ++part) {
      const unsigned piece = lane + 32u * part;
      const float* const array = piece < piece_v ? x : v;
      const unsigned word =
          3u * static_cast<unsigned>(first) + 4u * (piece < piece_v ? piece : piece - piece_v);
      const unsigned bytes = word < last ? min(4u * (last - word), 16u) : 0u;
      if (piece < pieces) copy_async(chunk + 4u * piece, array + (bytes > 0u ? word : 0u), bytes);
    }
  }
  __device__ __forceinline__ Particle record(const float* chunk, int i) const {
    if (before.x != nullptr) {
      const int slot = min(i, count - 1);
      return {before.x[slot], before.shift[slot]};
    }
    const float* const own = chunk + 3u * (threadIdx.x % 32);
    Particle p{make_float4(own[0], own[1], own[2], __int_as_float(i)), make_float4(0, 0, 0, 0)};
    if constexpr (with != With::nothing)
      p.other = make_float4(own[chunk_v], own[chunk_v + 1], own[chunk_v + 2], 0);
    if constexpr (with == With::step) {
      p.other.x = dt * (p.other.x + dt * g.x);
      p.other.y = dt * (p.other.y + dt * g.y);
      p.other.z = dt * (p.other.z + dt * g.z);
    }
    return p;
  }
  // Not to be contracted with what a kernel knows of the displacement: both sorts must agree.
  __device__ __forceinline__ float3 position(const Particle& p) const {
    if constexpr (with == With::velocity) return {p.x.x, p.x.y, p.x.z};
    return {__fadd_rn(p.x.x, p.other.x), __fadd_rn(p.x.y, p.other.y), __fadd_rn(p.x.z, p.other.z)};
  }
  __device__ __forceinline__ void placed(const neighbour_grid::Grid&, int slot, const Particle& p) const {
    const float4 still = make_float4(0, 0, 0, 0);
    const int4 place = place_of(units, p.x, with == With::velocity ? still : p.other);
    codes[slot] = code_of(units, place);
    if constexpr (with != With::velocity) places[slot] = place;
    if (slot > 0) return;
#pragma unroll 1
    for (int k = 0; k < padding; ++k) codes[count + k] = 0;
  }
};

// ---- Searching ----

/// What a sweep knows of the fluid. Arrays are in the order of slots.
struct Fluid {
  const neighbour_grid::Grid* grid;
  const int* start;
  const float4* x;        // and the index in the input as bits
  const float4* shift;    // not read where nothing moves, as are
  const int4* places;     // where the particles are now, and a word (lambda)
  const unsigned* codes;  // of where they are now
  int* hits;              // lists: number k of slot s is hits[k * count + s]
  int* hit_count;         // of each slot; a list with more than Policy::listed is of no use
  int count;
  Units units;
  float h;
  float inverse_h, inverse_square;  // 1 / h, 1 / h^2, in the unit of the pairs' distances
};

enum class Lists { unused, written, read };

/// Memory of a block for the search; little where lists are read, and searching is the exception.
template <Lists lists>
struct Queue {
  static constexpr int kEntries = lists == Lists::read ? neighbour_grid::kColumns : Policy::queue_entries;
  int2 entries[kEntries * Policy::threads];
};

/// a - b, modulo 2^32.
__device__ __forceinline__ int difference(int a, int b) {
  return static_cast<int>(static_cast<unsigned>(a) - static_cast<unsigned>(b));
}

/// A particle and another one: from the other to this one, and its squared length. In metres where nothing
/// moves, otherwise in units of places.
struct Pair {
  float3 d;
  float square;
};

/// Whether places of candidates may be too far apart for a difference modulo 2^32: 256 h or more.
__device__ __forceinline__ bool wraps(const Fluid& f) {
  float widest = 0.0f;
#pragma unroll
  for (int d = 0; d < 3; ++d) widest = fmaxf(widest, 1.0f / f.grid->inverse_edge[d]);
  return !(widest < 100.0f * f.h);
}

/// Calls meet(slot of another particle, Pair, the fourth word of its place) for all particles within h of the
/// one in `slot`, itself, and a few that are further away. `moves`: positions have shifts and places.
template <bool moves, Lists lists, class Meet>
__device__ __forceinline__ void for_each_neighbour(const Fluid& f, Queue<lists>& queue, int slot, bool writes,
                                                   Meet&& meet) {
  const int thread = static_cast<int>(threadIdx.x);
  const float4 x = f.x[slot];
  int4 place;
  bool wide = false;
  if constexpr (moves) {
    place = f.places[slot];
    wide = wraps(f);
  }
  const auto visit = [&](int j) {
    Pair pair;
    float word = 0.0f;
    if constexpr (moves) {
      const int4 other = f.places[j];
      word = __int_as_float(other.w);
      pair.d = {static_cast<float>(difference(place.x, other.x)),
                static_cast<float>(difference(place.y, other.y)),
                static_cast<float>(difference(place.z, other.z))};
      if (wide) {
        const float4 own_shift = f.shift[slot], x_other = f.x[j], shift_other = f.shift[j];
        pair.d.x = (x.x - x_other.x + (own_shift.x - shift_other.x)) * f.units.per_metre;
        pair.d.y = (x.y - x_other.y + (own_shift.y - shift_other.y)) * f.units.per_metre;
        pair.d.z = (x.z - x_other.z + (own_shift.z - shift_other.z)) * f.units.per_metre;
      }
    } else {
      const float4 other = f.x[j];
      pair.d = {x.x - other.x, x.y - other.y, x.z - other.z};
    }
    pair.square = pair.d.x * pair.d.x + pair.d.y * pair.d.y + pair.d.z * pair.d.z;
    meet(j, pair, word);
  };

  const auto stride = static_cast<std::size_t>(f.count);
  if constexpr (lists == Lists::read) {
    const int met = f.hit_count[slot];
    if (met <= Policy::listed) {
      const int* next = f.hits + slot;
      int j = met > 0 ? *next : 0;
#pragma unroll 1
      for (int k = 1; k <= met; ++k) {
        next += stride;
        const int following = k < met ? *next : 0;  // under way while the pair is worked on
        visit(j);
        j = following;
      }
      return;
    }
  }

  const neighbour_grid::Grid& grid = *f.grid;
  float3 now{x.x, x.y, x.z};
  if constexpr (moves) {
    const float4 shift = f.shift[slot];
    now = {x.x + shift.x, x.y + shift.y, x.z + shift.z};
  } else {
    place = place_of(f.units, x, make_float4(0, 0, 0, 0));
  }
  const unsigned probe = probe_of(f.units, place);
  const int bound = code_bound(f.units, f.h);

  int top = 0;
  [[maybe_unused]] int met = 0;
  [[maybe_unused]] int* list = f.hits + slot;
  // One loop over the hits of all columns: in a loop per column, lanes would wait for each other in each.
  const auto sweep = [&] {
    int entry = 0;
    int2 run{0, 0};
#pragma unroll 1
    for (;;) {
      if (run.y == 0) {
        if (entry == top) break;
        run = queue.entries[entry++ * Policy::threads + thread];
      }
      const int bit = highest_bit(run.y);
      run.y ^= 1 << bit;
      const int j = run.x - 1 - bit;
      if constexpr (lists == Lists::written) {
        if (met < Policy::listed && writes) *list = j;
        list += stride;
        ++met;
      }
      visit(j);
    }
    top = 0;
  };
  const auto test = [&](unsigned bits, unsigned code) {
    const int bytes = static_cast<int>(probe + code);
    return __funnelshift_l(static_cast<unsigned>(__dp4a(bytes, bytes, -bound)), bits, 1);
  };
  const auto make_room = [&] {
    if (top > Queue<lists>::kEntries - neighbour_grid::kColumns) sweep();
  };
  const auto search = [&](const neighbour_grid::Ranges& ranges) {
    unsigned bits[neighbour_grid::kColumns];
#pragma unroll
    for (int c = 0; c < neighbour_grid::kColumns; ++c) {
      bits[c] = 0;
      const unsigned* const from = f.codes + ranges.begin[c];
#pragma unroll
      for (int k = 0; k < Policy::first_candidates; ++k) bits[c] = test(bits[c], from[k]);
    }
#pragma unroll
    for (int c = 0; c < neighbour_grid::kColumns; ++c) {
      const unsigned* const from = f.codes + ranges.begin[c];
      const int length = ranges.end[c] - ranges.begin[c];
      int tested = Policy::first_candidates;
#pragma unroll 1
      for (; tested < length; tested += Policy::candidates_per_look) {
#pragma unroll
        for (int k = 0; k < Policy::candidates_per_look; ++k) bits[c] = test(bits[c], from[tested + k]);
      }
      // What lies behind the range is shifted out. The lowest bit stands for the range's last slot.
      bits[c] >>= tested - length;
      queue.entries[top * Policy::threads + thread] = make_int2(ranges.end[c], static_cast<int>(bits[c]));
      if (bits[c] != 0) ++top;
    }
  };
  float cutoff = f.h * 1.00001f;
  // Cells are those of x + shift as rounded.
  if constexpr (moves) cutoff += fmaxf(fmaxf(fabsf(now.x), fabsf(now.y)), fabsf(now.z)) * 0x1p-22f;
  neighbour_grid::visit_ranges<Policy::longest_run>(grid, f.start, now, cutoff, make_room, search);
  sweep();
  if constexpr (lists == Lists::written) {
    if (writes) f.hit_count[slot] = met;
  }
}

}  // namespace gpuphys::fluid
