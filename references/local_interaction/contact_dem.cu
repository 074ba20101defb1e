// contact_dem: normal contact forces between overlapping spheres (Hertz, damped, no tension), FP32.
//
// For every grain: the grains that overlap it, found through a uniform grid, and the sum of their forces.
//
// Mapping: the grains are sorted by cell (references/blocks/neighbour_grid.cuh) as records of one sector:
// position, radius, velocity, index; the result is two arrays, spheres and motions. Each sphere is written
// again as a code of four bytes for the search. A thread owns one grain in the sorted order, so a warp owns a
// stretch of one column of cells and its candidates of another column are a short run of codes. Every pair is
// evaluated twice, once from either side, with bitwise opposite results: no atomics, and forces balance to
// the rounding of each sum.
//
// What bounds it: the sort, L2 and waits for memory (300 MB in and out by ncu, most of it records, at half
// the rate of a copy: NOTES.md); the search, instructions (64 % of the issue slots) and L1 (77 %: of
// its 25 million wavefronts a third each for codes and for what the force gathers). A grain meets 8.2 columns
// of cells and 37 candidates (cells of 1.2 x 1.2 x 0.6 against a reach of 1.15), of which 4.7 touch. What
// pays:
// - Sorting in two levels: most atomics stay in shared memory, and records leave as whole sectors, close to
//   others of their bin.
// - Inputs are read by 16 bytes, whole lines a warp, and wait in shared memory for their turn.
// - Codes: a candidate costs one word instead of four (1.9 cache lines a load instead of about 7) and four
//   instructions: load, add, dp4a, shift. The test errs on the side of contact only and passes 0.6 candidates
//   a grain too many; the exact one in FP32 decides.
// - Three columns at a time, and six candidates of each without a branch: their loads are under way together.
//   Two more looks at longer ranges are all that a warp needs on average.
// - Columns in step: all lanes start at the column before their own, needed or not, so that they read the
//   same lines at the same time.
// - Search and force apart: hits are queued in shared memory as bits, a column an entry, and the force (about
//   57 instructions) runs over the queues with most lanes busy: the longest of a warp's 32 holds 6.4.
//   Evaluated inside the search, nearly every candidate would drag its warp through the force. Nor does the
//   search keep what only the force needs in registers: they limit the warps of an SM.
// - Spheres and motions in arrays of their own: what the lanes of a warp gather lies in fewer lines, and in
//   all banks of L1.
// The forces go back to the order of the input by scattered writes; three neighbouring lanes write the three
// words of a grain, so that it costs one or two sectors instead of three requests.
#include <cstdint>
#include <stdexcept>
#include <type_traits>

#include "cases/local_interaction/contact_dem.hpp"
#include "core/module.hpp"
#include "references/blocks/neighbour_grid.cuh"
#include "references/common/alignment.hpp"
#include "references/common/approximate.cuh"
#include "references/common/machine.cuh"

namespace gpuphys::contact_dem {
namespace {

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
struct Policy {
  static constexpr int threads = 64;
  static constexpr int at_once = 2;
  static constexpr int more = 1;
  static constexpr int run = 4;
  static constexpr int queue = 3;
  static constexpr int blocks_per_sm = 16;
};
#else
using GridPolicy = neighbour_grid::DefaultPolicy;
struct Policy {
  // Two columns of the paper's packing: its warps share what they read of the columns between. Larger blocks
  // leave places of their warps free for longer when they end.
  static constexpr int threads = 320;
  static constexpr int at_once = 6;  // candidates tested before the first look at a range's length
  static constexpr int more = 3;     // and between two looks
  static constexpr int run = 30;     // of one queue entry: at_once and a multiple of `more`; at most 32
  static constexpr int queue = 8;  // columns with hits a grain may have before they are evaluated in between
  static constexpr int blocks_per_sm = 4;
};
#endif

constexpr int columns = neighbour_grid::kColumns;
static_assert(Policy::run <= 32 && (Policy::run - Policy::at_once) % Policy::more == 0);
static_assert(Policy::queue >= columns && Policy::threads % 32 == 0);
// Codes behind the last grain's: they may be read, but are not grains.
constexpr int padding = Policy::at_once > Policy::more ? Policy::at_once : Policy::more;

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
    for (int k = 0; k < padding; ++k) codes[count + k] = 0;
  }
};

// ---- Forces ----

struct Law {
  float kn, cn;
};

// Adds to `force` what the grain (sphere, motion) feels from another one, if they touch. Neither the grain
// itself nor one with the same centre pushes: a direction is missing.
__device__ __forceinline__ void add_contact(float3& force, const float4& sphere, const float4& motion,
                                            const float4& other, const float4& other_motion, Law law) {
  const float dx = sphere.x - other.x, dy = sphere.y - other.y, dz = sphere.z - other.z;
  float square = dx * dx + dy * dy + dz * dz;
  const float reach = sphere.w + other.w;
  // No branch: nine in ten that get here touch, and both loads of a record are to be under way together.
  const bool touch = square < reach * reach && square > 0.0f;
  if (!touch) square = 1.0f;  // anything finite
  const float inverse = approximate_rsqrt(square);
  float distance = square * inverse;
  distance += 0.5f * inverse * (square - distance * distance);  // the overlap is a small difference of it
  const float nx = dx * inverse, ny = dy * inverse, nz = dz * inverse;
  const float overlap = touch ? fmaxf(reach - distance, 0.0f) : 0.0f;
  const float separation =
      (motion.x - other_motion.x) * nx + (motion.y - other_motion.y) * ny + (motion.z - other_motion.z) * nz;
  const float reduced_radius = sphere.w * other.w * approximate_inverse(reach);
  const float spread = approximate_sqrt(reduced_radius * overlap);
  const float push = fmaxf(spread * (law.kn * overlap - law.cn * separation), 0.0f);
  force.x += push * nx;
  force.y += push * ny;
  force.z += push * nz;
}

// 1 << k, and 0 for any k outside [0, 32).
__device__ __forceinline__ unsigned bit_or_none(int k) {
  return __funnelshift_lc(0u, 1u, static_cast<unsigned>(k));
}

__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    sum_contacts(const float4* spheres, const float4* motions, const unsigned* codes,
                 const neighbour_grid::Grid* grid_in, const int* start, float* result, Law law, int count) {
  __shared__ int2 queue[Policy::queue * Policy::threads];
  __shared__ float staged[3 * Policy::threads];
  __shared__ neighbour_grid::Grid grid;
  const int thread = static_cast<int>(threadIdx.x);
  // From the last slot to the first: what was sorted last is still in L2.
  const int slot = static_cast<int>(gridDim.x - 1 - blockIdx.x) * Policy::threads + thread;
  float3 force{0.0f, 0.0f, 0.0f};
  int index = -1;
  // Registers are short: the search reads the grid again and again, and global memory has a queue.
  if (thread == 0) grid = *grid_in;
  const float4 sphere = spheres[min(slot, count - 1)];
  __syncthreads();
  if (slot < count) {
    const unsigned probe = probe_of(grid, sphere);
    const int bound = code_bound(grid, sphere.w);
    // Candidates of a column with hits: the slot behind the last one, and a bit a hit. Entries thread, thread
    // + threads, ... of the queue are this thread's own; `top` is the next free one.
    constexpr unsigned stride = Policy::threads * sizeof(int2);
    const SharedAddress mine = shared_address(queue + thread);
    unsigned top = 0;
    const auto evaluate = [&]([[maybe_unused]] auto two_at_once) {
      // Loaded again, as the search has no registers to spare.
      const int own = opaque(slot);
      const Grain grain{spheres[own], motions[own]};
      if constexpr (decltype(two_at_once)::value) index = __float_as_int(grain.motion.w);  // the last time
      unsigned entry = 0;
      int2 run{0, 0};
      const auto more = [&] {
        if (run.y == 0 && entry != top) {
          run = load_shared(mine + entry);
          entry += stride;
        }
        return run.y != 0;
      };
      const auto take = [&] {
        const int bit = highest_bit(run.y);
        run.y ^= 1 << bit;
        return run.x - 1 - bit;
      };
      while (more()) {
        const int a = take();
        if constexpr (decltype(two_at_once)::value) {
          // Half as many waits for records. A grain feels nothing from itself.
          const int b = more() ? take() : slot;
          const Grain first{spheres[a], motions[a]}, second{spheres[b], motions[b]};
          add_contact(force, grain.sphere, grain.motion, first.sphere, first.motion, law);
          add_contact(force, grain.sphere, grain.motion, second.sphere, second.motion, law);
        } else {
          const Grain other{spheres[a], motions[a]};
          add_contact(force, grain.sphere, grain.motion, other.sphere, other.motion, law);
        }
      }
      top = 0;
    };
    // Shifts in whether a candidate may touch, as the lowest bit: the sign of a difference.
    const auto test = [&](unsigned hits, unsigned code) {
      const int bytes = static_cast<int>(probe + code);
      return __funnelshift_l(static_cast<unsigned>(__dp4a(bytes, bytes, -bound)), hits, 1);
    };
    const auto make_room = [&] {
      if (top > (Policy::queue - columns) * stride) evaluate(std::false_type{});
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
    evaluate(std::true_type{});
  }
  // Lane l of the warp writes words l, l + 32 and l + 64 of the warp's 96: words of one grain side by side.
  const int lane = thread % 32;
  float* const words = staged + 3 * (thread - lane);
  words[3 * lane] = force.x;
  words[3 * lane + 1] = force.y;
  words[3 * lane + 2] = force.z;
  __syncwarp();
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const int word = k * 32 + lane;
    const int target = __shfl_sync(0xffffffffu, index, word / 3);
    if (target >= 0) result[3 * static_cast<std::size_t>(target) + word % 3] = words[word];
  }
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.radius.shape[0];
    if (n > (1 << 30)) throw std::runtime_error("contact_dem: more than 2^30 grains");
    grid_.allocate<Grains>(n);
    split_ = DeviceBuffer<Grain>(grid_.records(n));
    sorted_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(n));
    codes_ = DeviceBuffer<unsigned>(static_cast<std::size_t>(n) + padding);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = static_cast<int>(in.radius.shape[0]);
    if (n == 0) return;
    // The sort reads its inputs by 16 bytes.
    require_aligned("contact_dem", "x", in.x.data);
    require_aligned("contact_dem", "v", in.v.data);
    require_aligned("contact_dem", "radius", in.radius.data);
    const auto blocks = [n](int threads) { return static_cast<unsigned>((n + threads - 1) / threads); };
    grid_.build(Grains{in.x.data, in.v.data, in.radius.data, split_.get(), sorted_.get(), codes_.get(), n});
    // An ordinary launch: blocks that join those of sort_bins on an SM would get what these leave of L1.
    sum_contacts<<<blocks(Policy::threads), Policy::threads>>>(sorted_.get(), sorted_.get() + n, codes_.get(),
                                                               grid_.grid(), grid_.start(), out.force.data,
                                                               Law{in.kn, in.cn}, n);
  }

 private:
  neighbour_grid::NeighbourGrid<GridPolicy> grid_;
  DeviceBuffer<Grain> split_;
  DeviceBuffer<float4> sorted_;
  DeviceBuffer<unsigned> codes_;
};

}  // namespace
}  // namespace gpuphys::contact_dem

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(contact_dem, contact_dem::Reference)
}
