// mass_spring_explicit: forces of springs in random order, one symplectic Euler step, FP32.
//
//   pack_particles   positions to 16 bytes each, forces to zero: both stay in the L2
//   add_springs      a thread takes four springs: their eight ends are fetched together, the forces added by
//                    atomics, all three components in one request (vector_add.cuh)
//   symplectic_step  v' and x', a thread a coordinate
//
// What bounds it (n = 889 thousand, m = 7.82 million): the L2. Springs name particles at random, so each of
// the 15.6 million ends costs it a sector to read and a sector to add to, 1 GB in all, whereas the springs
// themselves are 94 MB from device memory. Springs are read past the caches' order of eviction, so that the
// 28 MB of particles stay. Sorting half-springs into tiles with forces in shared memory, as the iterations of
// solve_constraint_xpbd do, pays from some four evaluations of the same springs: the sort alone costs one
// random look-up of each end and 250 MB.
//
// The stretch is a difference of two lengths; forces are summed as stretches in metres, the stiffness
// multiplies the sum once.
#include "cases/local_interaction/mass_spring_explicit.hpp"

#include <climits>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/common/alignment.hpp"
#include "references/common/device_buffer.cuh"
#include "references/common/vector_add.cuh"
#include "references/local_interaction/symplectic_step.cuh"

namespace gpuphys::mass_spring_explicit {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kPackThreads = 128, kSpringThreads = 512, kStepThreads = 64;
#else
constexpr int kPackThreads = 256, kSpringThreads = 256, kStepThreads = 256;
#endif
constexpr int kEach = 4;  // springs of a thread

__global__ void __launch_bounds__(kPackThreads)
    pack_particles(const float* __restrict__ x, int n, float4* __restrict__ position,
                   float4* __restrict__ stretch) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  position[i] = make_float4(x[3 * i], x[3 * i + 1], x[3 * i + 2], 0.0f);
  stretch[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
}

__global__ void __launch_bounds__(kSpringThreads)
    add_springs(const int2* __restrict__ springs, const float* __restrict__ rest, int m,
                const float4* __restrict__ position, float4* __restrict__ stretch) {
  const int first = kEach * static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (first >= m) return;
  int2 ends[kEach];
  float length[kEach];
  if (first + kEach <= m) {
    const int4 low = __ldcs(reinterpret_cast<const int4*>(springs + first));
    const int4 high = __ldcs(reinterpret_cast<const int4*>(springs + first) + 1);
    const float4 lengths = __ldcs(reinterpret_cast<const float4*>(rest + first));
    ends[0] = make_int2(low.x, low.y);
    ends[1] = make_int2(low.z, low.w);
    ends[2] = make_int2(high.x, high.y);
    ends[3] = make_int2(high.z, high.w);
    length[0] = lengths.x, length[1] = lengths.y, length[2] = lengths.z, length[3] = lengths.w;
  } else {
#pragma unroll
    for (int e = 0; e < kEach; ++e) {
      const bool there = first + e < m;
      ends[e] = there ? springs[first + e] : make_int2(0, 0);  // which does nothing
      length[e] = there ? rest[first + e] : 0.0f;
    }
  }
  float4 a[kEach], b[kEach];
#pragma unroll
  for (int e = 0; e < kEach; ++e) {
    a[e] = position[ends[e].x];
    b[e] = position[ends[e].y];
  }
#pragma unroll
  for (int e = 0; e < kEach; ++e) {
    const float dx = a[e].x - b[e].x, dy = a[e].y - b[e].y, dz = a[e].z - b[e].z;
    const float now = sqrtf(dx * dx + dy * dy + dz * dz);
    if (now == 0.0f) continue;
    const float pull = (length[e] - now) / now;
    add_vector(stretch + ends[e].x, pull * dx, pull * dy, pull * dz);
    add_vector(stretch + ends[e].y, -pull * dx, -pull * dy, -pull * dz);
  }
}

unsigned blocks_for(int items, int threads) {
  return static_cast<unsigned>((items + threads - 1) / threads);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.rest.shape[0];
    if (n > INT_MAX / 4 || m > INT_MAX - 4096)
      throw std::runtime_error("mass_spring_explicit: more particles or springs than 32 bits count");
    position_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    stretch_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = static_cast<int>(in.mass.shape[0]), m = static_cast<int>(in.rest.shape[0]);
    require_aligned("mass_spring_explicit", "springs", in.springs.data);
    require_aligned("mass_spring_explicit", "rest", in.rest.data);
    pack_particles<<<blocks_for(n, kPackThreads), kPackThreads>>>(in.x.data, n, position_.get(),
                                                                  stretch_.get());
    add_springs<<<blocks_for((m + kEach - 1) / kEach, kSpringThreads), kSpringThreads>>>(
        reinterpret_cast<const int2*>(in.springs.data), in.rest.data, m, position_.get(), stretch_.get());
    elastic::symplectic_step<<<blocks_for(3 * n, kStepThreads), kStepThreads>>>(
        in.x.data, in.v.data, in.mass.data, stretch_.get(), in.k, in.dt, 3u * static_cast<unsigned>(n),
        out.x_new.data, out.v_new.data);
  }

 private:
  DeviceBuffer<float4> position_, stretch_;
};

}  // namespace
}  // namespace gpuphys::mass_spring_explicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(mass_spring_explicit, mass_spring_explicit::Reference)
}
