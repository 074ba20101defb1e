// fem_newtonian_implicit: backward Euler for Neo-Hookean tetrahedra in random order by Newton's method
// (newton_step.cuh), FP32.
//
// Vertices are renumbered along a Morton curve (spatial_order.cuh), tetrahedra sorted by their lowest vertex
// (sorted_tets.cuh), so that neighbouring threads share vertices. A thread takes a tetrahedron; what it does
// to its corners it adds by atomics, three components in one request (vector_add.cuh).
//
// With D the edges of a tetrahedron now, C = D^-1 and S = D_m^-1 D_m^-T, a displacement with edges dD changes
// the gradient by the columns of
//   V (mu dD S + (mu - lambda ln J) (C dD C)^T + lambda tr(C dD) C^T),
// so that neither F nor D_m is needed: 17 numbers per tetrahedron and Newton step, in five arrays of 16
// bytes.
//
// What bounds it (n = 275 thousand, m = 1.57 million): some 50 products in each of two or three steps, of 126
// MB of these numbers from device memory and 6.3 million additions in the L2. Rows of 3x3 blocks would need
// neither, but assembling them takes a hundred atomics a tetrahedron and step.
#include "cases/global_solve/fem_newtonian_implicit.hpp"

#include <climits>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/common/alignment.hpp"
#include "references/common/vector_add.cuh"
#include "references/global_solve/newton_step.cuh"
#include "references/global_solve/sorted_tets.cuh"
#include "references/local_interaction/neo_hookean.cuh"

namespace gpuphys::fem_newtonian_implicit {
namespace {

using displaced::Particles;
using elastic::Matrix3;

#ifdef GPUPHYS_OTHER_BLOCKS
constexpr int kTetThreads = 256;
#else
constexpr int kTetThreads = 128;
#endif

struct Mesh {
  const int4* tets;
  const float4* rest;
  int n, m;
  float mu, lambda;  // times dt^2
};

// Edges now, from positions as they came and displacements.
__device__ __forceinline__ Matrix3 edges_now(const Particles& p, const float4* u, const int (&corner)[4]) {
  Matrix3 now = sorted_tets::edges(p.position, corner);
  const Matrix3 moved = sorted_tets::edges(u, corner);
#pragma unroll
  for (int e = 0; e < 9; ++e) now.m[e / 3][e % 3] += moved.m[e / 3][e % 3];
  return now;
}

// mass (target - u), and the inertial part of the energy to parts[0].
__global__ void __launch_bounds__(cg::kThreads)
    begin_evaluation(Particles p, const float4* __restrict__ u, int n, float4* __restrict__ residual,
                     float* __restrict__ partials, float* __restrict__ parts, unsigned* finished) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float sum[1] = {0.0f};
  if (i < n) {
    const float4 off = cg::plus(p.target[i], -1.0f, u[i]);
    const float mass = p.mass[i];
    residual[i] = make_float4(mass * off.x, mass * off.y, mass * off.z, 0.0f);
    sum[0] = 0.5f * mass * cg::dot(off, off);
  }
  if (cg::sum_everything(sum, partials, finished)) parts[0] = sum[0];
}

// Adds the forces to the residual, and the elastic energy to parts[1].
__global__ void __launch_bounds__(cg::kThreads)
    add_forces(Mesh mesh, Particles p, const float4* __restrict__ u, float4* __restrict__ residual,
               float* __restrict__ partials, float* __restrict__ parts, unsigned* finished) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float total[1] = {0.0f};
  if (t < mesh.m) {
    const int4 tet = mesh.tets[t];
    const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
    const Matrix3 rest = sorted_tets::edges(mesh.rest, corner), cofactors = elastic::cofactors(rest);
    const float det = elastic::determinant(rest, cofactors);
    const Matrix3 now = edges_now(p, u, corner);
    const float energy = elastic::energy(now, rest, cofactors, det, mesh.mu, mesh.lambda);
    total[0] = det * (1.0f / 6.0f) * energy;
    if (energy < INFINITY) {
      const Matrix3 stress = elastic::stress(now, rest, cofactors, det, mesh.mu, mesh.lambda);
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
        add_vector(residual + corner[k + 1], f[0], f[1], f[2]);
      }
      add_vector(residual + corner[0], sum[0], sum[1], sum[2]);
    }
  }
  if (cg::sum_everything(total, partials, finished)) parts[1] = total[0];
}

__global__ void __launch_bounds__(cg::kThreads)
    end_evaluation(const float4* __restrict__ residual, int n, float* __restrict__ partials,
                   const float* __restrict__ parts, newton::Value* value) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float sum[1] = {i < n ? cg::dot(residual[i], residual[i]) : 0.0f};
  if (!cg::sum_everything(sum, partials, &value->finished)) return;
  value->energy = parts[0] + parts[1];
  value->gradient2 = sum[0];
}

// 17 numbers of each tetrahedron, and the diagonal of the Hessian's elastic part (zero before).
__global__ void __launch_bounds__(kTetThreads)
    linearise(Mesh mesh, Particles p, const float4* __restrict__ u, float4* __restrict__ linear,
              float4* __restrict__ diagonal) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= mesh.m) return;
  const int4 tet = mesh.tets[t];
  const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
  const Matrix3 rest = sorted_tets::edges(mesh.rest, corner), rest_cofactors = elastic::cofactors(rest);
  const float rest_det = elastic::determinant(rest, rest_cofactors), volume = rest_det * (1.0f / 6.0f);
  const Matrix3 now = edges_now(p, u, corner), now_cofactors = elastic::cofactors(now);
  const float now_det = elastic::determinant(now, now_cofactors), inverse_det = 1.0f / now_det;
  const float twist = volume * (mesh.mu - mesh.lambda * logf(now_det / rest_det)),
              spread = volume * mesh.lambda;
  const float scale = mesh.mu / (6.0f * rest_det);  // mu V / det^2
  float c[4][3], s[3][3];  // rows of C, the last one that of the first corner; mu V S
#pragma unroll
  for (int k = 0; k < 3; ++k) {
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      c[k][d] = now_cofactors.m[d][k] * inverse_det;
      s[k][d] = scale * (rest_cofactors.m[0][k] * rest_cofactors.m[0][d] +
                         rest_cofactors.m[1][k] * rest_cofactors.m[1][d] +
                         rest_cofactors.m[2][k] * rest_cofactors.m[2][d]);
    }
  }
#pragma unroll
  for (int d = 0; d < 3; ++d) c[3][d] = -(c[0][d] + c[1][d] + c[2][d]);
  linear[t] = make_float4(c[0][0], c[0][1], c[0][2], c[1][0]);
  linear[mesh.m + t] = make_float4(c[1][1], c[1][2], c[2][0], c[2][1]);
  linear[2 * mesh.m + t] = make_float4(c[2][2], twist, spread, s[0][0]);
  linear[3 * mesh.m + t] = make_float4(s[0][1], s[0][2], s[1][1], s[1][2]);
  linear[4 * mesh.m + t] = make_float4(s[2][2], 0.0f, 0.0f, 0.0f);
  const float all = s[0][0] + s[1][1] + s[2][2] + 2.0f * (s[0][1] + s[0][2] + s[1][2]);
#pragma unroll
  for (int a = 0; a < 4; ++a) {
    const float along = a < 3 ? s[a < 3 ? a : 0][a < 3 ? a : 0] : all;
    add_vector(diagonal + (a < 3 ? corner[a < 3 ? a + 1 : 0] : corner[0]),
               along + (twist + spread) * c[a][0] * c[a][0], along + (twist + spread) * c[a][1] * c[a][1],
               along + (twist + spread) * c[a][2] * c[a][2]);
  }
}

__global__ void __launch_bounds__(cg::kThreads)
    invert_diagonal(const float* __restrict__ mass, int n, float4* __restrict__ diagonal) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float4 d = diagonal[i];
  const float m = mass[i];
  diagonal[i] = make_float4(1.0f / (m + fmaxf(d.x, 0.0f)), 1.0f / (m + fmaxf(d.y, 0.0f)),
                            1.0f / (m + fmaxf(d.z, 0.0f)), 0.0f);
}

// q = M p; the tetrahedra add to it.
__global__ void __launch_bounds__(cg::kThreads)
    begin_product(const float* __restrict__ mass, const float4* __restrict__ p, int n, float4* __restrict__ q,
                  const cg::State* __restrict__ state) {
  if (state->status != 0) return;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const float m = mass[i];
  const float4 own = p[i];
  q[i] = make_float4(m * own.x, m * own.y, m * own.z, 0.0f);
}

__global__ void __launch_bounds__(kTetThreads)
    add_product(const int4* __restrict__ tets, int m, const float4* __restrict__ linear,
                const float4* __restrict__ p, float4* __restrict__ q, const cg::State* __restrict__ state) {
  if (state->status != 0) return;
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= m) return;
  const int4 tet = tets[t];
  const float4 l0 = __ldcs(linear + t), l1 = __ldcs(linear + m + t), l2 = __ldcs(linear + 2 * m + t),
               l3 = __ldcs(linear + 3 * m + t), l4 = __ldcs(linear + 4 * m + t);
  const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
  const Matrix3 d = sorted_tets::edges(p, corner);
  const float c[3][3] = {{l0.x, l0.y, l0.z}, {l0.w, l1.x, l1.y}, {l1.z, l1.w, l2.x}};
  const float s[3][3] = {{l2.w, l3.x, l3.y}, {l3.x, l3.z, l3.w}, {l3.y, l3.w, l4.x}};
  const float twist = l2.y, spread = l2.z;
  float cd[3][3];  // C dD
#pragma unroll
  for (int i = 0; i < 3; ++i) {
#pragma unroll
    for (int k = 0; k < 3; ++k) cd[i][k] = c[i][0] * d.m[0][k] + c[i][1] * d.m[1][k] + c[i][2] * d.m[2][k];
  }
  const float trace = spread * (cd[0][0] + cd[1][1] + cd[2][2]);
  float sum[3] = {0.0f, 0.0f, 0.0f};
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    float g[3];
#pragma unroll
    for (int i = 0; i < 3; ++i) {
      g[i] = d.m[i][0] * s[0][k] + d.m[i][1] * s[1][k] + d.m[i][2] * s[2][k] +
             twist * (cd[k][0] * c[0][i] + cd[k][1] * c[1][i] + cd[k][2] * c[2][i]) + trace * c[k][i];
      sum[i] -= g[i];
    }
    add_vector(q + corner[k + 1], g[0], g[1], g[2]);
  }
  add_vector(q + corner[0], sum[0], sum[1], sum[2]);
}

unsigned blocks_for(int items, int threads) {
  return static_cast<unsigned>((items + threads - 1) / threads);
}

struct Tets {
  Mesh mesh;
  Particles particles;
  float4* linear;
  float* partials;
  float* parts;        // of the energy
  unsigned* finished;  // blocks

  void evaluate(const float4* u, float4* residual, newton::Value* value) const {
    begin_evaluation<<<blocks_for(mesh.n, cg::kThreads), cg::kThreads>>>(particles, u, mesh.n, residual,
                                                                         partials, parts, finished);
    add_forces<<<blocks_for(mesh.m, cg::kThreads), cg::kThreads>>>(mesh, particles, u, residual, partials,
                                                                   parts, finished);
    end_evaluation<<<blocks_for(mesh.n, cg::kThreads), cg::kThreads>>>(residual, mesh.n, partials, parts,
                                                                       value);
  }
  void linearise(const float4* u, float4* inverse_diagonal) const {
    GPUPHYS_CUDA(cudaMemsetAsync(inverse_diagonal, 0, sizeof(float4) * static_cast<std::size_t>(mesh.n)));
    fem_newtonian_implicit::linearise<<<blocks_for(mesh.m, kTetThreads), kTetThreads>>>(
        mesh, particles, u, linear, inverse_diagonal);
    invert_diagonal<<<blocks_for(mesh.n, cg::kThreads), cg::kThreads>>>(particles.mass, mesh.n,
                                                                        inverse_diagonal);
  }
  void apply(const float4* p, float4* q, const cg::State* state) const {
    begin_product<<<blocks_for(mesh.n, cg::kThreads), cg::kThreads>>>(particles.mass, p, mesh.n, q, state);
    add_product<<<blocks_for(mesh.m, kTetThreads), kTetThreads>>>(mesh.tets, mesh.m, linear, p, q, state);
  }
};

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.tets.shape[0];
    if (n > INT_MAX / 8 || m > INT_MAX / 12)
      throw std::runtime_error("fem_newtonian_implicit: more vertices or tetrahedra than 32 bits count");
    n_ = static_cast<int>(n);
    m_ = static_cast<int>(m);
    body_ = displaced::Body(n_);
    tets_ = sorted_tets::SortedTets(n_, m_);
    newton_ = newton::Newton(n_);
    room_ = DeviceBuffer<std::int32_t>(static_cast<std::size_t>(n));
    linear_ = DeviceBuffer<float4>(5 * static_cast<std::size_t>(m));
    partials_ = DeviceBuffer<float>(static_cast<std::size_t>(n > m ? n : m) / cg::kThreads + 1);
    parts_ = DeviceBuffer<float>(2);
    finished_ = DeviceBuffer<unsigned>(1);
    GPUPHYS_CUDA(cudaMemset(finished_.get(), 0, sizeof(unsigned)));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("fem_newtonian_implicit", "tets", in.tets.data);
    body_.place(in);
    GPUPHYS_CUDA(cudaMemsetAsync(room_.get(), 0, sizeof(std::int32_t) * static_cast<std::size_t>(n_)));
    tets_.build(in.tets.data, in.X.data, body_.number(), room_.get());
    const Mesh mesh{tets_.tets(), tets_.rest(), n_, m_, in.dt * in.dt * in.mu, in.dt * in.dt * in.lambda};
    newton_.minimise(
        body_.particles(), in.tol, "fem_newtonian_implicit",
        Tets{mesh, body_.particles(), linear_.get(), partials_.get(), parts_.get(), finished_.get()});
    newton_.write(in, body_, out);
  }

 private:
  int n_ = 0, m_ = 0;
  displaced::Body body_;
  sorted_tets::SortedTets tets_;
  newton::Newton newton_;
  DeviceBuffer<std::int32_t> room_;
  DeviceBuffer<float4> linear_;
  DeviceBuffer<float> partials_, parts_;
  DeviceBuffer<unsigned> finished_;
};

}  // namespace
}  // namespace gpuphys::fem_newtonian_implicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(fem_newtonian_implicit, fem_newtonian_implicit::Reference)
}
