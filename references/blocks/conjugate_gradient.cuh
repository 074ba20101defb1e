// Conjugate gradients on the device, three components a particle, preconditioned by a diagonal; the
// coefficients never visit the host. The matrix is the caller's: a function that launches q = A p.
//
// An iteration is: q = A p; the curvature p.q and with it alpha; x, r and the sums of the new residual, and
// with them beta; the next direction. Sums end in the block that finishes last, in a fixed order; it alone
// writes the coefficients. When the residual is small enough or the curvature is not positive, a flag is set
// and whatever kernels are still queued return at once: the host queues kBatch iterations before it looks at
// the flag. A first direction of negative curvature is itself the result, later ones end the iteration before
// them, so x is a direction of descent in any case.
//
// Newton's method evaluates the true residual after each solve and starts the next from it, so that rounding
// of r, which is updated here, does not pile up over solves.
//
// What bounds it: the product, and 13 vectors of 16 bytes a particle otherwise.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"

namespace gpuphys::cg {

constexpr int kThreads = 256;
constexpr int kBatch = 16;

struct State {
  float rz, alpha, beta;
  float residual2;  ///< |r|^2
  float target2;
  int status;  ///< 0 under way, 1 done, 2 the last update is still to come
  int iterations;
  unsigned finished;  ///< blocks of the kernel under way
};

/// Sums of the block's threads and, in the block that comes last, of all blocks: true there, in thread 0.
template <int Sums>
__device__ __forceinline__ bool sum_everything(float (&sum)[Sums], float* partials, unsigned* finished) {
  __shared__ float warps[Sums][kThreads / 32];
  __shared__ bool last;
  const int thread = static_cast<int>(threadIdx.x);
  const auto add_block = [&] {
#pragma unroll
    for (int q = 0; q < Sums; ++q) {
#pragma unroll
      for (int offset = 16; offset > 0; offset /= 2) sum[q] += __shfl_down_sync(0xffffffffu, sum[q], offset);
      if (thread % 32 == 0) warps[q][thread / 32] = sum[q];
    }
    __syncthreads();
#pragma unroll
    for (int q = 0; q < Sums; ++q) {
      sum[q] = thread < kThreads / 32 ? warps[q][thread] : 0.0f;
      if (thread < 32) {
#pragma unroll
        for (int offset = 16; offset > 0; offset /= 2)
          sum[q] += __shfl_down_sync(0xffffffffu, sum[q], offset);
      }
    }
    __syncthreads();
  };
  add_block();
  if (thread == 0) {
#pragma unroll
    for (int q = 0; q < Sums; ++q) partials[q * gridDim.x + blockIdx.x] = sum[q];
    __threadfence();
    last = atomicAdd(finished, 1u) + 1u == gridDim.x;
  }
  __syncthreads();
  if (!last) return false;
  __threadfence();
#pragma unroll
  for (int q = 0; q < Sums; ++q) {
    sum[q] = 0.0f;
    for (unsigned b = threadIdx.x; b < gridDim.x; b += kThreads)
      sum[q] += __ldcg(partials + q * gridDim.x + b);
  }
  add_block();
  if (thread == 0) *finished = 0;
  return thread == 0;
}

__device__ __forceinline__ float dot(const float4& a, const float4& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
__device__ __forceinline__ float4 times(const float4& a, const float4& b) {
  return make_float4(a.x * b.x, a.y * b.y, a.z * b.z, 0.0f);
}
__device__ __forceinline__ float4 plus(const float4& a, float s, const float4& b) {
  return make_float4(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z, 0.0f);
}

/// The vectors of a solve; (n) each.
struct Vectors {
  const float4* inverse_diagonal;
  float4 *r, *p, *q, *x;
};

/// From r = b: x = 0, p = D^-1 r. The target is the larger of a part of |b| and `least2` (squares).
__global__ void __launch_bounds__(kThreads)
    begin(Vectors v, int n, float part2, float least2, float* __restrict__ partials, State* state) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float sum[2] = {0.0f, 0.0f};
  if (i < n) {
    const float4 r = v.r[i], p = times(v.inverse_diagonal[i], r);
    v.x[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    v.p[i] = p;
    sum[0] = dot(r, p);
    sum[1] = dot(r, r);
  }
  if (!sum_everything(sum, partials, &state->finished)) return;
  state->rz = sum[0];
  state->residual2 = sum[1];
  state->target2 = fmaxf(part2 * sum[1], least2);
  state->iterations = 0;
  state->status = sum[1] <= state->target2 ? 1 : 0;
}

__global__ void __launch_bounds__(kThreads)
    curvature(Vectors v, int n, float* __restrict__ partials, State* state) {
  if (state->status != 0) return;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float sum[1] = {i < n ? dot(v.p[i], v.q[i]) : 0.0f};
  if (!sum_everything(sum, partials, &state->finished)) return;
  if (sum[0] > 0.0f) {
    state->alpha = state->rz / sum[0];
  } else {
    state->alpha = state->iterations == 0 ? 1.0f : 0.0f;
    state->status = 2;
  }
}

__global__ void __launch_bounds__(kThreads)
    update(Vectors v, int n, float* __restrict__ partials, State* state) {
  if (state->status == 1) return;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const float alpha = state->alpha;
  float sum[2] = {0.0f, 0.0f};
  if (i < n) {
    v.x[i] = plus(v.x[i], alpha, v.p[i]);
    const float4 r = plus(v.r[i], -alpha, v.q[i]);
    v.r[i] = r;
    sum[0] = dot(r, times(v.inverse_diagonal[i], r));
    sum[1] = dot(r, r);
  }
  if (!sum_everything(sum, partials, &state->finished)) return;
  state->beta = sum[0] / state->rz;
  state->rz = sum[0];
  state->residual2 = sum[1];
  state->iterations += 1;
  if (state->status == 2 || sum[1] <= state->target2) state->status = 1;
}

__global__ void __launch_bounds__(kThreads) turn(Vectors v, int n, const State* state) {
  if (state->status != 0) return;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i < n) v.p[i] = plus(times(v.inverse_diagonal[i], v.r[i]), state->beta, v.p[i]);
}

class Solver {
 public:
  Solver() = default;
  explicit Solver(int n)
      : n_(n),
        p_(size()),
        q_(size()),
        x_(size()),
        partials_(2 * static_cast<std::size_t>(blocks())),
        state_(1),
        host_(1) {
    GPUPHYS_CUDA(cudaMemset(state_.get(), 0, sizeof(State)));
  }

  /// Solves A x = r until |r| is `part` of what it was or `least`, for at most `most` iterations. `apply(p,
  /// q, state)` launches q = A p, which may be left out where state->status is not 0. r is overwritten; the
  /// result is valid until the next call.
  template <class Apply>
  const float4* solve(float4* r, const float4* inverse_diagonal, float part, float least, int most,
                      Apply&& apply) const {
    const Vectors v{inverse_diagonal, r, p_.get(), q_.get(), x_.get()};
    State* const state = state_.get();
    begin<<<blocks(), kThreads>>>(v, n_, part * part, least * least, partials_.get(), state);
    for (int done = 0; done < most; done += kBatch) {
      for (int k = 0; k < kBatch; ++k) {
        apply(v.p, v.q, state);
        curvature<<<blocks(), kThreads>>>(v, n_, partials_.get(), state);
        update<<<blocks(), kThreads>>>(v, n_, partials_.get(), state);
        turn<<<blocks(), kThreads>>>(v, n_, state);
      }
      if (read().status == 1) break;
    }
    return x_.get();
  }

  /// Waits for the device.
  const State& read() const {
    GPUPHYS_CUDA(cudaMemcpy(host_.get(), state_.get(), sizeof(State), cudaMemcpyDeviceToHost));
    return *host_.get();
  }

 private:
  std::size_t size() const { return static_cast<std::size_t>(n_); }
  unsigned blocks() const { return static_cast<unsigned>((n_ + kThreads - 1) / kThreads); }

  int n_ = 0;
  DeviceBuffer<float4> p_, q_, x_;
  DeviceBuffer<float> partials_;
  DeviceBuffer<State> state_;
  PinnedBuffer<State> host_;
};

}  // namespace gpuphys::cg
