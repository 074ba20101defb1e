// Solves A x = b for A = diag(mass) + L as laplacian_rows.cuh has it, three right-hand sides at once, to a
// given part of the error that x = 0 has.
//
// Chebyshev's semi-iteration on D^-1 A, D the diagonal of A:
//   x' = x_before + omega (x - x_before + gamma D^-1 (b - A x)).
// It takes no scalar products: one kernel an iteration, no sums over the device, nothing that visits the
// host. What it takes are bounds of the spectrum, and here they are rigorous and cheap: L >= 0 gives the
// lower one, min mass_i / D_i, rows (Gershgorin) the upper one, max (1 + sum |w_ij| / D_i). They are read
// back once for all solves with a matrix, since the number of iterations, that is of launches, follows from
// them: after N the error, in the norm of A, is below 1 / T_N((b + a) / (b - a)) of what it was. Conjugate
// gradients would take fewer iterations, of twice the traffic and three launches each.
//
// b - A x is formed anew in each iteration, so that rounding does not pile up. What bounds an iteration: the
// bytes of a row's entries and of four vectors, from the L2 or device memory.
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>

#include "references/blocks/laplacian_rows.cuh"

namespace gpuphys::chebyshev {

/// What the iteration needs of a matrix besides its rows. As unsigned integers, positive floats keep their
/// order.
struct Bounds {
  std::uint32_t least, most;
};

__global__ void __launch_bounds__(256) clear_bounds(Bounds* bounds) {
  if (threadIdx.x == 0) *bounds = {0x7f7fffffu, 0u};
}

__global__ void __launch_bounds__(256)
    find_bounds(rows::Rows a, float* __restrict__ inverse_diagonal, Bounds* __restrict__ bounds) {
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < a.n;
  float sum = 0.0f, size = 0.0f;
  if (there) {
    for (int e = a.first[i] + lane; e < a.first[i + 1]; e += rows::kLanes) {
      const float w = a.weight_of(e);
      sum += w;
      size += fabsf(w);
    }
  }
  sum = rows::sum_lanes(sum);
  size = rows::sum_lanes(size);
  const float mass = there ? a.mass[i] : 1.0f, diagonal = there ? mass + sum : 1.0f;
  if (there && lane == 0) inverse_diagonal[i] = 1.0f / diagonal;
  std::uint32_t least = there ? __float_as_uint(mass / diagonal) : 0x7f7fffffu;
  std::uint32_t most = there ? __float_as_uint(1.0f + size / diagonal) : 0u;
#pragma unroll
  for (int offset = 16; offset > 0; offset /= 2) {
    least = min(least, __shfl_xor_sync(0xffffffffu, least, offset));
    most = max(most, __shfl_xor_sync(0xffffffffu, most, offset));
  }
  if (threadIdx.x % 32 == 0) {
    atomicMin(&bounds->least, least);
    atomicMax(&bounds->most, most);
  }
}

/// x_1 = gamma D^-1 b.
__global__ void __launch_bounds__(256)
    first_step(const float4* __restrict__ b, const float* __restrict__ inverse_diagonal, int n, float gamma,
               float4* __restrict__ x) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float s = gamma * inverse_diagonal[i];
  const float4 r = b[i];
  x[i] = make_float4(s * r.x, s * r.y, s * r.z, 0.0f);
}

/// `before` becomes the next iterate.
__global__ void __launch_bounds__(256)
    step(rows::Rows a, const float4* __restrict__ b, const float* __restrict__ inverse_diagonal, float omega,
         float gamma, bool from_zero, const float4* __restrict__ x, float4* __restrict__ before) {
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < a.n;
  const float4 own = there ? x[i] : make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  float ax = 0.0f, ay = 0.0f, az = 0.0f;
  if (there) {
    const int end = a.first[i + 1];
#pragma unroll 2
    for (int e = a.first[i] + lane; e < end; e += rows::kLanes) {
      const float w = a.weight_of(e);
      const float4 other = x[a.other[e]];
      ax += w * (own.x - other.x);
      ay += w * (own.y - other.y);
      az += w * (own.z - other.z);
    }
  }
  ax = rows::sum_lanes(ax);
  ay = rows::sum_lanes(ay);
  az = rows::sum_lanes(az);
  if (!there || lane != 0) return;
  const float mass = a.mass[i], s = gamma * inverse_diagonal[i];
  const float4 r = b[i], old = from_zero ? make_float4(0.0f, 0.0f, 0.0f, 0.0f) : before[i];
  before[i] = make_float4(old.x + omega * (own.x - old.x + s * (r.x - (mass * own.x + ax))),
                          old.y + omega * (own.y - old.y + s * (r.y - (mass * own.y + ay))),
                          old.z + omega * (own.z - old.z + s * (r.z - (mass * own.z + az))), 0.0f);
}

class Solver {
 public:
  Solver() = default;
  explicit Solver(int n) : inverse_diagonal_(static_cast<std::size_t>(n)), bounds_(1) {
    for (DeviceBuffer<float4>& x : x_) x = DeviceBuffer<float4>(static_cast<std::size_t>(n));
  }

  /// To be called once for a matrix. The only wait for the device.
  void prepare(const rows::Rows& a, double part_of_error) {
    a_ = a;
    clear_bounds<<<1, 32>>>(bounds_.get());
    find_bounds<<<blocks(rows::kLanes), kThreads>>>(a, inverse_diagonal_.get(), bounds_.get());
    float extremes[2];
    GPUPHYS_CUDA(cudaMemcpy(extremes, bounds_.get(), sizeof(extremes), cudaMemcpyDeviceToHost));
    const double least = static_cast<double>(extremes[0]) * (1 - 1e-5);
    const double most = static_cast<double>(extremes[1]) * (1 + 1e-5);
    gamma_ = 2 / (most + least);
    rho_ = (most - least) / (most + least);
    steps_ = static_cast<int>(std::ceil(std::acosh(1 / part_of_error) / std::acosh(1 / rho_)));
    if (steps_ < 1) steps_ = 1;
  }

  /// The solution, valid until the next call.
  const float4* solve(const float4* b) const {
    const float gamma = static_cast<float>(gamma_);
    float4* x = x_[0].get();
    float4* before = x_[1].get();
    first_step<<<blocks(1), kThreads>>>(b, inverse_diagonal_.get(), a_.n, gamma, x);
    double omega = 2;
    for (int k = 1; k < steps_; ++k) {
      omega = 1 / (1 - rho_ * rho_ * omega / 4);
      step<<<blocks(rows::kLanes), kThreads>>>(a_, b, inverse_diagonal_.get(), static_cast<float>(omega),
                                               gamma, k == 1, x, before);
      std::swap(x, before);
    }
    return x;
  }

  int steps() const { return steps_; }

 private:
  static constexpr int kThreads = 256;
  unsigned blocks(int threads_each) const {
    return static_cast<unsigned>((static_cast<std::int64_t>(threads_each) * a_.n + kThreads - 1) / kThreads);
  }

  rows::Rows a_{};
  DeviceBuffer<float> inverse_diagonal_;
  DeviceBuffer<Bounds> bounds_;
  DeviceBuffer<float4> x_[2];
  double gamma_ = 0, rho_ = 0;
  int steps_ = 0;
};

}  // namespace gpuphys::chebyshev
