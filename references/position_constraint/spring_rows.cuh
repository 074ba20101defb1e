// Rows of half-springs, one row a particle, from springs in arbitrary order, without global atomics and
// without stores to random places of device memory.
//
// Particles are renumbered by the caller (spatial_order.cuh). A bin is 2^shift consecutive numbers. Three
// passes over the springs: (1) every block renumbers the ends of its share and counts them by bin in shared
// memory; a scan of the [bin][block] matrix gives each block its place in every bin; (2) every block sorts
// its share by bin, a chunk at a time in shared memory, so that stores are runs of neighbours (the longer the
// better: both ends of a run are parts of sectors, which the L2 must complete from device memory unless the
// next run comes in time); (3) one block a bin counts, scans and sorts by particle in shared memory, and
// writes its rows whole. A bin that shared memory does not hold (a particle with very many springs) is
// written in place, which is slower.
//
// What bounds it, bytes a spring of device memory: 8 in and 8 out in pass 1, 12 and 16 in pass 2, 16 and 16
// in pass 3, and in pass 1 two random 4-byte numbers out of the L2.
#pragma once

#include <cstdint>
#include <stdexcept>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace gpuphys::springs {

/// One particle: 32 bytes, one sector, so that a random gather moves nothing else.
struct __align__(16) Particle {
  float4 base;  ///< position before the solve, m, and inverse mass, 1/kg
  float4 step;  ///< displacement so far, m, and number of half-springs
};

/// A spring as one of its ends sees it.
struct __align__(8) HalfSpring {
  std::int32_t other;  ///< the particle at the other end
  float rest;          ///< m
};

constexpr int kMaxBins = 2048;
constexpr int kMaxShift = 13;  // counters of a bin take 32 KB of shared memory

/// A half-spring on its way to its row: in the order of bins, with its particle's place in the bin. One
/// aligned vector: a second array of two-byte places would be written in parts of sectors.
struct __align__(8) NarrowRecord {
  static constexpr int kOtherBits = 22, kPlaceBits = 32 - kOtherBits;
  std::uint32_t key;  ///< place and other end
  float rest;         ///< m

  __device__ __forceinline__ static NarrowRecord of(int place, int other, float length) {
    return {static_cast<std::uint32_t>(place) << kOtherBits | static_cast<std::uint32_t>(other), length};
  }
  __device__ __forceinline__ static NarrowRecord stream(const NarrowRecord* p) {
    const int2 v = __ldcs(reinterpret_cast<const int2*>(p));
    return {static_cast<std::uint32_t>(v.x), __int_as_float(v.y)};
  }
  __device__ __forceinline__ int place() const {
    return static_cast<int>(key >> kOtherBits);
  }
  __device__ __forceinline__ int other() const {
    return static_cast<int>(key & ((1u << kOtherBits) - 1u));
  }
};
static_assert(kMaxBins <= 1 << (NarrowRecord::kOtherBits - NarrowRecord::kPlaceBits),
              "narrow records take every particle when bins are small enough");

/// The same for more particles than 32 bits can name along with a place.
struct __align__(16) WideRecord {
  std::int32_t own_place, other_end;
  float rest;  ///< m
  std::int32_t unused;

  __device__ __forceinline__ static WideRecord of(int place, int other, float length) {
    return {place, other, length, 0};
  }
  __device__ __forceinline__ static WideRecord stream(const WideRecord* p) {
    const int4 v = __ldcs(reinterpret_cast<const int4*>(p));
    return {v.x, v.y, __int_as_float(v.z), v.w};
  }
  __device__ __forceinline__ int place() const {
    return own_place;
  }
  __device__ __forceinline__ int other() const {
    return other_end;
  }
};

/// Sum of `value` over the threads of the block before this one. All threads call it; `warp_sum` (32) is
/// shared, and must not be in use: a barrier lies between two calls.
template <int Threads>
__device__ __forceinline__ int sum_before(int value, int* warp_sum) {
  const int lane = static_cast<int>(threadIdx.x) % 32, warp = static_cast<int>(threadIdx.x) / 32;
  int inclusive = value;
#pragma unroll
  for (int d = 1; d < 32; d *= 2) {
    const int below = __shfl_up_sync(0xffffffffu, inclusive, d);
    if (lane >= d) inclusive += below;
  }
  if (lane == 31) warp_sum[warp] = inclusive;
  __syncthreads();
  int before = inclusive - value;
#pragma unroll
  for (int w = 0; w < Threads / 32; ++w) before += w < warp ? warp_sum[w] : 0;
  return before;
}

/// Pass 1: new ends of every spring, and `matrix[bin][block]`, the half-springs of each bin in the block's
/// share. A spring from a particle to itself does not count. One element behind the matrix is cleared: the
/// scan leaves the total there.
template <int Threads>
__global__ void __launch_bounds__(Threads)
    count_bins(const int2* __restrict__ ends, const std::int32_t* __restrict__ number, int m, int share,
               int shift, int bins, int2* __restrict__ renumbered, int* __restrict__ matrix) {
  constexpr int unroll = 4;
  __shared__ int count[kMaxBins];
  const int tid = static_cast<int>(threadIdx.x);
  const int blocks = static_cast<int>(gridDim.x), block = static_cast<int>(blockIdx.x);
  for (int b = tid; b < bins; b += Threads) count[b] = 0;
  __syncthreads();
  const int first = block * share, last = min(first + share, m);
  for (int j0 = first + tid; j0 < last; j0 += Threads * unroll) {
    int2 e[unroll];
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      const int j = j0 + u * Threads;
      e[u] = j < last ? __ldcs(ends + j) : int2{0, 0};
    }
#pragma unroll
    for (int u = 0; u < unroll; ++u) e[u] = int2{number[e[u].x], number[e[u].y]};
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      const int j = j0 + u * Threads;
      if (j < last) __stcs(renumbered + j, e[u]);
      if (j < last && e[u].x != e[u].y) {
        atomicAdd(count + (e[u].x >> shift), 1);
        atomicAdd(count + (e[u].y >> shift), 1);
      }
    }
  }
  __syncthreads();
  for (int b = tid; b < bins; b += Threads) matrix[b * blocks + block] = count[b];
  if (block == 0 && tid == 0) matrix[bins * blocks] = 0;
}

/// Shared memory of split_by_bin, bytes.
template <class Record>
constexpr std::size_t split_bytes(int threads, int items, int bins) {
  return (sizeof(Record) + sizeof(std::uint16_t)) * 2 * static_cast<std::size_t>(threads) *
             static_cast<std::size_t>(items) +
         3 * sizeof(int) * static_cast<std::size_t>(bins);
}

/// Pass 2: half-springs in order of bins. `start` is the scanned matrix of pass 1, of `columns` shares; a
/// block takes `merged` neighbouring ones. The next chunk is on its way while this one is written.
template <class Record, int Threads, int Items>
__global__ void __launch_bounds__(Threads)
    split_by_bin(const int2* __restrict__ ends, const float* __restrict__ rest, int m, int share, int columns,
                 int merged, int shift, int bins, const int* __restrict__ start, Record* __restrict__ split) {
  constexpr int chunk = Threads * Items;  // springs
  constexpr int bins_a_thread = (kMaxBins + Threads - 1) / Threads;
  extern __shared__ int4 pool[];
  __shared__ int warp_sum[32], total;
  Record* const sorted = reinterpret_cast<Record*>(pool);
  int* const count = reinterpret_cast<int*>(sorted + 2 * chunk);  // then where the bin begins in the chunk
  int* const cursor = count + bins;   // where the block's next half-spring of the bin goes
  int* const offset = cursor + bins;  // from a place in the sorted chunk to one in `split`
  std::uint16_t* const sorted_bin = reinterpret_cast<std::uint16_t*>(offset + bins);
  const int tid = static_cast<int>(threadIdx.x), mask = (1 << shift) - 1;
  const int block = static_cast<int>(blockIdx.x);
  for (int b = tid; b < bins; b += Threads) {
    cursor[b] = start[b * columns + block * merged];
    count[b] = 0;
  }
  const int first = block * merged * share, last = min(first + merged * share, m);
  int2 e[Items];
  float length[Items];
#pragma unroll
  for (int u = 0; u < Items; ++u) {
    const int j = first + u * Threads + tid;
    e[u] = j < last ? __ldcs(ends + j) : int2{0, 0};
    length[u] = j < last ? __ldcs(rest + j) : 0.0f;
  }
  __syncthreads();
  for (int c = first; c < last; c += chunk) {
    int rank[Items];  // of both ends among the chunk's half-springs of the bin, 16 bits each
#pragma unroll
    for (int u = 0; u < Items; ++u) {
      rank[u] = 0;
      if (e[u].x == e[u].y) continue;
      const int at_x = atomicAdd(count + (e[u].x >> shift), 1);
      const int at_y = atomicAdd(count + (e[u].y >> shift), 1);
      rank[u] = at_x | at_y << 16;
    }
    __syncthreads();
    int mine = 0;
#pragma unroll
    for (int k = 0; k < bins_a_thread; ++k) {
      const int b = tid * bins_a_thread + k;
      mine += b < bins ? count[b] : 0;
    }
    int before = sum_before<Threads>(mine, warp_sum);
#pragma unroll
    for (int k = 0; k < bins_a_thread; ++k) {
      const int b = tid * bins_a_thread + k;
      if (b >= bins) break;
      const int here = count[b], to = cursor[b];
      count[b] = before;
      offset[b] = to - before;
      cursor[b] = to + here;
      before += here;
    }
    if (tid == Threads - 1) total = before;
    __syncthreads();
#pragma unroll
    for (int u = 0; u < Items; ++u) {
      if (e[u].x == e[u].y) continue;
      const int bin_x = e[u].x >> shift, bin_y = e[u].y >> shift;
      const int at_x = count[bin_x] + (rank[u] & 0xffff);
      const int at_y = count[bin_y] + (rank[u] >> 16);
      sorted[at_x] = Record::of(e[u].x & mask, e[u].y, length[u]);
      sorted[at_y] = Record::of(e[u].y & mask, e[u].x, length[u]);
      sorted_bin[at_x] = static_cast<std::uint16_t>(bin_x);
      sorted_bin[at_y] = static_cast<std::uint16_t>(bin_y);
    }
#pragma unroll
    for (int u = 0; u < Items; ++u) {
      const int j = c + chunk + u * Threads + tid;
      e[u] = j < last ? __ldcs(ends + j) : int2{0, 0};
      length[u] = j < last ? __ldcs(rest + j) : 0.0f;
    }
    __syncthreads();
    for (int b = tid; b < bins; b += Threads) count[b] = 0;
    const int filled = total;
    for (int k = tid; k < filled; k += Threads) split[offset[sorted_bin[k]] + k] = sorted[k];
    __syncthreads();
  }
}

/// Shared memory of sort_bin, bytes.
constexpr std::size_t sort_bytes(int capacity, int shift) {
  return sizeof(HalfSpring) * static_cast<std::size_t>(capacity) + (sizeof(int) << shift);
}

/// Pass 3: block b sorts bin b by particle; row i begins at `begin[i]`. A bin of up to `Capacity`
/// half-springs is sorted in shared memory. Then lays down the particles, at rest at their input positions:
/// place i takes particle order[i].
template <class Record, int Threads, int Capacity>
__global__ void __launch_bounds__(Threads)
    sort_bin(const Record* __restrict__ split, const int* __restrict__ start, int blocks, int n, int shift,
             const float* __restrict__ x, const float* __restrict__ inv_mass,
             const std::uint32_t* __restrict__ order, int* __restrict__ begin, HalfSpring* __restrict__ half,
             Particle* __restrict__ placed) {
  constexpr int unroll = 4;
  extern __shared__ int2 room[];
  __shared__ int warp_sum[32];
  int2* const sorted = room;
  int* const count = reinterpret_cast<int*>(room + Capacity);
  const int tid = static_cast<int>(threadIdx.x), bin = static_cast<int>(blockIdx.x);
  const int low = bin << shift, particles = min(1 << shift, n - low);
  const int first = start[bin * blocks], last = start[(bin + 1) * blocks];
  for (int i = tid; i < 1 << shift; i += Threads) count[i] = 0;
  __syncthreads();
  for (int k0 = first + tid; k0 < last; k0 += Threads * unroll) {
    int particle[unroll];
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      const int k = k0 + u * Threads;
      particle[u] = k < last ? split[k].place() : -1;
    }
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      if (particle[u] >= 0) atomicAdd(count + particle[u], 1);
    }
  }
  __syncthreads();
  const int a_thread = ((1 << shift) + Threads - 1) / Threads;
  const int from = min(tid * a_thread, particles), until = min(from + a_thread, particles);
  int mine = 0;
  for (int i = from; i < until; ++i) mine += count[i];
  int before = sum_before<Threads>(mine, warp_sum);
  for (int i = from; i < until; ++i) {
    const int here = count[i];
    begin[low + i] = first + before;
    count[i] = before;
    before += here;
  }
  if (tid == 0 && low + particles == n) begin[n] = last;
  __syncthreads();
  const bool fits = last - first <= Capacity;
  for (int k0 = first + tid; k0 < last; k0 += Threads * unroll) {
    int particle[unroll];
    int2 spring[unroll];
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      const int k = k0 + u * Threads;
      particle[u] = -1;
      if (k >= last) continue;
      const Record record = Record::stream(split + k);
      particle[u] = record.place();
      spring[u] = int2{record.other(), __float_as_int(record.rest)};
    }
#pragma unroll
    for (int u = 0; u < unroll; ++u) {
      if (particle[u] < 0) continue;
      const int at = atomicAdd(count + particle[u], 1);
      if (fits) {
        sorted[at] = spring[u];
      } else {
        reinterpret_cast<int2*>(half)[first + at] = spring[u];
      }
    }
  }
  __syncthreads();  // the counters now hold where each row ends
  if (fits) {
    for (int k = tid; k < last - first; k += Threads) {
      __stcs(reinterpret_cast<int2*>(half) + first + k, sorted[k]);
    }
  }
  for (int i = tid; i < particles; i += Threads) {
    const std::uint32_t q = order[low + i];
    const int valence = count[i] - (i > 0 ? count[i - 1] : 0);
    Particle p;
    p.base = make_float4(x[3 * q], x[3 * q + 1], x[3 * q + 2], inv_mass[q]);
    p.step = make_float4(0.0f, 0.0f, 0.0f, static_cast<float>(valence));
    placed[low + i] = p;
  }
}

/// Rows for up to `n` particles and `m` springs, in memory of its own. `Shape` gives the launches: `blocks`
/// with a share of the springs each, `count_threads`; `split_merged` shares a block of `split_threads`
/// threads with `split_items` springs each (half as many when records are wide); `wide_records` to have them
/// wide even where narrow ones do; `bin_shift`, `sort_threads` and `sort_capacity` half-springs.
template <class Shape>
class HalfSprings {
 public:
  HalfSprings() = default;
  HalfSprings(int n, int m) : n_(n), m_(m), shift_(Shape::bin_shift) {
    while (bins() > kMaxBins) ++shift_;
    wide_ = Shape::wide_records || shift_ > NarrowRecord::kPlaceBits;
    if (shift_ > kMaxShift) throw std::runtime_error("more particles than the bins of springs hold");
    const std::size_t matrix = static_cast<std::size_t>(bins()) * Shape::blocks + 1;
    matrix_ = DeviceBuffer<int>(matrix);
    begin_ = DeviceBuffer<int>(static_cast<std::size_t>(n) + 1);
    renumbered_ = DeviceBuffer<int2>(static_cast<std::size_t>(m));
    split_ = DeviceBuffer<unsigned char>((wide_ ? sizeof(WideRecord) : sizeof(NarrowRecord)) * 2 *
                                         static_cast<std::size_t>(m));
    half_ = DeviceBuffer<HalfSpring>(2 * static_cast<std::size_t>(m));
    scratch_bytes_ = primitives::exclusive_sum_bytes(static_cast<std::int64_t>(matrix));
    scratch_ = DeviceBuffer<unsigned char>(scratch_bytes_);
    wide_ ? prepare<WideRecord>() : prepare<NarrowRecord>();
  }

  /// Sorts the springs into rows of particles renumbered by `number`, of which `order` is the inverse, and
  /// writes the particles at rest to `placed`.
  void build(const int2* ends, const float* rest, const std::int32_t* number, const std::uint32_t* order,
             const float* x, const float* inv_mass, Particle* placed) const {
    const int warps = (m_ + 31) / 32;  // shares begin at whole sectors
    const int share = (warps + Shape::blocks - 1) / Shape::blocks * 32;
    const auto blocks = static_cast<unsigned>(Shape::blocks);
    count_bins<Shape::count_threads><<<blocks, Shape::count_threads>>>(
        ends, number, m_, share, shift_, bins(), renumbered_.get(), matrix_.get());
    primitives::exclusive_sum(scratch_.get(), scratch_bytes_, matrix_.get(), matrix_.get(),
                              static_cast<std::int64_t>(bins()) * Shape::blocks + 1);
    if (wide_) {
      sort<WideRecord>(rest, share, order, x, inv_mass, placed);
    } else {
      sort<NarrowRecord>(rest, share, order, x, inv_mass, placed);
    }
  }

  const int* begin() const { return begin_.get(); }       ///< (n+1): where each row begins
  const HalfSpring* half() const { return half_.get(); }  ///< (2m)

 private:
  static_assert(2 * Shape::split_threads * Shape::split_items <= 1 << 15, "ranks take 16 bits, signed");
  static_assert(Shape::blocks % Shape::split_merged == 0, "every share has a block that splits it");

  template <class Record>
  static constexpr int items = sizeof(Record) > 8 ? Shape::split_items / 2 : Shape::split_items;
  template <class Record>
  static constexpr auto split_kernel = split_by_bin<Record, Shape::split_threads, items<Record>>;
  template <class Record>
  static constexpr auto sort_kernel = sort_bin<Record, Shape::sort_threads, Shape::sort_capacity>;

  int bins() const { return ((n_ - 1) >> shift_) + 1; }
  std::size_t bytes_to_sort() const { return sort_bytes(Shape::sort_capacity, shift_); }
  template <class Record>
  std::size_t bytes_to_split() const {
    return split_bytes<Record>(Shape::split_threads, items<Record>, bins());
  }

  template <class Record>
  void prepare() const {
    GPUPHYS_CUDA(cudaFuncSetAttribute(split_kernel<Record>, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(bytes_to_split<Record>())));
    GPUPHYS_CUDA(cudaFuncSetAttribute(sort_kernel<Record>, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(bytes_to_sort())));
  }

  /// Passes 2 and 3.
  template <class Record>
  void sort(const float* rest, int share, const std::uint32_t* order, const float* x, const float* inv_mass,
            Particle* placed) const {
    Record* const records = reinterpret_cast<Record*>(split_.get());
    const auto blocks = static_cast<unsigned>(Shape::blocks / Shape::split_merged);
    split_kernel<Record><<<blocks, Shape::split_threads, bytes_to_split<Record>()>>>(
        renumbered_.get(), rest, m_, share, Shape::blocks, Shape::split_merged, shift_, bins(), matrix_.get(),
        records);
    sort_kernel<Record><<<static_cast<unsigned>(bins()), Shape::sort_threads, bytes_to_sort()>>>(
        records, matrix_.get(), Shape::blocks, n_, shift_, x, inv_mass, order, begin_.get(), half_.get(),
        placed);
  }

  int n_ = 0, m_ = 0, shift_ = 0;
  bool wide_ = false;
  DeviceBuffer<int> matrix_, begin_;
  DeviceBuffer<int2> renumbered_;
  DeviceBuffer<unsigned char> split_;
  DeviceBuffer<HalfSpring> half_;
  std::size_t scratch_bytes_ = 0;
  DeviceBuffer<unsigned char> scratch_;
};

}  // namespace gpuphys::springs
