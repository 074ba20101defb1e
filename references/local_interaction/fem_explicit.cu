// fem_explicit: forces of Neo-Hookean tetrahedra in random order, one symplectic Euler step, FP32.
//
//   pack_vertices    X and x of a vertex to 32 bytes, one sector; forces to zero: both stay in the L2
//   add_tets         a thread a tetrahedron: four vertices fetched, stress (neo_hookean.cuh), forces added by
//                    atomics, all three components in one request (vector_add.cuh)
//   symplectic_step  v' and x', a thread a coordinate
//
// What bounds it (n = 913 thousand, m = 5.31 million): the L2, as in mass_spring_explicit. Each of the 21.2
// million corners costs it a sector to read and a sector to add to; some 300 instructions a tetrahedron and
// 85 MB of tetrahedra from device memory hide behind that.
//
// Nothing is divided by the volume: V Dm^-T = cof(Dm) / 6.
#include "cases/local_interaction/fem_explicit.hpp"

#include <climits>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/common/alignment.hpp"
#include "references/common/device_buffer.cuh"
#include "references/common/vector_add.cuh"
#include "references/local_interaction/neo_hookean.cuh"
#include "references/local_interaction/symplectic_step.cuh"

namespace gpuphys::fem_explicit {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kPackThreads = 128, kTetThreads = 256, kStepThreads = 64;
#else
constexpr int kPackThreads = 256, kTetThreads = 128, kStepThreads = 256;
#endif

// A vertex: X, Y, Z, x; then y, z.
__global__ void __launch_bounds__(kPackThreads)
    pack_vertices(const float* __restrict__ rest, const float* __restrict__ x, int n,
                  float4* __restrict__ vertex, float4* __restrict__ force) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  vertex[2 * i] = make_float4(rest[3 * i], rest[3 * i + 1], rest[3 * i + 2], x[3 * i]);
  vertex[2 * i + 1] = make_float4(x[3 * i + 1], x[3 * i + 2], 0.0f, 0.0f);
  force[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
}

__global__ void __launch_bounds__(kTetThreads)
    add_tets(const int4* __restrict__ tets, int m, const float4* __restrict__ vertex, float mu, float lambda,
             float4* __restrict__ force) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= m) return;
  const int4 tet = __ldcs(tets + t);
  const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
  float4 first[4], second[4];
#pragma unroll
  for (int k = 0; k < 4; ++k) {
    first[k] = vertex[2 * corner[k]];
    second[k] = vertex[2 * corner[k] + 1];
  }
  elastic::Matrix3 rest, edges;
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    rest.m[0][k] = first[k + 1].x - first[0].x;
    rest.m[1][k] = first[k + 1].y - first[0].y;
    rest.m[2][k] = first[k + 1].z - first[0].z;
    edges.m[0][k] = first[k + 1].w - first[0].w;
    edges.m[1][k] = second[k + 1].x - second[0].x;
    edges.m[2][k] = second[k + 1].y - second[0].y;
  }
  const elastic::Matrix3 cofactors = elastic::cofactors(rest);
  const elastic::Matrix3 stress =
      elastic::stress(edges, rest, cofactors, elastic::determinant(rest, cofactors), mu, lambda);
  float sum[3] = {0.0f, 0.0f, 0.0f};
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    float f[3];
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      f[c] = (stress.m[c][0] * cofactors.m[0][k] + stress.m[c][1] * cofactors.m[1][k] +
              stress.m[c][2] * cofactors.m[2][k]) *
             (-1.0f / 6.0f);
      sum[c] -= f[c];
    }
    add_vector(force + corner[k + 1], f[0], f[1], f[2]);
  }
  add_vector(force + corner[0], sum[0], sum[1], sum[2]);
}

unsigned blocks_for(int items, int threads) {
  return static_cast<unsigned>((items + threads - 1) / threads);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.tets.shape[0];
    if (n > INT_MAX / 4 || m > INT_MAX - 4096)
      throw std::runtime_error("fem_explicit: more vertices or tetrahedra than 32 bits count");
    vertex_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(n));
    force_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = static_cast<int>(in.mass.shape[0]), m = static_cast<int>(in.tets.shape[0]);
    require_aligned("fem_explicit", "tets", in.tets.data);
    pack_vertices<<<blocks_for(n, kPackThreads), kPackThreads>>>(in.X.data, in.x.data, n, vertex_.get(),
                                                                 force_.get());
    add_tets<<<blocks_for(m, kTetThreads), kTetThreads>>>(reinterpret_cast<const int4*>(in.tets.data), m,
                                                          vertex_.get(), in.mu, in.lambda, force_.get());
    elastic::symplectic_step<<<blocks_for(3 * n, kStepThreads), kStepThreads>>>(
        in.x.data, in.v.data, in.mass.data, force_.get(), 1.0f, in.dt, 3u * static_cast<unsigned>(n),
        out.x_new.data, out.v_new.data);
  }

 private:
  DeviceBuffer<float4> vertex_, force_;
};

}  // namespace
}  // namespace gpuphys::fem_explicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(fem_explicit, fem_explicit::Reference)
}
