// Springs sorted for iterations that run tile by tile, from springs in arbitrary order, without global
// atomics to speak of and without stores to random places of device memory.
//
// Particles are renumbered by the caller (spatial_order.cuh); a tile is 2^shift consecutive numbers. Every
// spring appears twice, as a half-spring of each end. A tile lists the particles outside of it that its
// half-springs lead to, its halo: a block can then hold all ends in shared memory, and a half-spring names
// its other end by a 16-bit place there. What neither tile nor halo holds (long random connections) is far,
// and named in an array of its own.
//
// Half-springs of a particle make a row. `32 / lanes` rows make a slice, for one warp, `lanes` threads a row:
// the k-th half-spring of row p stands at 32 (k / lanes) + lanes p + k % lanes, so that a warp reads 32
// neighbours at a time. A slice that this would fill up by less than half (a particle with very many springs)
// has its rows one after the other instead.
//
// Two passes: (1) blocks take chunks of springs, renumber the ends, sort the half-springs by tile in shared
// memory, and write the sorted chunk as it is, with the place where each tile's run begins; (2) a block a
// tile collects the tile's runs from all chunks, counts rows, finds the halo by hashing, and sorts in shared
// memory. A tile that this does not hold is sorted in place in device memory, which is slower.
//
// What bounds it, bytes a spring of device memory: 12 and 16 in pass 1, 16 to 24 (runs begin and end inside
// sectors) and 12 in pass 2; and in pass 1 two random 4-byte numbers out of the L2.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <stdexcept>

#include "references/common/block_sum.cuh"
#include "references/common/device_buffer.cuh"

namespace gpuphys::springs {

/// The thread's lane, read anew: derived from threadIdx.x it would take a register of loops that have none to
/// spare.
__device__ __forceinline__ int read_lane() {
  int lane;
  asm volatile("mov.u32 %0, %%laneid;" : "=r"(lane));
  return lane;
}

/// Particles in two arrays: an iteration writes displacements only, and neighbours share sectors.
struct Particles {
  float4* base;  ///< (n): position before the solve, m, and inverse mass, 1/kg
  float4* step;  ///< (n): displacement so far, m, and the bits of an integer, the number of half-springs
};

constexpr int kMaxTiles = 1 << 14;      // counters of split_by_tile take 64 KB of shared memory
constexpr std::uint16_t kFar = 0xffff;  ///< instead of a place: the other end is in neither tile nor halo

/// A half-spring on its way to its tile, with its particle's place in the tile.
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

/// Lays down the particles in their new order, each followed by zeros to fill a sector: random writes of half
/// a sector take 51 us instead of 31, as the L2 reads such a sector first. Two threads a particle; number[i]
/// becomes the new number of particle i. Clears what the build of the tiles begins with: `used`, and `halo`,
/// of which a tile's unused part then names some particle, which may be fetched for nothing.
__global__ void place_particles(const float* __restrict__ x, const float* __restrict__ inv_mass,
                                const int2* __restrict__ cell_and_place,
                                const std::int32_t* __restrict__ first, int n,
                                std::int32_t* __restrict__ number, float4* __restrict__ placed,
                                std::int32_t* __restrict__ halo, int halo_size, int* used) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x), i = t / 2;
  if (t == 0) *used = 0;
  for (int k = t; k < halo_size; k += static_cast<int>(gridDim.x * blockDim.x)) halo[k] = 0;
  if (i >= n) return;
  const int2 where = cell_and_place[i];
  const int to = first[where.x] + where.y;
  float4 part = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  if (t % 2 == 0) {
    number[i] = to;
    part = make_float4(x[3 * i], x[3 * i + 1], x[3 * i + 2], inv_mass[i]);
  }
  placed[2 * to + t % 2] = part;
}

/// The springs j0 + u * Threads + threadIdx.x below m; behind them springs from particle 0 to itself.
template <int Threads, int Items>
__device__ __forceinline__ void load_springs(const int2* __restrict__ ends, const float* __restrict__ rest,
                                             int j0, int m, int2 (&e)[Items], float (&length)[Items]) {
#pragma unroll
  for (int u = 0; u < Items; ++u) {
    const int j = j0 + u * Threads + static_cast<int>(threadIdx.x);
    e[u] = j < m ? __ldcs(ends + j) : int2{0, 0};
    length[u] = j < m ? __ldcs(rest + j) : 0.0f;
  }
}

/// Shared memory of split_by_tile, bytes.
template <class Record>
constexpr std::size_t split_bytes(int chunk, int tiles) {
  return sizeof(Record) * 2 * static_cast<std::size_t>(chunk) +
         sizeof(int) * (static_cast<std::size_t>(tiles) + 1);
}

/// Pass 1: the half-springs of chunk c in order of tiles, at split[2 c chunk]; those of tile t begin
/// table[c][t] behind, and end at table[c][t + 1]. A spring from a particle to itself does not count. The
/// next chunk is on its way while this one is written.
template <class Record, int Threads, int Items>
__global__ void __launch_bounds__(Threads)
    split_by_tile(const int2* __restrict__ ends, const float* __restrict__ rest,
                  const std::int32_t* __restrict__ number, int m, int chunks, int shift, int tiles,
                  Record* __restrict__ split, std::uint16_t* __restrict__ table) {
  constexpr int chunk = Threads * Items;  // springs
  extern __shared__ int4 pool[];
  __shared__ int warp_sum[32], total;
  Record* const sorted = reinterpret_cast<Record*>(pool);
  int* const count = reinterpret_cast<int*>(sorted + 2 * chunk);  // then where the tile begins in the chunk
  const int tid = static_cast<int>(threadIdx.x), mask = (1 << shift) - 1;
  const int a_thread = (tiles + Threads) / Threads;  // counters, of which there are tiles + 1
  const int from = min(tid * a_thread, tiles + 1), until = min(from + a_thread, tiles + 1);
  for (int t = tid; t <= tiles; t += Threads) count[t] = 0;
  const int first = static_cast<int>(blockIdx.x);
  int2 e[Items];
  float length[Items];
  load_springs<Threads, Items>(ends, rest, first * chunk, m, e, length);
#pragma unroll
  for (int u = 0; u < Items; ++u) e[u] = int2{number[e[u].x], number[e[u].y]};
  __syncthreads();
  for (int c = first; c < chunks; c += static_cast<int>(gridDim.x)) {
    int rank[Items];  // of both ends among the chunk's half-springs of the tile, 16 bits each
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
    for (int t = from; t < until; ++t) mine += count[t];
    int before = sum_before<Threads>(mine, warp_sum);
    for (int t = from; t < until; ++t) {
      const int here = count[t];
      count[t] = before;
      before += here;
    }
    if (tid == Threads - 1) total = before;
    __syncthreads();
#pragma unroll
    for (int u = 0; u < Items; ++u) {
      if (e[u].x == e[u].y) continue;
      sorted[count[e[u].x >> shift] + (rank[u] & 0xffff)] = Record::of(e[u].x & mask, e[u].y, length[u]);
      sorted[count[e[u].y >> shift] + (rank[u] >> 16)] = Record::of(e[u].y & mask, e[u].x, length[u]);
    }
    // Behind the last chunk there is nothing to load.
    const int next = min(c + static_cast<int>(gridDim.x), chunks);
    load_springs<Threads, Items>(ends, rest, next * chunk, m, e, length);
    __syncthreads();
    std::uint16_t* const begins = table + static_cast<std::size_t>(c) * static_cast<std::size_t>(tiles + 1);
    for (int t = tid; t <= tiles; t += Threads) {
      begins[t] = static_cast<std::uint16_t>(count[t]);
      count[t] = 0;
    }
    const int filled = total;
    for (int k = tid; k < filled; k += Threads) split[2 * chunk * c + k] = sorted[k];
#pragma unroll
    for (int u = 0; u < Items; ++u) e[u] = int2{number[e[u].x], number[e[u].y]};
    __syncthreads();
  }
}

/// Calls `use` with every record of a tile, a record a call, in all threads of the block together. `run` (as
/// many as threads) is shared. `Again`: the block has done this before, and left `run` as it was.
template <class Record, int Threads, bool Again, class Use>
__device__ __forceinline__ void for_each_record(const Record* __restrict__ split,
                                                const std::uint16_t* __restrict__ table, int chunks, int room,
                                                int tiles, int tile, std::uint32_t* run, Use&& use) {
  // Runs have 16 records in the mean: 8 lanes go idle less than 16 would, and three parts hold most runs.
  constexpr int lanes = 8, groups = Threads / lanes, parts = 3;
  const int tid = static_cast<int>(threadIdx.x);
  const int lane = read_lane() % lanes;
  for (int c0 = 0; c0 < chunks; c0 += Threads) {
    __syncthreads();
    if (!Again || chunks > Threads) {
      std::uint32_t begin_and_length = 0;
      if (c0 + tid < chunks) {
        const std::uint16_t* const begins =
            table + static_cast<std::size_t>(c0 + tid) * static_cast<std::size_t>(tiles + 1) + tile;
        const std::uint32_t begin = begins[0], end = begins[1];
        begin_and_length = begin << 16 | (end - begin);
      }
      run[tid] = begin_and_length;
      __syncthreads();
    }
    const int here = min(Threads, chunks - c0);
    for (int r = tid / lanes; r < here; r += groups) {
      const std::uint32_t code = run[r];
      const int length = static_cast<int>(code & 0xffffu);
      const Record* const from = split + ((c0 + r) * room + static_cast<int>(code >> 16) + lane);
      Record record[parts];
#pragma unroll
      for (int part = 0; part < parts; ++part) {
        if (lane + part * lanes < length) record[part] = from[part * lanes];
      }
#pragma unroll
      for (int part = 0; part < parts; ++part) {
        if (lane + part * lanes < length) use(record[part]);
      }
      for (int k = parts * lanes; lane + k < length; k += lanes) use(from[k]);
    }
  }
}

/// A set of particles in shared memory, hashed by groups of 32 consecutive ones: neighbours in space are
/// neighbours in number, so groups are few, the table is nearly empty, and a warp seldom tries a second slot.
/// Double hashing, some tries; what finds no room is left out.
template <int Slots>
struct Halo {
  static_assert((Slots & (Slots - 1)) == 0);
  static constexpr int kTries = 32, kEmpty = -1;
  int* key;                ///< (Slots): group, or kEmpty
  std::uint32_t* members;  ///< (Slots): a bit a particle of the group
  std::uint16_t* before;   ///< (Slots): members of the slots before; once numbered

  __device__ __forceinline__ void insert(int particle) {
    const int group = particle >> 5;
    const std::uint32_t hash = hash_of(group);
    for (int k = 0; k < kTries; ++k) {
      const int at = slot(hash, k), there = atomicCAS(key + at, kEmpty, group);
      if (there == kEmpty || there == group) {
        atomicOr(members + at, 1u << (particle & 31));
        return;
      }
    }
  }
  /// Number of a particle in the set, or -1.
  __device__ __forceinline__ int find(int particle) const {
    const int group = particle >> 5;
    const std::uint32_t hash = hash_of(group);
    for (int k = 0; k < kTries; ++k) {
      const int at = slot(hash, k), there = key[at];
      if (there == group) return before[at] + __popc(members[at] & ((1u << (particle & 31)) - 1u));
      if (there == kEmpty) break;
    }
    return -1;
  }

 private:
  __device__ __forceinline__ static std::uint32_t hash_of(int group) {
    return static_cast<std::uint32_t>(group) * 2654435769u;
  }
  __device__ __forceinline__ static int slot(std::uint32_t hash, int k) {
    return static_cast<int>((hash >> 20) + static_cast<std::uint32_t>(k) * (hash >> 7 | 1u)) & (Slots - 1);
  }
};

/// Springs sorted into tiles; sizes in TileShape. `slice` has where each slice begins (a multiple of 32),
/// plus one if its rows stand one after the other.
struct Tiles {
  std::int32_t* slice;       ///< (tiles, slices a tile)
  std::int32_t* halo;        ///< (tiles, kHalo): particles
  std::int32_t* halo_count;  ///< (tiles)
  std::uint16_t* local;  ///< (places): the other end, in the tile, or 2^shift + place in the halo, or kFar
  std::int32_t* far;     ///< (places): the other end where `local` is kFar
  float* rest;           ///< (places): m
};

/// 2^Shift particles a tile, `Lanes` threads a row, up to `Outside` particles in the halo.
template <int Shift, int Lanes, int Outside>
struct TileShape {
  static_assert(Lanes >= 2 && Lanes <= 32 && (Lanes & (Lanes - 1)) == 0, "rows within a warp");
  static constexpr int kShift = Shift, kParticles = 1 << Shift, kLanes = Lanes, kHalo = Outside;
  static constexpr int kRows = 32 / Lanes, kSlices = kParticles / kRows;
  static constexpr int kHeld = kParticles + kHalo;
  static constexpr int kSlots = 1024;  // of the hash table
  static_assert(kHeld < kFar);
};

/// Shared memory of build_tiles, bytes. `capacity` is even.
template <class Shape>
constexpr std::size_t build_bytes(int capacity, int threads) {
  return (sizeof(float) + sizeof(std::uint16_t)) * static_cast<std::size_t>(capacity) +
         2 * sizeof(int) * Shape::kParticles + (2 * sizeof(int) + sizeof(std::uint16_t)) * Shape::kSlots +
         sizeof(std::uint32_t) * static_cast<std::size_t>(threads);
}

/// Pass 2: block t builds tile t, in shared memory if it has up to `Capacity` places, and lays down its
/// particles, at rest and with the number of their half-springs. `used` (zero before) counts places given
/// out.
///
/// 32 registers a thread: where ptxas spills in the loops over the records, the kernel takes a quarter
/// longer, and so it does where the tries of the hash table are not unrolled.
template <class Record, class Shape, int Threads, int Capacity>
__global__ void __launch_bounds__(Threads)
    build_tiles(const Record* __restrict__ split, const std::uint16_t* __restrict__ table, int chunks,
                int room, int tiles, int n, int* __restrict__ used, Tiles out,
                const float4* __restrict__ placed, Particles laid) {
  static_assert(Shape::kSlices <= Threads && Capacity % 2 == 0);
  constexpr int lanes = Shape::kLanes, rows = Shape::kRows, slots_a_thread = Shape::kSlots / Threads;
  static_assert(Shape::kSlots % Threads == 0, "every thread numbers the halo of equally many slots");
  extern __shared__ int4 pool[];
  __shared__ int warp_sum[3][32], tile_begin, tile_places;
  float* const rest_at = reinterpret_cast<float*>(pool);
  std::uint16_t* const local_at = reinterpret_cast<std::uint16_t*>(rest_at + Capacity);
  int* const count = reinterpret_cast<int*>(local_at + Capacity);
  int* const row = count + Shape::kParticles;  // twice where the row begins in the tile; odd: not in turns
  std::uint32_t* const run = reinterpret_cast<std::uint32_t*>(row + Shape::kParticles);
  Halo<Shape::kSlots> outside;
  outside.key = reinterpret_cast<int*>(run + Threads);
  outside.members = reinterpret_cast<std::uint32_t*>(outside.key + Shape::kSlots);
  outside.before = reinterpret_cast<std::uint16_t*>(outside.members + Shape::kSlots);
  const int tid = static_cast<int>(threadIdx.x), tile = static_cast<int>(blockIdx.x);
  const int low = tile << Shape::kShift, particles = min(Shape::kParticles, n - low);
  for (int i = tid; i < Shape::kParticles; i += Threads) count[i] = 0;
  for (int i = tid; i < Shape::kSlots; i += Threads) {
    outside.key[i] = Halo<Shape::kSlots>::kEmpty;
    outside.members[i] = 0;
  }
  for_each_record<Record, Threads, false>(split, table, chunks, room, tiles, tile, run,
                                          [&](const Record& record) {
                                            atomicAdd(count + record.place(), 1);
                                            if (record.other() >> Shape::kShift != tile)
                                              outside.insert(record.other());
                                          });
  __syncthreads();
  // Numbers the halo.
  constexpr unsigned all = 0xffffffffu;
  const int lane = read_lane();
  int mine = 0;
#pragma unroll
  for (int k = 0; k < slots_a_thread; ++k) {
    mine += __popc(outside.members[tid * slots_a_thread + k]);
  }
  int before = sum_before<Threads>(mine, warp_sum[0]);
#pragma unroll
  for (int k = 0; k < slots_a_thread; ++k) {
    const int at = tid * slots_a_thread + k, group = outside.key[at];
    const std::uint32_t members = outside.members[at];
    outside.before[at] = static_cast<std::uint16_t>(before);  // no more than 32 a slot
    // Slots with members, which are few, take turns; a lane a member.
    for (std::uint32_t slots = __ballot_sync(all, members != 0); slots != 0; slots &= slots - 1) {
      const int slot = __ffs(static_cast<int>(slots)) - 1;
      const std::uint32_t bits = __shfl_sync(all, members, slot);
      const int to = __shfl_sync(all, before, slot) + __popc(bits & ((1u << lane) - 1u));
      const int particle = __shfl_sync(all, group, slot) * 32 + lane;
      if ((bits >> lane & 1u) != 0 && to < Shape::kHalo) out.halo[tile * Shape::kHalo + to] = particle;
    }
    before += __popc(members);
  }
  if (tid == Threads - 1) out.halo_count[tile] = min(before, Shape::kHalo);
  // Gives every slice its places.
  int longest = 0, sum = 0;
  if (tid < Shape::kSlices) {
    for (int q = 0; q < rows; ++q) {
      longest = max(longest, count[tid * rows + q]);
      sum += count[tid * rows + q];
    }
  }
  const int in_turns = (longest + lanes - 1) / lanes * 32;
  const bool ragged = in_turns > 2 * sum + 32;
  const int size = ragged ? (sum + 31) / 32 * 32 : in_turns;
  const int begin = sum_before<Threads>(size, warp_sum[1]);
  if (tid < Shape::kSlices) {
    int at = begin;
    for (int q = 0; q < rows; ++q) {
      row[tid * rows + q] = ragged ? 2 * at + 1 : 2 * (begin + q * lanes);
      at += count[tid * rows + q];
    }
  }
  if (tid == Threads - 1) {
    tile_places = begin + size;
    tile_begin = atomicAdd(used, begin + size);
  }
  __syncthreads();
  const int base = tile_begin, places = tile_places;
  const bool fits = places <= Capacity;
  if (tid < Shape::kSlices) out.slice[tile * Shape::kSlices + tid] = base + begin + (ragged ? 1 : 0);
  if (fits) {
    for (int k = tid; k < places; k += Threads) {
      rest_at[k] = 0.0f;
      local_at[k] = 0;
    }
  }
#pragma unroll 1  // unrolled, it spills registers of the loop below
  for (int k = tid; k < particles; k += Threads)
    laid.step[low + k] = make_float4(0.0f, 0.0f, 0.0f, __int_as_float(count[k]));
#pragma unroll 1
  for (int k = tid; k < particles; k += Threads) laid.base[low + k] = placed[2 * (low + k)];
  // for_each_record begins with a barrier.
  for_each_record<Record, Threads, true>(
      split, table, chunks, room, tiles, tile, run, [&](const Record& record) {
        const int i = record.place(), other = record.other();
        const auto k = static_cast<unsigned>(atomicSub(count + i, 1)) - 1u;
        const auto where = static_cast<unsigned>(row[i]);
        const unsigned turns = where % 2u != 0u ? 0u : k / lanes;
        const auto at = static_cast<int>(where / 2u + k + turns * (32u - lanes));
        auto local = static_cast<std::uint16_t>(other & (Shape::kParticles - 1));
        if (other >> Shape::kShift != tile) {
          const int place = outside.find(other);
          const bool near = place >= 0 && place < Shape::kHalo;
          local = near ? static_cast<std::uint16_t>(Shape::kParticles + place) : kFar;
          if (!near) out.far[base + at] = other;
        }
        if (fits) {
          rest_at[at] = record.rest;
          local_at[at] = local;
        } else {
          out.rest[base + at] = record.rest;
          out.local[base + at] = local;
        }
      });
  __syncthreads();
  if (!fits) return;
  for (int k = tid; k < places; k += Threads) out.rest[base + k] = rest_at[k];
  for (int k = tid; k < places / 2; k += Threads) {
    reinterpret_cast<std::uint32_t*>(out.local + base)[k] =
        reinterpret_cast<const std::uint32_t*>(local_at)[k];
  }
}

/// Tiles for up to `n` particles and `m` springs, in memory of its own. `Policy` gives the launches:
/// `split_blocks` of `split_threads` threads with `split_items` springs each at a time (half as many when
/// records are wide); `wide_records` to have them wide even where narrow ones do; `Tile`, a TileShape;
/// `build_threads` and `build_capacity` half-springs.
template <class Policy>
class SpringTiles {
 public:
  using Shape = typename Policy::Tile;

  SpringTiles() = default;
  SpringTiles(int n, int m) : n_(n), m_(m) {
    if (tiles() > kMaxTiles) throw std::runtime_error("more particles than the tiles of springs hold");
    wide_ =
        Policy::wide_records || n > 1 << NarrowRecord::kOtherBits || Shape::kShift > NarrowRecord::kPlaceBits;
    const std::size_t tiles_and_slices = static_cast<std::size_t>(tiles()) * Shape::kSlices;
    // A slice has at most twice as many places as half-springs, rounded up to a turn, and one turn more.
    places_ = 4 * static_cast<std::size_t>(m) + 64 * tiles_and_slices;
    placed_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(n));
    number_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(n));
    split_ =
        DeviceBuffer<unsigned char>((wide_ ? sizeof(WideRecord) : sizeof(NarrowRecord)) *
                                    static_cast<std::size_t>(chunks()) * static_cast<std::size_t>(room()));
    table_ = DeviceBuffer<std::uint16_t>(static_cast<std::size_t>(chunks()) *
                                         (static_cast<std::size_t>(tiles()) + 1));
    used_ = DeviceBuffer<int>(1);
    slice_ = DeviceBuffer<std::int32_t>(tiles_and_slices);
    halo_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(tiles()) * Shape::kHalo);
    halo_count_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(tiles()));
    local_ = DeviceBuffer<std::uint16_t>(places_);
    far_ = DeviceBuffer<std::int32_t>(places_);
    rest_ = DeviceBuffer<float>(places_);
    wide_ ? prepare<WideRecord>() : prepare<NarrowRecord>();
  }

  /// Sorts particles and springs; the particles, at rest, go to `laid`.
  void build(const int2* ends, const float* rest, const float* x, const float* inv_mass,
             const int2* cell_and_place, const std::int32_t* first, const Particles& laid) const {
    constexpr int threads = 256;
    place_particles<<<static_cast<unsigned>((2 * n_ + threads - 1) / threads), threads>>>(
        x, inv_mass, cell_and_place, first, n_, number_.get(), placed_.get(), halo_.get(),
        tiles() * Shape::kHalo, used_.get());
    wide_ ? sort<WideRecord>(ends, rest, laid) : sort<NarrowRecord>(ends, rest, laid);
  }

  int tiles() const { return ((n_ - 1) >> Shape::kShift) + 1; }
  std::size_t places() const { return places_; }                ///< an upper bound
  const std::int32_t* number() const { return number_.get(); }  ///< (n): the new number of each particle
  Tiles view() const {
    return {slice_.get(), halo_.get(), halo_count_.get(), local_.get(), far_.get(), rest_.get()};
  }

 private:
  static_assert(2 * Policy::split_threads * Policy::split_items <= 1 << 15, "ranks take 16 bits, signed");

  template <class Record>
  static constexpr int items = sizeof(Record) > 8 ? Policy::split_items / 2 : Policy::split_items;
  template <class Record>
  static constexpr auto split_kernel = split_by_tile<Record, Policy::split_threads, items<Record>>;
  template <class Record>
  static constexpr auto build_kernel =
      build_tiles<Record, Shape, Policy::build_threads, Policy::build_capacity>;

  int chunk() const { return Policy::split_threads * (wide_ ? items<WideRecord> : items<NarrowRecord>); }
  int chunks() const { return (m_ + chunk() - 1) / chunk(); }
  int room() const { return 2 * chunk(); }  // half-springs of a chunk
  template <class Record>
  std::size_t bytes_to_split() const {
    return split_bytes<Record>(chunk(), tiles());
  }
  static constexpr std::size_t bytes_to_build() {
    return build_bytes<Shape>(Policy::build_capacity, Policy::build_threads);
  }

  template <class Record>
  void prepare() const {
    GPUPHYS_CUDA(cudaFuncSetAttribute(split_kernel<Record>, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(bytes_to_split<Record>())));
    GPUPHYS_CUDA(cudaFuncSetAttribute(build_kernel<Record>, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                      static_cast<int>(bytes_to_build())));
  }

  template <class Record>
  void sort(const int2* ends, const float* rest, const Particles& laid) const {
    Record* const records = reinterpret_cast<Record*>(split_.get());
    if (chunks() > 0) {
      const auto blocks = static_cast<unsigned>(std::min(chunks(), Policy::split_blocks));
      split_kernel<Record><<<blocks, Policy::split_threads, bytes_to_split<Record>()>>>(
          ends, rest, number_.get(), m_, chunks(), Shape::kShift, tiles(), records, table_.get());
    }
    build_kernel<Record><<<static_cast<unsigned>(tiles()), Policy::build_threads, bytes_to_build()>>>(
        records, table_.get(), chunks(), room(), tiles(), n_, used_.get(), view(), placed_.get(), laid);
  }

  int n_ = 0, m_ = 0;
  bool wide_ = false;
  std::size_t places_ = 0;
  DeviceBuffer<float4> placed_;  // sectors: a particle at rest, and zeros
  DeviceBuffer<std::int32_t> number_;
  DeviceBuffer<unsigned char> split_;
  DeviceBuffer<std::uint16_t> table_, local_;
  DeviceBuffer<int> used_;
  DeviceBuffer<std::int32_t> slice_, halo_, halo_count_, far_;
  DeviceBuffer<float> rest_;
};

}  // namespace gpuphys::springs
