// Particles of an implicit elastic step in spatial order, with the displacement u from their positions as
// unknown: positions of 50 m would leave of it what a float32 of that size resolves.
#pragma once

#include <cstdint>

#include "references/common/device_buffer.cuh"
#include "references/position_constraint/spatial_order.cuh"

namespace gpuphys::displaced {

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kThreads = 128;
#else
constexpr int kThreads = 256;
#endif

inline unsigned blocks_for(std::int64_t items) {
  return static_cast<unsigned>((items + kThreads - 1) / kThreads);
}

/// In spatial order; (n) each.
struct Particles {
  float4* position;  ///< x as it came
  float4* target;    ///< dt v, the displacement without forces
  float4* moved;     ///< u
  float* mass;
};

/// Particle i becomes number[i]; it starts at its target.
__global__ void __launch_bounds__(kThreads)
    place(const float* __restrict__ x, const float* __restrict__ v, const float* __restrict__ mass,
          const int2* __restrict__ cell_and_place, const std::int32_t* __restrict__ first, float dt, int n,
          std::int32_t* __restrict__ number, Particles to) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const int2 where = cell_and_place[i];
  const int j = first[where.x] + where.y;
  number[i] = j;
  const float4 u = make_float4(dt * v[3 * i], dt * v[3 * i + 1], dt * v[3 * i + 2], 0.0f);
  to.position[j] = make_float4(x[3 * i], x[3 * i + 1], x[3 * i + 2], 0.0f);
  to.target[j] = u;
  to.moved[j] = u;
  to.mass[j] = mass[i];
}

/// u += step, and residual = mass (target - u). Without a step (null), the residual alone.
__global__ void __launch_bounds__(kThreads)
    advance(Particles p, const float4* __restrict__ step, int n, float4* __restrict__ residual) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  float4 u = p.moved[i];
  if (step) {
    const float4 s = step[i];
    u = make_float4(u.x + s.x, u.y + s.y, u.z + s.z, 0.0f);
    p.moved[i] = u;
  }
  const float4 t = p.target[i];
  const float m = p.mass[i];
  residual[i] = make_float4(m * (t.x - u.x), m * (t.y - u.y), m * (t.z - u.z), 0.0f);
}

/// x_new = x + u and v_new = u / dt, in the order of the inputs.
__global__ void __launch_bounds__(kThreads)
    write_displaced(const float* __restrict__ x, const std::int32_t* __restrict__ number,
                    const float4* __restrict__ moved, float dt, int n, float* __restrict__ x_new,
                    float* __restrict__ v_new) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float4 u = moved[number[i]];
  x_new[3 * i] = x[3 * i] + u.x;
  x_new[3 * i + 1] = x[3 * i + 1] + u.y;
  x_new[3 * i + 2] = x[3 * i + 2] + u.z;
  v_new[3 * i] = u.x / dt;
  v_new[3 * i + 1] = u.y / dt;
  v_new[3 * i + 2] = u.z / dt;
}

/// The arrays behind Particles, the numbering, and the steps at both ends.
class Body {
 public:
  Body() = default;
  explicit Body(int n)
      : n_(n),
        order_(n),
        number_(static_cast<std::size_t>(n)),
        position_(static_cast<std::size_t>(n)),
        target_(static_cast<std::size_t>(n)),
        moved_(static_cast<std::size_t>(n)),
        mass_(static_cast<std::size_t>(n)) {}

  template <class Inputs>
  void place(const Inputs& in) const {
    order_.build(in.x.data, n_);
    displaced::place<<<blocks_for(n_), kThreads>>>(in.x.data, in.v.data, in.mass.data,
                                                   order_.cell_and_place(), order_.first(), in.dt, n_,
                                                   number_.get(), particles());
  }
  template <class Inputs, class Outputs>
  void write(const Inputs& in, const Outputs& out) const {
    write_displaced<<<blocks_for(n_), kThreads>>>(in.x.data, number_.get(), moved_.get(), in.dt, n_,
                                                  out.x_new.data, out.v_new.data);
  }
  Particles particles() const { return {position_.get(), target_.get(), moved_.get(), mass_.get()}; }
  const std::int32_t* number() const { return number_.get(); }
  int size() const { return n_; }

 private:
  int n_ = 0;
  spatial::Order order_;
  DeviceBuffer<std::int32_t> number_;
  DeviceBuffer<float4> position_, target_, moved_;
  DeviceBuffer<float> mass_;
};

}  // namespace gpuphys::displaced
