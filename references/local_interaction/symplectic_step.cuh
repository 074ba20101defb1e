// The end of an explicit elastic step: v' = v + dt f / m, x' = x + dt v'.
#pragma once

#include "references/common/device_buffer.cuh"

namespace gpuphys::elastic {

/// A thread a coordinate, so that all accesses but those of `force` are contiguous. The force on particle i
/// is `stiffness` times force[i].
__global__ void __launch_bounds__(256)
    symplectic_step(const float* __restrict__ x, const float* __restrict__ v, const float* __restrict__ mass,
                    const float4* __restrict__ force, float stiffness, float dt, unsigned coordinates,
                    float* __restrict__ x_new, float* __restrict__ v_new) {
  const unsigned c = blockIdx.x * blockDim.x + threadIdx.x;
  if (c >= coordinates) return;
  const unsigned i = c / 3u;
  const float f = reinterpret_cast<const float*>(force)[4u * i + (c - 3u * i)];
  const float now = v[c] + stiffness * dt / mass[i] * f;
  v_new[c] = now;
  x_new[c] = x[c] + dt * now;
}

}  // namespace gpuphys::elastic
