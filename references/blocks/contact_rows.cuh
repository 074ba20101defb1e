// Contacts between particles: every pair nearer than a radius, found once, and Jacobi sweeps of XPBD over
// them.
//
// 1. The particles' box; a uniform grid of cells over it, in one counting sort: count, scan, place. A sorted
//    record is position and name, 16 bytes.
// 2. find_contacts: one thread a particle, in the order of the cells, walks the rows of cells within the
// radius
//    and counts its partners; a warp takes room for its rows with one atomic; then they are written. Up to
//    `kept` partners wait in shared memory, so that the walk is done twice by few.
// 3. sweep_contacts: one thread a particle gathers its own displacement from its row. A contact stands in the
//    rows of both its ends, each with a copy of the multiplier; both copies take the same operations on
//    operands that differ in sign only, so they stay equal bit by bit. No atomics.
//
// Rows follow the order of the cells, so that partners come out of L1 and L2. Names are what the user calls
// particles: those of a sort of its own (positions come by name), or the places of this one.
//
// What bounds it: latency of the walk, then L2 in the sweeps: 8 bytes of row and 32 of the partner for each
// end of a contact.
#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "references/common/approximate.cuh"
#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::contacts {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int sort_threads = 128;
  static constexpr int find_threads = 64;
  static constexpr int sweep_threads = 128;
  static constexpr int kept = 2;
  static constexpr float cell_over_radius[3] = {1.0f, 1.0f, 1.0f};
#else
  static constexpr int sort_threads = 256;
  static constexpr int find_threads = 128;
  static constexpr int sweep_threads = 256;
  static constexpr int kept = 8;  // partners
  // Fine along x, where a range of cells is read.
  static constexpr float cell_over_radius[3] = {0.5f, 1.0f, 1.0f};
#endif
  static constexpr int bounds_blocks = 512;
};

constexpr unsigned kAllLanes = 0xffffffffu;

__device__ __forceinline__ std::uint32_t encode(float f) {
  const std::uint32_t bits = __float_as_uint(f);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}
__device__ __forceinline__ float decode(std::uint32_t code) {
  return __uint_as_float(code & 0x80000000u ? code & 0x7fffffffu : ~code);
}

/// Zero before a build, by one memset; the counts follow.
struct alignas(256) Head {
  std::uint32_t low_code[3],
      high_code[3];         ///< of the box: largest codes of the negated coordinates, and of them
  unsigned long long used;  ///< entries of rows given out, or wanted
};

struct Grid {
  float low[3], inverse_cell[3], reach;
  int n[3];

  /// Monotone in x, so that whatever is within `reach` of x lies in the cells from that of x - reach to that
  /// of x + reach.
  __device__ __forceinline__ int coordinate(float x, int d) const {
    return static_cast<int>(fminf(fmaxf((x - low[d]) * inverse_cell[d], 0.0f), static_cast<float>(n[d] - 1)));
  }
  __device__ __forceinline__ int row(int y, int z) const { return (z * n[1] + y) * n[0]; }
};

constexpr int kLeastCells = 64;

__device__ inline Grid make_grid(const Head& head, float radius, int capacity) {
  Grid g;
  float range[3], cell[3], longest = 0.0f, furthest = 0.0f;
  for (int d = 0; d < 3; ++d) {
    g.low[d] = -decode(head.low_code[d]);
    const float high = decode(head.high_code[d]);
    range[d] = high - g.low[d];
    longest = fmaxf(longest, range[d]);
    furthest = fmaxf(furthest, fmaxf(fabsf(g.low[d]), fabsf(high)));
  }
  // Positions may have been rounded, by half a unit in the last place each.
  g.reach = radius * (1.0f + 0x1p-20f) + furthest * 0x1p-22f;
  const float wish[3] = {Policy::cell_over_radius[0], Policy::cell_over_radius[1],
                         Policy::cell_over_radius[2]};
  for (int d = 0; d < 3; ++d) cell[d] = fmaxf(fmaxf(wish[d] * radius, 1e-6f * longest), 1e-30f);
  for (;;) {
    float product = 1.0f;
    for (int d = 0; d < 3; ++d) product *= floorf(range[d] / cell[d]) + 2.0f;
    if (!(product > 0.999f * static_cast<float>(capacity))) break;
    for (int d = 0; d < 3; ++d) cell[d] *= 1.2f;
  }
  for (int d = 0; d < 3; ++d) {
    g.inverse_cell[d] = 1.0f / cell[d];
    g.n[d] = static_cast<int>(floorf(range[d] / cell[d])) + 2;
  }
  return g;
}

/// Particles as (n,3) in input order; their names are the places of the sort.
struct InputParticles {
  static constexpr bool kNamed = false;
  const float* __restrict__ x;
  const float* __restrict__ inv_mass;
  float4* base;          ///< (n), by place: receives position and inverse mass
  std::int32_t* number;  ///< (n): receives the place of each

  __device__ __forceinline__ float3 position(int i) const { return {x[3 * i], x[3 * i + 1], x[3 * i + 2]}; }
  __device__ __forceinline__ void placed(int i, int place, float3 p) const {
    base[place] = make_float4(p.x, p.y, p.z, inv_mass[i]);
    number[i] = place;
  }
  /// Partner j seen from i.
  __device__ __forceinline__ float3 difference(const float4& own, const float4& other) const {
    return {own.x - other.x, own.y - other.y, own.z - other.z};
  }
};

/// Particles at base + step, in an order of the user's own, whose numbers are their names.
struct MovedParticles {
  static constexpr bool kNamed = true;
  const float4* base;  ///< (n): position, inverse mass
  const float4* step;  ///< (n): displacement

  __device__ __forceinline__ float3 position(int i) const {
    const float4 b = base[i], s = step[i];
    return {b.x + s.x, b.y + s.y, b.z + s.z};
  }
  __device__ __forceinline__ void placed(int, int, float3) const {}
  /// From what is not rounded.
  __device__ __forceinline__ float3 difference(const float4& own, const float4& other) const {
    const int i = __float_as_int(own.w), j = __float_as_int(other.w);
    const float4 bi = base[i], bj = base[j], si = step[i], sj = step[j];
    return {(bi.x - bj.x) + (si.x - sj.x), (bi.y - bj.y) + (si.y - sj.y), (bi.z - bj.z) + (si.z - sj.z)};
  }
};

/// What passes between the kernels.
struct Scratch {
  Head* head;
  std::int32_t* starts;  ///< (cells + 1): counts, then the first place of each cell
  int2* cell_and_rank;   ///< (n)
  float4* sorted;        ///< (n): position, name
  int2* rows;            ///< (n), by name: first entry and number of entries
  std::int32_t* other;   ///< (capacity): name of the partner
  float* multiplier;     ///< (capacity)
  int n, cell_capacity, capacity;
  float radius;
};

template <class Source>
__global__ void __launch_bounds__(Policy::sort_threads) find_box(Source source, Scratch s) {
  __shared__ std::uint32_t codes[6];
  if (threadIdx.x < 6) codes[threadIdx.x] = 0;
  __syncthreads();
  std::uint32_t most[6] = {};
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < s.n; i += stride) {
    const float3 p = source.position(i);
    const float c[3] = {p.x, p.y, p.z};
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      most[d] = max(most[d], encode(-c[d]));
      most[3 + d] = max(most[3 + d], encode(c[d]));
    }
  }
#pragma unroll
  for (int k = 0; k < 6; ++k) {
    const std::uint32_t largest = __reduce_max_sync(kAllLanes, most[k]);
    if (threadIdx.x % 32 == 0) atomicMax(codes + k, largest);
  }
  __syncthreads();
  if (threadIdx.x < 3) atomicMax(s.head->low_code + threadIdx.x, codes[threadIdx.x]);
  if (threadIdx.x >= 3 && threadIdx.x < 6) atomicMax(s.head->high_code + threadIdx.x - 3, codes[threadIdx.x]);
}

template <class Source>
__global__ void __launch_bounds__(Policy::sort_threads) count_cells(Source source, Scratch s) {
  __shared__ Grid grid;
  if (threadIdx.x == 0) grid = make_grid(*s.head, s.radius, s.cell_capacity);
  __syncthreads();
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= s.n) return;
  const float3 p = source.position(i);
  const int cell = grid.row(grid.coordinate(p.y, 1), grid.coordinate(p.z, 2)) + grid.coordinate(p.x, 0);
  s.cell_and_rank[i] = {cell, atomicAdd(s.starts + cell, 1)};
}

template <class Source>
__global__ void __launch_bounds__(Policy::sort_threads) place_particles(Source source, Scratch s) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= s.n) return;
  const int2 at = s.cell_and_rank[i];
  const int place = s.starts[at.x] + at.y;
  const float3 p = source.position(i);
  s.sorted[place] = make_float4(p.x, p.y, p.z, __int_as_float(Source::kNamed ? i : place));
  source.placed(i, place, p);
}

/// Calls partner(name) for every particle nearer to `own` than the radius, strictly, and not in the same
/// point.
template <class Source, class Partner>
__device__ __forceinline__ void each_partner(const Source& source, const Scratch& s, const Grid& grid,
                                             int place, const float4& own, Partner&& partner) {
  const float square_of_reach = grid.reach * grid.reach * (1.0f + 0x1p-20f), rr = s.radius * s.radius;
  const int x0 = grid.coordinate(own.x - grid.reach, 0), x1 = grid.coordinate(own.x + grid.reach, 0);
  const int y0 = grid.coordinate(own.y - grid.reach, 1), y1 = grid.coordinate(own.y + grid.reach, 1);
  const int z0 = grid.coordinate(own.z - grid.reach, 2), z1 = grid.coordinate(own.z + grid.reach, 2);
  for (int z = z0; z <= z1; ++z) {
    for (int y = y0; y <= y1; ++y) {
      const int cells = grid.row(y, z), end = s.starts[cells + x1 + 1];
      for (int j = s.starts[cells + x0]; j < end; ++j) {
        const float4 other = s.sorted[j];
        const float3 c = {own.x - other.x, own.y - other.y, own.z - other.z};
        if (j == place || c.x * c.x + c.y * c.y + c.z * c.z > square_of_reach) continue;
        const float3 d = source.difference(own, other);
        const float square = d.x * d.x + d.y * d.y + d.z * d.z;
        if (square > 0.0f && square < rr) partner(__float_as_int(other.w));
      }
    }
  }
}

/// Rows of all particles. Where they do not fit the capacity, those beyond it are empty (and head->used says
/// so).
template <class Source>
__global__ void __launch_bounds__(Policy::find_threads) find_contacts(Source source, Scratch s) {
  __shared__ Grid grid;
  __shared__ int waiting[Policy::kept][Policy::find_threads];
  if (threadIdx.x == 0) grid = make_grid(*s.head, s.radius, s.cell_capacity);
  __syncthreads();
  const int place = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int tid = static_cast<int>(threadIdx.x), lane = tid % 32;
  const bool there = place < s.n;
  float4 own{};
  int count = 0;
  if (there) {
    own = s.sorted[place];
    each_partner(source, s, grid, place, own, [&](int name) {
      if (count < Policy::kept) waiting[count][tid] = name;
      ++count;
    });
  }
  int before = count;
#pragma unroll
  for (int offset = 1; offset < 32; offset *= 2) {
    const int below = __shfl_up_sync(kAllLanes, before, offset);
    if (lane >= offset) before += below;
  }
  unsigned long long given = 0;
  if (lane == 31 && before > 0) given = atomicAdd(&s.head->used, static_cast<unsigned long long>(before));
  const long long first = static_cast<long long>(__shfl_sync(kAllLanes, given, 31)) + before - count;
  if (!there) return;
  const bool fits = first + count <= s.capacity;
  const int begin = fits ? static_cast<int>(first) : 0;
  s.rows[__float_as_int(own.w)] = {begin, fits ? count : 0};
  if (!fits) return;
  if (count <= Policy::kept) {
    for (int k = 0; k < count; ++k) s.other[begin + k] = waiting[k][tid];
  } else {
    int at = begin;
    each_partner(source, s, grid, place, own, [&](int name) { s.other[at++] = name; });
  }
}

/// Contacts of XPBD.
struct Contact {
  float thickness, alpha, relaxation;
};

/// One sweep: what the contacts of a particle move it by is added to its `next`; `Alone`, `next` is what they
/// make of `now`, and particles without contacts are left out. `First`: multipliers are 0 and, `Alone`,
/// displacements too.
template <bool First, bool Alone>
__global__ void __launch_bounds__(Policy::sweep_threads)
    sweep_contacts(const __grid_constant__ Scratch s, const __grid_constant__ Contact contact,
                   const float4* __restrict__ base, const float4* __restrict__ now,
                   float4* __restrict__ next) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= s.n) return;
  const int2 row = s.rows[i];
  if (row.y == 0) return;
  const float4 own = base[i];
  const float4 none = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  const float4 before = First && Alone ? none : now[i];
  float3 sum = {0.0f, 0.0f, 0.0f};
#pragma unroll 2
  for (int k = row.x; k < row.x + row.y; ++k) {
    const int j = s.other[k];
    const float4 other = base[j], moved = First && Alone ? none : now[j];
    const float3 d = {(own.x - other.x) + (before.x - moved.x), (own.y - other.y) + (before.y - moved.y),
                      (own.z - other.z) + (before.z - moved.z)};
    const float square = d.x * d.x + d.y * d.y + d.z * d.z, inv_mass = own.w + other.w;
    const float inverse = approximate_rsqrt(square);
    float length = square * inverse;
    length += 0.5f * inverse * (square - length * length);  // one Newton step
    const float multiplier = First ? 0.0f : s.multiplier[k];
    const float violation = length - contact.thickness;
    const float step =
        contact.relaxation * (-violation - contact.alpha * multiplier) / (inv_mass + contact.alpha);
    // Coincident particles have no direction, and pinned ones do not move.
    const bool acts = square >= 1.17549435e-38f && inv_mass > 0.0f;
    const float after = acts ? fmaxf(0.0f, multiplier + step) : multiplier;
    const float along = acts ? (after - multiplier) * inverse : 0.0f;
    s.multiplier[k] = after;
    sum.x += along * d.x;
    sum.y += along * d.y;
    sum.z += along * d.z;
  }
  const float4 start = Alone ? before : next[i];
  next[i] = make_float4(start.x + own.w * sum.x, start.y + own.w * sum.y, start.z + own.w * sum.z, start.w);
}

/// Memory and kernels for up to `n` particles and 2 `pairs` entries.
class ContactRows {
 public:
  /// Contacts that a problem of n particles may have.
  static std::int64_t most_pairs(std::int64_t n) {
    const std::int64_t least = std::int64_t{1} << 21;
    return 8 * n > least ? 8 * n : least;
  }

  ContactRows() = default;
  explicit ContactRows(std::int64_t n) : n_(n) {
    if (n > std::int64_t{1} << 26) throw std::runtime_error("contacts: more than 2^26 particles");
    cells_ = 2 * n + kLeastCells;
    capacity_ = 2 * most_pairs(n);
    counters_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(kHeadWords + cells_ + 1));
    cell_and_rank_ = DeviceBuffer<int2>(static_cast<std::size_t>(n));
    sorted_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    rows_ = DeviceBuffer<int2>(static_cast<std::size_t>(n));
    other_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(capacity_));
    multiplier_ = DeviceBuffer<float>(static_cast<std::size_t>(capacity_));
    scan_bytes_ = primitives::exclusive_sum_bytes(cells_ + 1);
    scan_ = DeviceBuffer<unsigned char>(scan_bytes_);
  }

  /// Finds all pairs of particles of `source` nearer than `radius`.
  template <class Source>
  Scratch build(const Source& source, float radius) const {
    const Scratch s{reinterpret_cast<Head*>(counters_.get()),
                    counters_.get() + kHeadWords,
                    cell_and_rank_.get(),
                    sorted_.get(),
                    rows_.get(),
                    other_.get(),
                    multiplier_.get(),
                    static_cast<int>(n_),
                    static_cast<int>(cells_),
                    static_cast<int>(capacity_),
                    radius};
    GPUPHYS_CUDA(cudaMemsetAsync(counters_.get(), 0,
                                 sizeof(std::int32_t) * static_cast<std::size_t>(kHeadWords + cells_ + 1)));
    const unsigned sort_blocks = blocks(Policy::sort_threads);
    const unsigned box_blocks = sort_blocks < Policy::bounds_blocks ? sort_blocks : Policy::bounds_blocks;
    find_box<<<box_blocks, Policy::sort_threads>>>(source, s);
    count_cells<<<sort_blocks, Policy::sort_threads>>>(source, s);
    primitives::exclusive_sum(scan_.get(), scan_bytes_, s.starts, s.starts, cells_ + 1);
    place_particles<<<sort_blocks, Policy::sort_threads>>>(source, s);
    find_contacts<<<blocks(Policy::find_threads), Policy::find_threads>>>(source, s);
    return s;
  }

  template <bool Alone>
  void sweep(const Scratch& s, const Contact& contact, bool first, const float4* base, const float4* now,
             float4* next) const {
    const auto kernel = first ? sweep_contacts<true, Alone> : sweep_contacts<false, Alone>;
    kernel<<<blocks(Policy::sweep_threads), Policy::sweep_threads>>>(s, contact, base, now, next);
  }

 private:
  static constexpr std::int64_t kHeadWords = sizeof(Head) / sizeof(std::int32_t);

  unsigned blocks(int threads) const { return static_cast<unsigned>((n_ + threads - 1) / threads); }

  std::int64_t n_ = 0, cells_ = 0, capacity_ = 0;
  std::size_t scan_bytes_ = 0;
  DeviceBuffer<std::int32_t> counters_, other_;
  DeviceBuffer<int2> cell_and_rank_, rows_;
  DeviceBuffer<float4> sorted_;
  DeviceBuffer<float> multiplier_;
  DeviceBuffer<unsigned char> scan_;
};

}  // namespace gpuphys::contacts
