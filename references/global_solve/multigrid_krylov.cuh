// Whole-vector kernels around the multigrid cycle: scaling of the right-hand side, true residual, and one
// step of a truncated flexible GCR (generalised conjugate residual) iteration. All reductions have a fixed
// order.
#pragma once

#include "references/global_solve/multigrid_smooth.cuh"

namespace gpuphys::multigrid {

struct KrylovPolicy {
  static constexpr int threads = 256;
  static constexpr int window = 4;         // directions a new one is made orthogonal to
  static constexpr int sums = window + 3;  // most sums a kernel forms at once
  static constexpr int max_blocks = 4096;  // of a kernel that writes partial sums
};

/// What the device knows about the solve. Kernels read it, the small reduction kernels write it.
struct State {
  float scale;      // b is multiplied by this power of two
  float shift;      // mean of scale*b over the active cells if the system is singular, which no x can reach
  float one, zero;  // scale and shift of right-hand sides that need none
  float inverse_active;
  float rhs2, r2;  // |b|^2 and |b - A x|^2, scaled
  float mean;      // of x over the active cells
  float alpha;     // step along the new direction
  float beta[KrylovPolicy::window];
  float q2[KrylovPolicy::window];  // |A d|^2 of the kept directions
  int done;                        // the tolerance is met, or there is nothing to solve
  int active;
};

template <int kSums>
__device__ __forceinline__ void write_block_sums(float (&sum)[kSums], float* partials) {
  __shared__ float warps[kSums][KrylovPolicy::threads / 32];
  const int thread = static_cast<int>(threadIdx.x);
#pragma unroll
  for (int q = 0; q < kSums; ++q) {
#pragma unroll
    for (int offset = 16; offset; offset >>= 1) sum[q] += __shfl_down_sync(0xffffffffu, sum[q], offset);
    if (thread % 32 == 0) warps[q][thread / 32] = sum[q];
  }
  __syncthreads();
  if (thread < kSums) {
    float total = 0;
    for (int w = 0; w < KrylovPolicy::threads / 32; ++w) total += warps[thread][w];
    partials[blockIdx.x * kSums + thread] = total;
  }
}

// Sums `blocks` rows of kSums partials; the result is valid in thread 0 of a block of 1024.
template <int kSums>
__device__ __forceinline__ void sum_partials(float (&sum)[kSums], const float* partials, int blocks) {
  __shared__ float warps[kSums][32];
  const int thread = static_cast<int>(threadIdx.x);
#pragma unroll
  for (int q = 0; q < kSums; ++q) {
    sum[q] = 0;
    for (int b = thread; b < blocks; b += 1024) sum[q] += partials[b * kSums + q];
#pragma unroll
    for (int offset = 16; offset; offset >>= 1) sum[q] += __shfl_down_sync(0xffffffffu, sum[q], offset);
    if (thread % 32 == 0) warps[q][thread / 32] = sum[q];
  }
  __syncthreads();
  if (thread < 32) {
#pragma unroll
    for (int q = 0; q < kSums; ++q) {
      sum[q] = warps[q][thread];
#pragma unroll
      for (int offset = 16; offset; offset >>= 1) sum[q] += __shfl_down_sync(0xffffffffu, sum[q], offset);
    }
  }
}

/// Largest |b|, sum of b and number of active cells, per block.
__global__ void __launch_bounds__(KrylovPolicy::threads)
    scan_input(const float* b, const bool* active, int cells, float* largest, float* sums, int* counts) {
  __shared__ float warp_largest[KrylovPolicy::threads / 32];
  __shared__ float warp_sums[KrylovPolicy::threads / 32];
  __shared__ int warp_counts[KrylovPolicy::threads / 32];
  const int thread = static_cast<int>(threadIdx.x);
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  float m = 0, sum = 0;
  int n = 0;
  const int quads = cells / 4;
  const int first = static_cast<int>(blockIdx.x * blockDim.x) + thread;
  for (int q = first; q < quads; q += stride) {
    const float4 v = __ldg(reinterpret_cast<const float4*>(b) + q);
    const unsigned flags = __ldg(reinterpret_cast<const unsigned*>(active) + q);
    m = fmaxf(fmaxf(fmaxf(m, fabsf(v.x)), fabsf(v.y)), fmaxf(fabsf(v.z), fabsf(v.w)));
    sum += (v.x + v.y) + (v.z + v.w);
    n += __popc(flags);  // a bool is 0 or 1
  }
  for (int q = 4 * quads + first; q < cells; q += stride) {
    m = fmaxf(m, fabsf(b[q]));
    sum += b[q];
    n += active[q] ? 1 : 0;
  }
#pragma unroll
  for (int offset = 16; offset; offset >>= 1) {
    m = fmaxf(m, __shfl_down_sync(0xffffffffu, m, offset));
    sum += __shfl_down_sync(0xffffffffu, sum, offset);
    n += __shfl_down_sync(0xffffffffu, n, offset);
  }
  if (thread % 32 == 0)
    warp_largest[thread / 32] = m, warp_sums[thread / 32] = sum, warp_counts[thread / 32] = n;
  __syncthreads();
  if (thread == 0) {
    for (int w = 1; w < KrylovPolicy::threads / 32; ++w) {
      m = fmaxf(m, warp_largest[w]);
      sum += warp_sums[w];
      n += warp_counts[w];
    }
    largest[blockIdx.x] = m;
    sums[blockIdx.x] = sum;
    counts[blockIdx.x] = n;
  }
}

/// Starts the state of a solve from the partial results of scan_input().
__global__ void __launch_bounds__(1024) begin_solve(State* state, const float* largest, const float* sums,
                                                    const int* counts, int blocks, bool singular) {
  __shared__ float warp_largest[32];
  __shared__ int warp_counts[32];
  const int thread = static_cast<int>(threadIdx.x);
  float sum[1];
  sum_partials(sum, sums, blocks);
  float m = thread < blocks ? largest[thread] : 0.0f;
  int n = thread < blocks ? counts[thread] : 0;
#pragma unroll
  for (int offset = 16; offset; offset >>= 1) {
    m = fmaxf(m, __shfl_down_sync(0xffffffffu, m, offset));
    n += __shfl_down_sync(0xffffffffu, n, offset);
  }
  if (thread % 32 == 0) warp_largest[thread / 32] = m, warp_counts[thread / 32] = n;
  __syncthreads();
  if (thread != 0) return;
  for (int w = 1; w < 32; ++w) m = fmaxf(m, warp_largest[w]), n += warp_counts[w];
  *state = State{};
  int exponent = 0;
  if (m > 0) frexpf(m, &exponent);
  state->scale = ldexpf(1.0f, min(126, max(-126, -exponent)));
  state->one = 1.0f;
  state->active = n;
  state->inverse_active = n > 0 ? 1.0f / static_cast<float>(n) : 0.0f;
  const float mean = sum[0] * state->inverse_active * state->scale;
  state->shift = singular && isfinite(mean) ? mean : 0.0f;
  state->done = m > 0 ? 0 : 1;
}

/// After a pass with partial sums of r^2, rhs^2 and x: norms, mean and the decision to stop.
__global__ void __launch_bounds__(1024) judge_cycle(State* state, State* host, const float* partials,
                                                    int blocks, float tolerance, bool singular) {
  if (state->done) {
    if (threadIdx.x == 0) *host = *state;
    return;
  }
  float sum[3];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x != 0) return;
  state->r2 = sum[0];
  state->rhs2 = sum[1];
  state->mean = singular ? sum[2] * state->inverse_active : 0.0f;
  if (sum[0] < tolerance * tolerance * sum[1]) state->done = 1;
  *host = *state;
}

/// Rows of nz entries to rows of `pitch` entries, the rest zero.
__global__ void __launch_bounds__(KrylovPolicy::threads)
    pad_rows(const float* from, float* to, int rows, int nz, int pitch) {
  const int stride = static_cast<int>(gridDim.x * blockDim.x);
  for (int q = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); q < rows * pitch; q += stride) {
    const int row = q / pitch, k = q - row * pitch;
    to[q] = k < nz ? from[row * nz + k] : 0.0f;
  }
}

// Four cells of one row, for kernels without tiling: neighbours come through L1 and L2.
struct QuadWalk {
  const Matrix& a;
  int quads_per_row, quads;
  __device__ explicit QuadWalk(const Matrix& m)
      : a(m), quads_per_row((m.nz + 3) / 4), quads(m.nx * m.ny * quads_per_row) {}

  // A x of the quad at `at`, with x shifted by -mean (the couplings to cells that do not exist are zero).
  // As differences: the excess of the diagonal over the couplings times x, and each coupling times the
  // difference to the neighbour. What hangs together strongly and is held weakly has an x many times the
  // terms that have to cancel. The excess is summed without error.
  __device__ void multiply(float (&product)[4], float (&x)[4], const float* v, float mean, int i, int j,
                           int k, int at) const {
    float c[4], n[4];
    const auto load = [&](float(&to)[4], int where) {
      load4(to, v + where);
#pragma unroll
      for (int e = 0; e < 4; ++e) to[e] -= mean;
    };
    load(x, at);
    load4(c, a.diag + at);
    float sum[4] = {}, excess[4], error[4] = {};
#pragma unroll
    for (int e = 0; e < 4; ++e) excess[e] = c[e];
    const auto add_one = [&](int e, float coupling, float neighbour) {
      sum[e] += coupling * (neighbour - x[e]);
      const float before = excess[e];
      excess[e] = before + coupling;
      const float added = excess[e] - before;
      error[e] += (before - (excess[e] - added)) + (coupling - added);
    };
    const auto add = [&](const float* coupling, int coupling_at, int neighbour) {
      float w[4];
      load4(w, coupling + coupling_at);
      load(n, neighbour);
#pragma unroll
      for (int e = 0; e < 4; ++e) add_one(e, w[e], n[e]);
    };
    if (i + 1 < a.nx) add(a.ax, at, at + a.plane());
    if (i > 0) add(a.ax, at - a.plane(), at - a.plane());
    if (j + 1 < a.ny) add(a.ay, at, at + a.pitch);
    if (j > 0) add(a.ay, at - a.pitch, at - a.pitch);
    float w[4];
    load4(w, a.az + at);
    const float after = k + 4 < a.nz ? v[at + 4] - mean : 0.0f;
    const float before = k > 0 ? v[at - 1] - mean : 0.0f;
    const float before_w = k > 0 ? a.az[at - 1] : 0.0f;
    add_one(0, before_w, before);
    add_one(3, w[3], after);
#pragma unroll
    for (int e = 0; e < 3; ++e) {
      add_one(e, w[e], x[e + 1]);
      add_one(e + 1, w[e], x[e]);
    }
#pragma unroll
    for (int e = 0; e < 4; ++e) product[e] = (excess[e] + error[e]) * x[e] + sum[e];
  }

  template <class Body>
  __device__ void each(Body&& body) const {
    const int stride = static_cast<int>(gridDim.x * blockDim.x);
    for (int q = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); q < quads; q += stride) {
      const int row = q / quads_per_row, k = 4 * (q - row * quads_per_row);
      const int i = row / a.ny, j = row - i * a.ny;
      body(i, j, k, a.at(i, j, k));
    }
  }
};

/// r = b' - A x and |r|^2, |b'|^2, sum of x over active cells, for b' = scale*b - shift.
__global__ void __launch_bounds__(KrylovPolicy::threads)
    replace_residual(Matrix a, const float* b, const float* x, float* r, const State* state,
                     float* partials) {
  const QuadWalk walk(a);
  const float scale = state->scale, shift = state->shift;
  float sum[3] = {};
  walk.each([&](int i, int j, int k, int at) {
    float product[4], v[4], rhs[4], res[4], diag[4];
    walk.multiply(product, v, x, 0.0f, i, j, k, at);
    load4(rhs, b + at);
    load4(diag, a.diag + at);
#pragma unroll
    for (int e = 0; e < 4; ++e) {
      const float target = diag[e] > 0 ? scale * rhs[e] - shift : 0.0f;
      res[e] = target - product[e];
      sum[0] += res[e] * res[e];
      sum[1] += target * target;
      sum[2] += diag[e] > 0 ? v[e] : 0.0f;
    }
    store4(r + at, res);
  });
  write_block_sums(sum, partials);
}

/// The solution as it is returned, mean removed, exactly zero on inactive cells, in the units of b; and its
/// true residual: |r|^2, |scale*b|^2 (and zero, to suit judge_cycle()). `kSkipInactive`: nothing more is read
/// where four cells in a row are inactive, after a look that delays the rest.
template <bool kSkipInactive = false>
__global__ void __launch_bounds__(KrylovPolicy::threads)
    write_solution(Matrix a, const float* b, const float* x, const bool* active, float* out,
                   const State* state, float* partials) {
  const QuadWalk walk(a);
  const float scale = state->scale, mean = state->mean, unscale = 1.0f / scale;
  float sum[3] = {};
  walk.each([&](int i, int j, int k, int at) {
    const int to = (i * a.ny + j) * a.nz + k;  // `active` and `out` have no padding
    if (kSkipInactive && a.pitch == a.nz && __ldg(reinterpret_cast<const unsigned*>(active + to)) == 0) {
      *reinterpret_cast<float4*>(out + to) = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
      return;
    }
    float product[4], v[4], rhs[4], result[4] = {};
    walk.multiply(product, v, x, mean, i, j, k, at);
    load4(rhs, b + at);
#pragma unroll
    for (int e = 0; e < 4; ++e) {
      if (k + e >= a.nz) continue;
      const float res = scale * rhs[e] - product[e];
      if (active[to + e]) {
        sum[0] += res * res;
        sum[1] += (scale * rhs[e]) * (scale * rhs[e]);
        result[e] = v[e] * unscale;
      } else {
        result[e] = 0.0f;
      }
    }
    if (a.pitch == a.nz) {
      store4(out + to, result);
    } else {
#pragma unroll
      for (int e = 0; e < 4; ++e)
        if (k + e < a.nz) out[to + e] = result[e];
    }
  });
  write_block_sums(sum, partials);
}

/// After a pass with partial sums of which the third is that of x: the mean.
__global__ void __launch_bounds__(1024)
    judge_mean(State* state, const float* partials, int blocks, bool singular) {
  float sum[3];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x == 0) state->mean = singular ? sum[2] * state->inverse_active : 0.0f;
}

/// After write_solution(): whether the solution as returned meets the tolerance.
__global__ void __launch_bounds__(1024)
    judge_solution(State* state, State* host, const float* partials, int blocks, float tolerance) {
  float sum[3];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x != 0) return;
  state->r2 = sum[0];
  state->rhs2 = sum[1];
  state->done = sum[0] < tolerance * tolerance * sum[1] ? 1 : 0;
  *host = *state;
}

/// After replace_residual(): norms and mean.
__global__ void __launch_bounds__(1024)
    judge_residual(State* state, State* host, const float* partials, int blocks, bool singular) {
  float sum[3];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x != 0) return;
  state->r2 = sum[0];
  state->rhs2 = sum[1];
  state->mean = singular ? sum[2] * state->inverse_active : 0.0f;
  state->done = 0;
  *host = *state;
}

struct Directions {
  float* d[KrylovPolicy::window + 1];  // the last one is the new direction
  float* q[KrylovPolicy::window + 1];  // A d
  int kept;
};

/// q = A d for the new direction, and its products with itself, with r and with the kept ones.
__global__ void __launch_bounds__(KrylovPolicy::threads)
    apply_direction(Matrix a, Directions s, const float* d, float* q, const float* r, float* partials) {
  const QuadWalk walk(a);
  float sum[KrylovPolicy::sums] = {};
  walk.each([&](int i, int j, int k, int at) {
    float product[4], v[4], res[4];
    walk.multiply(product, v, d, 0.0f, i, j, k, at);
    load4(res, r + at);
#pragma unroll
    for (int e = 0; e < 4; ++e) {
      sum[0] += product[e] * product[e];
      sum[1] += product[e] * res[e];
    }
#pragma unroll
    for (int w = 0; w < KrylovPolicy::window; ++w) {
      if (w >= s.kept) continue;
      float old[4];
      load4(old, s.q[w] + at);
#pragma unroll
      for (int e = 0; e < 4; ++e) sum[2 + w] += product[e] * old[e];
    }
    store4(q + at, product);
  });
  write_block_sums(sum, partials);
}

/// Coefficients of the orthogonalisation and the step that minimises |r - alpha q|.
__global__ void __launch_bounds__(1024)
    choose_step(State* state, const float* partials, int blocks, int kept) {
  float sum[KrylovPolicy::sums];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x != 0) return;
  float q2 = sum[0];
  for (int w = 0; w < KrylovPolicy::window; ++w) {
    state->beta[w] = w < kept && state->q2[w] > 0 ? sum[2 + w] / state->q2[w] : 0.0f;
    q2 -= state->beta[w] * sum[2 + w];
  }
  // A direction that the kept ones already span brings nothing but rounding noise.
  const bool usable = q2 > 1e-10f * sum[0];
  const float alpha = usable ? sum[1] / q2 : 0.0f;
  state->alpha = isfinite(alpha) ? alpha : 0.0f;
}

/// Makes the new direction orthogonal to the kept ones, then x += alpha d, r -= alpha q. Sums |r|^2, sum of x
/// over active cells, |q|^2.
__global__ void __launch_bounds__(KrylovPolicy::threads)
    take_step(Matrix a, Directions s, float* d, float* q, float* x, float* r, const State* state,
              float* partials) {
  const QuadWalk walk(a);
  const float alpha = state->alpha;
  float sum[3] = {};
  walk.each([&](int, int, int, int at) {
    float nd[4], nq[4], nx[4], nr[4], diag[4];
    load4(nd, d + at);
    load4(nq, q + at);
#pragma unroll
    for (int w = 0; w < KrylovPolicy::window; ++w) {
      if (w >= s.kept) continue;
      float od[4], oq[4];
      load4(od, s.d[w] + at);
      load4(oq, s.q[w] + at);
      const float beta = state->beta[w];
#pragma unroll
      for (int e = 0; e < 4; ++e) nd[e] -= beta * od[e], nq[e] -= beta * oq[e];
    }
    load4(nx, x + at);
    load4(nr, r + at);
    load4(diag, a.diag + at);
#pragma unroll
    for (int e = 0; e < 4; ++e) {
      if (alpha != 0.0f) {  // a useless direction must not spoil x: it may not even be finite
        nx[e] += alpha * nd[e];
        nr[e] -= alpha * nq[e];
      }
      sum[0] += nr[e] * nr[e];
      sum[1] += nq[e] * nq[e];
      sum[2] += diag[e] > 0 ? nx[e] : 0.0f;
    }
    store4(d + at, nd);
    store4(q + at, nq);
    store4(x + at, nx);
    store4(r + at, nr);
  });
  write_block_sums(sum, partials);
}

/// After take_step(): norms as the recurrence has them, for the host to decide upon.
__global__ void __launch_bounds__(1024)
    judge_step(State* state, State* host, const float* partials, int blocks, int slot, bool singular) {
  float sum[3];
  sum_partials(sum, partials, blocks);
  if (threadIdx.x != 0) return;
  state->r2 = sum[0];
  state->q2[slot] = sum[1];
  state->mean = singular ? sum[2] * state->inverse_active : 0.0f;
  *host = *state;
}

}  // namespace gpuphys::multigrid
