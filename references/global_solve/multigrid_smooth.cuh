// One pass of the multigrid cycle over a large level, in a single sweep through memory:
//
//     [x += P e]   red half-sweep   black half-sweep   [r = rhs - A x, |r|^2, coarse rhs = sum of r over
//     children]
//
// Half-sweeps are red-black successive over-relaxation over the whole grid, exactly as if each were a launch
// of its own: the result does not depend on the tiling. Smoothing that stops at tile borders would be cheaper
// per pass but takes twice the cycles.
//
// Mapping: a block owns a tile of rows x 64 columns of the (y, z) plane with a halo of one cell per stage,
// and marches along x. A thread owns four neighbouring columns in z; one more warp drives the bulk tensor
// copy engine, which streams the planes of all arrays into rings of shared-memory slots, two planes ahead,
// and fills in zeros outside the grid. The stages follow each other with one plane's lag: in step s the block
// takes over plane s, relaxes the red cells of plane s-1, the black cells of plane s-2 and takes the residual
// of plane s-3. What a stage uses of neighbouring columns was written at least one step earlier, and what it
// needs from its own column is in registers.
//
// What bounds it: the way up, loads (measured without any arithmetic it is as fast); the way down, which has
// a wider halo and one more stage, shared-memory loads and latency within a step. Six arrays are read and one
// is written per pass, where separate launches would move three times that. The halo is recomputed and costs
// L2 rather than DRAM traffic. docs/lab/global_solve.md has the numbers.
#pragma once

#include <cuda.h>

#include <type_traits>

#include "references/global_solve/multigrid_level.cuh"
#include "references/global_solve/multigrid_pieces.cuh"

namespace gpuphys::multigrid {

struct SmoothPolicy {
  static constexpr int columns = 64;  // of a tile, without halo
  static constexpr int halo_z = 4;    // one float4 on each side, at least the number of stages
  static constexpr int width = columns + 2 * halo_z;
  static constexpr int quads = width / 4;
  static constexpr int coarse_slots = 4;
  static constexpr int e_width =
      width / 2 + 4;                     // of a coarse tile: one more cell on each side, in 16-byte units
  static constexpr int gates_lead = 12;  // the copy engine fetches bytes from multiples of 16 only
  static constexpr int gates_width = e_width + 24;
  static constexpr int barriers = 4;
};

/// Shape of a pass's tile. `kRows` counts the rows a block updates.
template <int kRows, bool kProlong, bool kRestrict>
struct SmoothTile {
  static constexpr int halo = kRestrict ? 3 : 2;  // stages that look at neighbours
  static constexpr int rows = kRows + 2 * halo;
  static constexpr int x_slots = halo + 3;    // planes s-halo .. s+2 of x
  static constexpr int row_slots = halo + 2;  // planes s-halo .. s+1 of the matrix and the right-hand side
  static constexpr int floats = rows * SmoothPolicy::width;
  static constexpr int plane_bytes = (floats * 4 + 127) / 128 * 128;
  static constexpr int e_rows = kProlong ? rows / 2 + 2 : 0;
  static constexpr int e_bytes = (e_rows * SmoothPolicy::e_width * 4 + 127) / 128 * 128;
  static constexpr int gates_bytes = (e_rows * SmoothPolicy::gates_width + 127) / 128 * 128;
  static constexpr int plane_floats = plane_bytes / 4;
  static constexpr int workers = (rows * SmoothPolicy::quads + 31) / 32 * 32;
  static constexpr int threads = workers + 32;  // the last warp drives the copy engine
  static constexpr int shared_bytes =
      256 + plane_bytes * (x_slots + 5 * row_slots) + (e_bytes + gates_bytes) * SmoothPolicy::coarse_slots;
  static_assert(kRows % 2 == 0 && halo < SmoothPolicy::halo_z && shared_bytes < 227 * 1024);
};

/// Tensor maps of everything a pass reads.
struct SmoothMaps {
  CUtensorMap ax, ay, az, diag, rhs, x, e, gates;
};

struct SmoothArgs {
  SmoothMaps maps;
  int nx, ny, nz, pitch;
  int from_zero;  // x starts as zero and is not read
  float* x_out;
  const float* rhs_scale;  // device scalar
  const float* rhs_shift;  // device scalar, subtracted from the scaled right-hand side of active cells
  float* coarse_rhs;
  int coarse_ny, coarse_pitch;
  float* partials;       // per block: sums of r^2, rhs^2 and, over active cells, x; null: not wanted
  const int* done;       // the pass does nothing when set
  int planes_per_block;  // even
  const Piece* pieces;   // one for each block; null: all tiles, planes_per_block each
  float omega[2];        // relaxation of red and black cells
  float correction;      // factor of the restricted residual, hence of the correction that comes of it
};

__device__ __forceinline__ unsigned shared_address(const void* p) {
  return static_cast<unsigned>(__cvta_generic_to_shared(p));
}
__device__ __forceinline__ void barrier_init(std::uint64_t* barrier) {
  asm volatile("mbarrier.init.shared::cta.b64 [%0], 1;" ::"r"(shared_address(barrier)) : "memory");
}
__device__ __forceinline__ void barrier_expect(std::uint64_t* barrier, int bytes) {
  asm volatile("mbarrier.arrive.expect_tx.shared::cta.b64 _, [%0], %1;" ::"r"(shared_address(barrier)),
               "r"(bytes)
               : "memory");
}
__device__ __forceinline__ void barrier_wait(std::uint64_t* barrier, unsigned parity) {
  asm volatile(
      "{\n"
      ".reg .pred done;\n"
      "wait:\n"
      "mbarrier.try_wait.parity.shared::cta.b64 done, [%0], %1;\n"
      "@!done bra wait;\n"
      "}\n" ::"r"(shared_address(barrier)),
      "r"(parity)
      : "memory");
}
/// Copies the box at (k, j, i) of a tensor into shared memory; what lies outside arrives as zero.
__device__ __forceinline__ void copy_box(void* to, const CUtensorMap& map, int k, int j, int i,
                                         std::uint64_t* barrier) {
  asm volatile(
      "cp.async.bulk.tensor.3d.shared::cluster.global.mbarrier::complete_tx::bytes [%0], [%1, {%2, %3, %4}], "
      "[%5];" ::"r"(shared_address(to)),
      "l"(&map), "r"(k), "r"(j), "r"(i), "r"(shared_address(barrier))
      : "memory");
}

/// The slot of a plane in a ring; planes start at -5.
__device__ __forceinline__ int slot_of(int plane, int slots) {
  return (plane + 8 * slots) % slots;
}

/// 1 / v to within an ulp or two. Where it is used it steers the iteration and cannot move its limit.
__device__ __forceinline__ float reciprocal(float v) {
  float r;
  asm("rcp.approx.f32 %0, %1;" : "=f"(r) : "f"(v));
  return r;
}

__device__ __forceinline__ void load4(float (&v)[4], const float* p) {
  const float4 q = *reinterpret_cast<const float4*>(p);
  v[0] = q.x, v[1] = q.y, v[2] = q.z, v[3] = q.w;
}
__device__ __forceinline__ void store4(float* p, const float (&v)[4]) {
  *reinterpret_cast<float4*>(p) = make_float4(v[0], v[1], v[2], v[3]);
}

/// `kHeldWalls`: there may be faces at which the solution is held at zero.
template <int kRows, bool kProlong, bool kRestrict, bool kHeldWalls>
__global__ void __launch_bounds__(SmoothTile<kRows, kProlong, kRestrict>::threads, 1)
    smooth(const __grid_constant__ SmoothArgs g) {
  using P = SmoothPolicy;
  using T = SmoothTile<kRows, kProlong, kRestrict>;
  extern __shared__ __align__(128) unsigned char shared[];
  __shared__ std::uint64_t barriers[P::barriers];
  __shared__ float2 pair[2][kRestrict ? T::rows * P::quads : 1];
  __shared__ float warp_sums[3][T::workers / 32];
  if (*g.done) return;

  // The copy engine wants 128-byte slots; cells at the tile's corners look one element beyond their slot.
  unsigned char* const base = shared + 128 + (128 - shared_address(shared) % 128) % 128;
  const auto x_slot = [&](int plane) {
    return reinterpret_cast<float*>(base + T::plane_bytes * slot_of(plane, T::x_slots));
  };
  // Array 0..4: ax, ay, az, diag, rhs.
  const auto row_slot = [&](int array, int plane) {
    return reinterpret_cast<float*>(base +
                                    T::plane_bytes * (T::x_slots + 5 * slot_of(plane, T::row_slots) + array));
  };
  unsigned char* const coarse_base = base + T::plane_bytes * (T::x_slots + 5 * T::row_slots);
  const auto e_slot = [&](int plane) {
    return reinterpret_cast<float*>(coarse_base + T::e_bytes * slot_of(plane, P::coarse_slots));
  };
  const auto gates_slot = [&](int plane) {
    return coarse_base + T::e_bytes * P::coarse_slots + T::gates_bytes * slot_of(plane, P::coarse_slots);
  };

  Piece piece{static_cast<int>(blockIdx.y), static_cast<int>(blockIdx.x),
              static_cast<int>(blockIdx.z) * g.planes_per_block, 0};
  piece.end = min(piece.begin + g.planes_per_block, g.nx);
  if (g.pieces) piece = g.pieces[blockIdx.x];
  const int j0 = piece.y * kRows - T::halo;
  const int k0 = piece.z * P::columns - P::halo_z;
  const int begin = piece.begin, end = piece.end;
  const int first = begin - T::halo - (T::halo & 1), last = end - 1 + T::halo;  // first is even
  const int thread = static_cast<int>(threadIdx.x);

  if (thread == T::workers) {
    for (int n = 0; n < P::barriers; ++n) barrier_init(&barriers[n]);
    asm volatile("fence.mbarrier_init.release.cluster;" ::: "memory");
    asm volatile("fence.proxy.async.shared::cta;" ::: "memory");
  }
  __syncthreads();

  // The last warp feeds the others. Group n: plane n of x, plane n-1 of the matrix rows, and at odd n the
  // coarse plane that step n is first to use.
  if (thread >= T::workers) {
    const auto request = [&](int n) {
      std::uint64_t* barrier = &barriers[(n - first) % P::barriers];
      int bytes = 5 * T::floats * 4;
      if (!g.from_zero) bytes += T::floats * 4;
      const int coarse_bytes = T::e_rows * (P::e_width * 4 + P::gates_width);
      if (kProlong && (n & 1)) bytes += coarse_bytes;
      if (kProlong && n == first) bytes += 2 * coarse_bytes;
      barrier_expect(barrier, bytes);
      if (!g.from_zero) copy_box(x_slot(n), g.maps.x, k0, j0, n, barrier);
      const CUtensorMap* rows[5] = {&g.maps.ax, &g.maps.ay, &g.maps.az, &g.maps.diag, &g.maps.rhs};
#pragma unroll
      for (int a = 0; a < 5; ++a) copy_box(row_slot(a, n - 1), *rows[a], k0, j0, n - 1, barrier);
      if constexpr (kProlong) {
        const auto coarse = [&](int plane) {
          copy_box(e_slot(plane), g.maps.e, k0 / 2 - 2, j0 / 2 - 1, plane, barrier);
          copy_box(gates_slot(plane), g.maps.gates, k0 / 2 - 2 - P::gates_lead, j0 / 2 - 1, plane, barrier);
        };
        if (n & 1) coarse((n + 1) / 2);
        if (n == first) coarse(first / 2), coarse(first / 2 - 1);
      }
    };
    for (int s = first - 2; s <= last; ++s) {
      if (thread == T::workers && s + 2 <= last) request(s + 2);
      if (s >= first) __syncthreads();
    }
  } else {
    const bool works = thread < T::rows * P::quads;
    const int row = works ? thread / P::quads : 0, quad = works ? thread % P::quads : 0;
    const int j = j0 + row, k = k0 + 4 * quad, lane = thread % 32;
    const bool exists = works && j >= 0 && j < g.ny && k >= 0 && k < g.nz;
    const bool owned = exists && row >= T::halo && row < T::halo + kRows && quad >= 1 && quad < P::quads - 1;
    const float scale = *g.rhs_scale, shift = *g.rhs_shift;
    const int mine = row * P::width + 4 * quad;
    // Rows at the tile's rim have no neighbours there; what they compute is never used.
    const int up = row + 1 < T::rows ? P::width : 0, down = row > 0 ? -P::width : 0;
    float* const x_base = reinterpret_cast<float*>(base);
    const float* const rows_base = x_base + T::x_slots * T::plane_floats;

    // What the cells of one plane need besides x on the neighbouring planes.
    struct Plane {
      float ax[4], diag[4], rhs[4];
    };
    // rhs - A x without the coupling to the next plane. `p` is filled from shared memory where kLoad.
    const auto partial = [&]<bool kLoad>(std::bool_constant<kLoad>, float(&r)[4], Plane& p,
                                         const float(&ax_low)[4], const float(&x)[4], const float(&x_low)[4],
                                         int x_at, int rows_at) {
      const float* xs = x_base + x_at + mine;
      const float* rows = rows_base + rows_at + mine;
      float c[4], n[4], az[4];
      if constexpr (kLoad) {
        load4(p.ax, rows);
        load4(p.diag, rows + 3 * T::plane_floats);
        load4(p.rhs, rows + 4 * T::plane_floats);
#pragma unroll
        for (int e = 0; e < 4; ++e) p.rhs[e] = p.diag[e] > 0.0f ? scale * p.rhs[e] - shift : 0.0f;
      }
      load4(az, rows + 2 * T::plane_floats);
      float az_before = __shfl_up_sync(0xffffffffu, az[3], 1), before = __shfl_up_sync(0xffffffffu, x[3], 1);
      float after = __shfl_down_sync(0xffffffffu, x[0], 1);
      if (lane == 0) az_before = rows[2 * T::plane_floats - 1], before = xs[-1];
      if (lane == 31) after = xs[4];
      const float az_low[4] = {az_before, az[0], az[1], az[2]};
      const float z_low[4] = {before, x[0], x[1], x[2]}, z_high[4] = {x[1], x[2], x[3], after};
#pragma unroll
      for (int e = 0; e < 4; ++e) {
        r[e] = p.rhs[e] - p.diag[e] * x[e];
        r[e] -= ax_low[e] * x_low[e];
        r[e] -= az[e] * z_high[e];
        r[e] -= az_low[e] * z_low[e];
      }
      load4(c, rows + T::plane_floats);
      load4(n, xs + up);
#pragma unroll
      for (int e = 0; e < 4; ++e) r[e] -= c[e] * n[e];
      load4(c, rows + T::plane_floats + down);
      load4(n, xs + down);
#pragma unroll
      for (int e = 0; e < 4; ++e) r[e] -= c[e] * n[e];
    };
    // Relaxes the cells of one colour; (i + j + k) even is red (0). k of the first cell is a multiple of
    // four.
    const auto relax = [&](float(&x)[4], float(&r)[4], const Plane& p, const float(&x_high)[4], int i,
                           int colour) {
#pragma unroll
      for (int e = 0; e < 4; ++e) r[e] -= p.ax[e] * x_high[e];
      const bool odd = ((i + j + colour) & 1) != 0;
      const float omega = g.omega[colour];
      const float r0 = odd ? r[1] : r[0], r1 = odd ? r[3] : r[2];
      const float d0 = odd ? p.diag[1] : p.diag[0], d1 = odd ? p.diag[3] : p.diag[2];
      const float step0 = d0 > 0.0f ? omega * reciprocal(d0) * r0 : 0.0f;
      const float step1 = d1 > 0.0f ? omega * reciprocal(d1) * r1 : 0.0f;
      x[0] += odd ? 0.0f : step0;
      x[1] += odd ? step0 : 0.0f;
      x[2] += odd ? 0.0f : step1;
      x[3] += odd ? step1 : 0.0f;
    };
    const auto correct = [&](float(&x)[4], int i) {
      // The tile's coarse part starts at (j0/2 - 1, k0/2 - 2); j0 may be odd only without prolongation.
      const int at = ((row >> 1) + 1) * P::e_width + 2 * quad + 2;
      const unsigned char* gates =
          gates_slot(i >> 1) + ((row >> 1) + 1) * P::gates_width + P::gates_lead + 2 * quad + 2;
      const unsigned g0 = gates[0], g1 = gates[1];
      const float* e = e_slot(i >> 1) + at;
      const float* along_x = e_slot((i >> 1) + (i & 1 ? 1 : -1)) + at;
      const float* along_y = e + (j & 1 ? P::e_width : -P::e_width);
      const unsigned gate_x = i & 1 ? 1u : 2u, gate_y = j & 1 ? 4u : 8u;
      const float p0 = e[0], p1 = e[1];
      const bool in_x0 = g0 & gate_x, in_x1 = g1 & gate_x, in_y0 = g0 & gate_y, in_y1 = g1 & gate_y;
      const float x0 = in_x0 ? along_x[0] : p0, x1 = in_x1 ? along_x[1] : p1;
      const float y0 = in_y0 ? along_y[0] : p0, y1 = in_y1 ? along_y[1] : p1;
      const float wall0 = kHeldWalls ? wall_weight(g0) : 1.0f, wall1 = kHeldWalls ? wall_weight(g1) : 1.0f;
      const float w0 = (in_x0 ? 1.0f : wall0) * (in_y0 ? 1.0f : wall0);
      const float w1 = (in_x1 ? 1.0f : wall1) * (in_y1 ? 1.0f : wall1);
      const auto add = [](float& to, float weight, bool coupled, float wall, float correction) {
        to += weight * (coupled ? 1.0f : wall) * correction;
      };
      add(x[0], w0, g0 & 32u, wall0, interpolate(p0, x0, y0, g0 & 32u ? e[-1] : p0));
      add(x[1], w0, g0 & 16u, wall0, interpolate(p0, x0, y0, g0 & 16u ? p1 : p0));
      add(x[2], w1, g1 & 32u, wall1, interpolate(p1, x1, y1, g1 & 32u ? p0 : p1));
      add(x[3], w1, g1 & 16u, wall1, interpolate(p1, x1, y1, g1 & 16u ? e[2] : p1));
    };

    // x1 is plane s-1 and so on, likewise p1; ax4 couples plane s-4 to plane s-3.
    float x0[4] = {}, x1[4] = {}, x2[4] = {}, x3[4] = {}, x4[4] = {}, ax4[4] = {};
    Plane p1{}, p2{}, p3{};
    int x_slot0 = slot_of(first, T::x_slots), x_at1 = slot_of(first - 1, T::x_slots) * T::plane_floats,
        x_at2 = slot_of(first - 2, T::x_slots) * T::plane_floats,
        x_at3 = slot_of(first - 3, T::x_slots) * T::plane_floats;
    int row_slot1 = slot_of(first - 1, T::row_slots), rows_at2 = 0, rows_at3 = 0;
    float sum_r2 = 0, sum_rhs2 = 0, sum_x = 0;
    float2 children = make_float2(0.0f, 0.0f);
    int flushed = 0, pending_plane = -1;
    const auto flush = [&] {
      if (owned && (row - T::halo) % 2 == 0) {
        const float2 a = pair[flushed & 1][thread], b = pair[flushed & 1][thread + P::quads];
        float* to =
            g.coarse_rhs + ((pending_plane >> 1) * g.coarse_ny + (j >> 1)) * g.coarse_pitch + (k >> 1);
        *reinterpret_cast<float2*>(to) = make_float2(g.correction * (a.x + b.x), g.correction * (a.y + b.y));
      }
      pending_plane = -1;
      ++flushed;
    };

    for (int s = first; s <= last; ++s) {
      barrier_wait(&barriers[(s - first) % P::barriers],
                   static_cast<unsigned>((s - first) / P::barriers) & 1u);
      const int x_at0 = x_slot0 * T::plane_floats, rows_at1 = row_slot1 * 5 * T::plane_floats;
      if (!g.from_zero) load4(x0, x_base + x_at0 + mine);
      if (g.from_zero) x0[0] = x0[1] = x0[2] = x0[3] = 0.0f;
      if constexpr (kProlong) {
        if (exists && s >= 0 && s < g.nx) correct(x0, s);
      }
      // All that the stages of this step read from shared memory was written before the last barrier.
      float r1[4], r2[4], r3[4];
      partial(std::true_type{}, r1, p1, p2.ax, x1, x2, x_at1, rows_at1);
      partial(std::false_type{}, r2, p2, p3.ax, x2, x3, x_at2, rows_at2);
      if constexpr (kRestrict) partial(std::false_type{}, r3, p3, ax4, x3, x4, x_at3, rows_at3);

      relax(x1, r1, p1, x0, s - 1, 0);  // red cells of plane s-1
      relax(x2, r2, p2, x1, s - 2, 1);  // black cells of plane s-2
      // A neighbour's quad that was read above holds cells of both colours. Only those that do not change in
      // this step were used, but the quad is stored whole: all loads of the step come before all of its
      // stores.
      asm volatile("bar.sync 1, %0;" ::"n"(T::workers) : "memory");
      if (works) {
        if (kProlong || g.from_zero) store4(x_base + x_at0 + mine, x0);
        store4(x_base + x_at1 + mine, x1);
        if constexpr (kRestrict) store4(x_base + x_at2 + mine, x2);
      }
      bool in_piece;  // the way up spills a register if asked about both ends one by one, the way down else
      if constexpr (kRestrict) {
        in_piece = s - 2 >= begin && s - 2 < end;
      } else {
        in_piece = static_cast<unsigned>(s - first - 2 - (T::halo + (T::halo & 1))) <
                   static_cast<unsigned>(end - begin);
      }
      if (owned && in_piece) {
        store4(g.x_out + ((s - 2) * g.ny + j) * g.pitch + k, x2);
#pragma unroll
        for (int e = 0; e < 4; ++e) sum_x += p2.diag[e] > 0.0f ? x2[e] : 0.0f;
      }
      if constexpr (kRestrict) {
        if (pending_plane >= 0) flush();
        const int i = s - 3;  // the residual of this plane
        if (i >= begin && i < end) {
#pragma unroll
          for (int e = 0; e < 4; ++e) r3[e] -= p3.ax[e] * x2[e];
          if (owned) {
#pragma unroll
            for (int e = 0; e < 4; ++e) sum_r2 += r3[e] * r3[e], sum_rhs2 += p3.rhs[e] * p3.rhs[e];
          }
          children.x += r3[0] + r3[1];
          children.y += r3[2] + r3[3];
          if ((i & 1) || i == g.nx - 1) {
            if (works) pair[flushed & 1][thread] = exists ? children : make_float2(0.0f, 0.0f);
            children = make_float2(0.0f, 0.0f);
            pending_plane = i;
          }
        }
      }
#pragma unroll
      for (int e = 0; e < 4; ++e) {
        ax4[e] = p3.ax[e];
        x4[e] = x3[e], x3[e] = x2[e], x2[e] = x1[e], x1[e] = x0[e];
      }
      p3 = p2, p2 = p1;
      x_at3 = x_at2, x_at2 = x_at1, x_at1 = x_at0, rows_at3 = rows_at2, rows_at2 = rows_at1;
      x_slot0 = x_slot0 + 1 == T::x_slots ? 0 : x_slot0 + 1;
      row_slot1 = row_slot1 + 1 == T::row_slots ? 0 : row_slot1 + 1;
      // The slots read in this step are next written by the copy engine.
      asm volatile("fence.proxy.async.shared::cta;" ::: "memory");
      __syncthreads();
    }
    if constexpr (kRestrict) {
      if (pending_plane >= 0) flush();
    }
    {
      if (g.partials) {
#pragma unroll
        for (int offset = 16; offset; offset >>= 1) {
          sum_r2 += __shfl_down_sync(0xffffffffu, sum_r2, offset);
          sum_rhs2 += __shfl_down_sync(0xffffffffu, sum_rhs2, offset);
          sum_x += __shfl_down_sync(0xffffffffu, sum_x, offset);
        }
        if (lane == 0) {
          warp_sums[0][thread / 32] = sum_r2;
          warp_sums[1][thread / 32] = sum_rhs2;
          warp_sums[2][thread / 32] = sum_x;
        }
      }
    }
  }
  {
    if (g.partials) {
      __syncthreads();
      if (thread < 3) {
        float sum = 0;
        for (int w = 0; w < T::workers / 32; ++w) sum += warp_sums[thread][w];
        const int block = static_cast<int>((blockIdx.z * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x);
        g.partials[3 * block + thread] = sum;
      }
    }
  }
}

}  // namespace gpuphys::multigrid
