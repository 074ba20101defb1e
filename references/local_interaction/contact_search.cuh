// The search for the contacts of a grain, by a thread each in the order of cells.
//
// Search and force are apart: hits are queued in shared memory as bits, a column per entry, and the force
// runs over the queues with most lanes busy. Evaluated inside the search, nearly every candidate would drag
// its warp through the force. Nor does the search keep what only the force needs in registers: they limit the
// warps of an SM.
#pragma once

#include <cuda_runtime.h>

#include <type_traits>

#include "references/blocks/neighbour_grid.cuh"
#include "references/common/machine.cuh"
#include "references/local_interaction/grain_sort.cuh"

namespace gpuphys::granular {

#ifdef GPUPHYS_OTHER_BLOCKS
struct SearchPolicy {
  static constexpr int at_once = 2;
  static constexpr int more = 1;
  static constexpr int run = 4;
  static constexpr int queue = 3;
};
#else
struct SearchPolicy {
  static constexpr int at_once = 6;  // candidates tested before the first look at a range's length
  static constexpr int more = 3;     // and between two looks
  static constexpr int run = 30;     // of one queue entry: at_once and a multiple of `more`; at most 32
  static constexpr int queue = 8;  // columns with hits a grain may have before they are evaluated in between
};
#endif

static_assert(SearchPolicy::run <= 32 &&
              (SearchPolicy::run - SearchPolicy::at_once) % SearchPolicy::more == 0);
static_assert(SearchPolicy::queue >= neighbour_grid::kColumns);
static_assert(kPadding >= SearchPolicy::at_once && kPadding >= SearchPolicy::more);

// 1 << k, and 0 for any k outside [0, 32).
__device__ __forceinline__ unsigned bit_or_none(int k) {
  return __funnelshift_lc(0u, 1u, static_cast<unsigned>(k));
}

/// The slots of candidates that may touch, from the thread's queue.
template <int Threads>
struct Hits {
  static constexpr unsigned stride = Threads * sizeof(int2);

  SharedAddress mine;
  unsigned top;
  unsigned entry = 0;
  int2 run{0, 0};

  __device__ __forceinline__ bool more() {
    if (run.y == 0 && entry != top) {
      run = load_shared(mine + entry);
      entry += stride;
    }
    return run.y != 0;
  }
  /// After more().
  __device__ __forceinline__ int take() {
    const int bit = highest_bit(run.y);
    run.y ^= 1 << bit;
    return run.x - 1 - bit;
  }
};

/// Calls evaluate(std::false_type, hits) when the queue is nearly full, and at last evaluate(std::true_type,
/// hits): together they hold every grain that touches the one of `slot`, and others that do not; perhaps the
/// grain itself. `queue` is the block's: SearchPolicy::queue * Threads entries.
template <int Threads, class Evaluate>
__device__ __forceinline__ void search_contacts(const neighbour_grid::Grid& grid, const int* start,
                                                const unsigned* codes, const float4& sphere, int slot,
                                                int2* queue, Evaluate&& evaluate) {
  using Policy = SearchPolicy;
  constexpr int columns = neighbour_grid::kColumns;
  const unsigned probe = probe_of(grid, sphere);
  const int bound = code_bound(grid, sphere.w);
  // Candidates of a column with hits: the slot behind the last one, and a bit per hit. Entries thread, thread
  // + threads, ... of the queue are this thread's own; `top` is the next free one.
  constexpr unsigned stride = Hits<Threads>::stride;
  const SharedAddress mine = shared_address(queue + threadIdx.x);
  unsigned top = 0;
  // Shifts in whether a candidate may touch, as the lowest bit: the sign of a difference.
  const auto test = [&](unsigned hits, unsigned code) {
    const int bytes = static_cast<int>(probe + code);
    return __funnelshift_l(static_cast<unsigned>(__dp4a(bytes, bytes, -bound)), hits, 1);
  };
  const auto make_room = [&] {
    if (top > (Policy::queue - columns) * stride) {
      Hits<Threads> hits{mine, top};
      evaluate(std::false_type{}, hits);
      top = 0;
    }
  };
  const auto search = [&](const neighbour_grid::Ranges& ranges) {
    // Nearly every step is one that some lane of the warp needs.
    unsigned hits[columns];
#pragma unroll
    for (int c = 0; c < columns; ++c) {
      hits[c] = 0;
      const unsigned* const from = codes + ranges.begin[c];
#pragma unroll
      for (int k = 0; k < Policy::at_once; ++k) hits[c] = test(hits[c], from[k]);
    }
#pragma unroll
    for (int c = 0; c < columns; ++c) {
      const unsigned* const from = codes + ranges.begin[c];
      const int length = ranges.end[c] - ranges.begin[c];
      int tested = Policy::at_once;
#pragma unroll 1
      for (; tested < length; tested += Policy::more) {
#pragma unroll
        for (int k = 0; k < Policy::more; ++k) hits[c] = test(hits[c], from[tested + k]);
      }
      // What lies behind the range is shifted out. The lowest bit stands for the range's last slot.
      hits[c] >>= tested - length;
      // The grain itself is mostly in the middle one. Met elsewhere, it is a hit without a force.
      if (c == columns / 2) hits[c] &= ~bit_or_none(ranges.end[c] - 1 - slot);
      store_shared(mine + top, make_int2(ranges.end[c], static_cast<int>(hits[c])));
      if (hits[c] != 0) top += stride;
    }
  };
  // Wider than any pair that passes the test: its sum of radii is rounded, and so is the squared distance.
  const float cutoff = (sphere.w + grid.largest) * 1.00001f;
  neighbour_grid::visit_ranges<Policy::run>(grid, start, {sphere.x, sphere.y, sphere.z}, cutoff, make_room,
                                            search);
  Hits<Threads> hits{mine, top};
  evaluate(std::true_type{}, hits);
}

/// Writes three words per grain to result[3 index ...], by all lanes of a warp: word by word side by side, so
/// that a grain costs one or two sectors instead of three requests. `index` < 0: nothing. `staged` is the
/// block's: 3 floats per thread.
__device__ __forceinline__ void scatter_vectors(float* result, int index, const float3& value,
                                                float* staged) {
  // Lane l of the warp writes words l, l + 32 and l + 64 of the warp's 96.
  const int thread = static_cast<int>(threadIdx.x), lane = thread % 32;
  float* const words = staged + 3 * (thread - lane);
  words[3 * lane] = value.x;
  words[3 * lane + 1] = value.y;
  words[3 * lane + 2] = value.z;
  __syncwarp();
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const int word = k * 32 + lane;
    const int target = __shfl_sync(0xffffffffu, index, word / 3);
    if (target >= 0) result[3 * static_cast<std::size_t>(target) + word % 3] = words[word];
  }
}

}  // namespace gpuphys::granular
