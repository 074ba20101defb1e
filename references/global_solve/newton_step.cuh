// Newton's method for implicit elastic steps: minimises Phi(u) = |u - dt v|^2_M / 2 + dt^2 E(x + u) until its
// gradient, at positions that float32 can hold, is `tol` of that at u = dt v.
//
// A step solves with the Hessian by conjugate gradients (conjugate_gradient.cuh), to a hundredth of the
// gradient or a fifth of the goal, whichever is larger; the gradient's own curvature leaves about as much.
// Then the step is halved until Phi does not rise. The host sees two numbers an evaluation, and decides.
#pragma once

#include <cmath>
#include <stdexcept>
#include <string>

#include "references/blocks/conjugate_gradient.cuh"
#include "references/global_solve/displaced_particles.cuh"

namespace gpuphys::newton {

/// What an evaluation gives.
struct Value {
  float energy;     ///< Phi; infinite where an element has turned over
  float gradient2;  ///< |grad Phi|^2
  unsigned finished;
};

/// moved = u + length step, rounded so that x + moved is a float32; without a step, u = target rounded.
__global__ void __launch_bounds__(cg::kThreads)
    move(const float4* __restrict__ position, const float4* from, const float4* __restrict__ step,
         float length, int n, float4* to) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float4 x = position[i];
  float4 u = from[i];
  if (step) u = cg::plus(u, length, step[i]);
  to[i] = make_float4((x.x + u.x) - x.x, (x.y + u.y) - x.y, (x.z + u.z) - x.z, 0.0f);
}

/// x_new = x + u, and v_new = (x_new - x) / dt of what x_new became, in the order of the inputs.
__global__ void __launch_bounds__(cg::kThreads)
    write_step(const float* __restrict__ x, const std::int32_t* __restrict__ number,
               const float4* __restrict__ moved, float dt, int n, float* __restrict__ x_new,
               float* __restrict__ v_new) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float4 u = moved[number[i]];
  const float now[3] = {x[3 * i] + u.x, x[3 * i + 1] + u.y, x[3 * i + 2] + u.z};
#pragma unroll
  for (int c = 0; c < 3; ++c) {
    x_new[3 * i + c] = now[c];
    v_new[3 * i + c] = (now[c] - x[3 * i + c]) / dt;
  }
}

class Newton {
 public:
  Newton() = default;
  explicit Newton(int n)
      : n_(n),
        solver_(n),
        residual_(static_cast<std::size_t>(n)),
        inverse_diagonal_(static_cast<std::size_t>(n)),
        trial_(static_cast<std::size_t>(n)),
        value_(1),
        host_(1) {
    GPUPHYS_CUDA(cudaMemset(value_.get(), 0, sizeof(Value)));
  }

  /// `elastic` launches, at the displacements given: evaluate(u, residual, value), which writes minus the
  /// gradient and the value; linearise(u, inverse_diagonal); apply(p, q, state) of the Hessian.
  template <class Elastic>
  void minimise(const displaced::Particles& p, float tol, const char* task, Elastic&& elastic) const {
    const unsigned blocks = (static_cast<unsigned>(n_) + cg::kThreads - 1) / cg::kThreads;
    elastic.evaluate(p.moved, residual_.get(), value_.get());
    const float goal = tol * std::sqrt(read().gradient2);
    if (!(goal > 0.0f)) return;
    float4* u = p.moved;
    float4* trial = trial_.get();
    move<<<blocks, cg::kThreads>>>(p.position, u, nullptr, 0.0f, n_, u);
    elastic.evaluate(u, residual_.get(), value_.get());
    Value now = read();
    for (int iteration = 0; std::sqrt(now.gradient2) > 0.99f * goal; ++iteration) {
      if (iteration == 100)
        throw std::runtime_error(std::string(task) + ": no convergence in 100 Newton steps");
      elastic.linearise(u, inverse_diagonal_.get());
      const float4* const step =
          solver_.solve(residual_.get(), inverse_diagonal_.get(), 0.01f, 0.2f * goal, 20000,
                        [&](const float4* direction, float4* q, const cg::State* state) {
                          elastic.apply(direction, q, state);
                        });
      Value there;
      float length = 1.0f;
      for (;; length *= 0.5f) {
        if (length < 1e-6f)
          throw std::runtime_error(std::string(task) + ": the line search found no lower energy");
        move<<<blocks, cg::kThreads>>>(p.position, u, step, length, n_, trial);
        elastic.evaluate(trial, residual_.get(), value_.get());
        there = read();
        if (there.energy <= now.energy + 4e-6f * std::fabs(now.energy)) break;
      }
      std::swap(u, trial);
      now = there;
    }
    if (u != p.moved)
      GPUPHYS_CUDA(cudaMemcpyAsync(p.moved, u, sizeof(float4) * static_cast<std::size_t>(n_),
                                   cudaMemcpyDeviceToDevice));
  }

  template <class Inputs, class Outputs>
  void write(const Inputs& in, const displaced::Body& body, const Outputs& out) const {
    write_step<<<(static_cast<unsigned>(n_) + cg::kThreads - 1) / cg::kThreads, cg::kThreads>>>(
        in.x.data, body.number(), body.particles().moved, in.dt, n_, out.x_new.data, out.v_new.data);
  }

 private:
  Value read() const {
    GPUPHYS_CUDA(cudaMemcpy(host_.get(), value_.get(), sizeof(Value), cudaMemcpyDeviceToHost));
    return *host_.get();
  }

  int n_ = 0;
  cg::Solver solver_;
  DeviceBuffer<float4> residual_, inverse_diagonal_, trial_;
  DeviceBuffer<Value> value_;
  PinnedBuffer<Value> host_;
};

}  // namespace gpuphys::newton
