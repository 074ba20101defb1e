// fem_pd: local-global iterations of projective dynamics for corotated tetrahedra in random order, FP32.
//
// Vertices are renumbered along a Morton curve (spatial_order.cuh), tetrahedra sorted by their lowest vertex,
// so that neighbouring threads share vertices. Their pairs are merged into the rows of the constant matrix
// (laplacian_rows.cuh). An iteration: the residual mass (y - z) - dt^2 gradient, a thread a tetrahedron, its
// rotation by polar3x3.cuh, added by atomics; and the solve of A (z' - z) = residual by Chebyshev's iteration
// (chebyshev.cuh). The matrix is the same in all 8, so its bounds are read back once and everything else is
// queued at once.
//
// The unknown is the displacement from x. Global steps are solved to 1e-5 of their error in the norm of A.
//
// What bounds it (n = 275 thousand, m = 1.57 million): the solves, about 105 iterations each at dt^2 2 mu /
// mass = 19, of 33 MB of entries and 18 MB of vectors, all in the L2.
#include "cases/global_solve/fem_pd.hpp"

#include <climits>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/blocks/chebyshev.cuh"
#include "references/common/alignment.hpp"
#include "references/common/polar3x3.cuh"
#include "references/common/vector_add.cuh"
#include "references/global_solve/displaced_particles.cuh"
#include "references/global_solve/sorted_tets.cuh"
#include "references/local_interaction/neo_hookean.cuh"

// With GPUPHYS_OTHER_BLOCKS eight lanes share a row, and blocks have 128 threads (laplacian_rows.cuh,
// displaced_particles.cuh).
namespace gpuphys::fem_pd {
namespace {

constexpr double kPartOfError = 1e-5;  // that a global step may leave

// Adds the matrix of each tetrahedron, dt^2 2 mu V g_a . g_b for its corners' gradients g: weights are minus
// that.
__global__ void __launch_bounds__(128)
    add_matrices(const int4* __restrict__ tets, int m, const float4* __restrict__ rest, float stiffness,
                 rows::Tables tables) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= m) return;
  const int4 tet = tets[t];
  const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
  const elastic::Matrix3 edges = sorted_tets::edges(rest, corner), c = elastic::cofactors(edges);
  const float scale = -stiffness / (6.0f * elastic::determinant(edges, c));
  float slope[4][3];  // gradients times the determinant
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    slope[0][d] = -c.m[d][0] - c.m[d][1] - c.m[d][2];
#pragma unroll
    for (int k = 0; k < 3; ++k) slope[k + 1][d] = c.m[d][k];
  }
#pragma unroll
  for (int a = 0; a < 4; ++a) {
#pragma unroll
    for (int b = a + 1; b < 4; ++b) {
      const float w =
          scale * (slope[a][0] * slope[b][0] + slope[a][1] * slope[b][1] + slope[a][2] * slope[b][2]);
      tables.add(corner[a], corner[b], w);
      tables.add(corner[b], corner[a], w);
    }
  }
}

// Adds dt^2 times the forces of P = 2 mu (F - R).
__global__ void __launch_bounds__(128)
    add_forces(const int4* __restrict__ tets, int m, const float4* __restrict__ rest, displaced::Particles p,
               float stiffness, float4* __restrict__ residual) {
  const int t = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (t >= m) return;
  const int4 tet = tets[t];
  const int corner[4] = {tet.x, tet.y, tet.z, tet.w};
  const elastic::Matrix3 edges = sorted_tets::edges(rest, corner), cofactors = elastic::cofactors(edges);
  elastic::Matrix3 now = sorted_tets::edges(p.position, corner);
  const elastic::Matrix3 moved = sorted_tets::edges(p.moved, corner);
#pragma unroll
  for (int e = 0; e < 9; ++e) now.m[e / 3][e % 3] += moved.m[e / 3][e % 3];
  const elastic::Matrix3 deformation = elastic::over(now, cofactors, elastic::determinant(edges, cofactors));
  polar::Matrix3 f;
#pragma unroll
  for (int e = 0; e < 9; ++e) f.m[e / 3][e % 3] = deformation.m[e / 3][e % 3];
  const polar::Matrix3 r = polar::nearest_rotation(f);
  float sum[3] = {0.0f, 0.0f, 0.0f};
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    float force[3];
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      force[c] = ((f.m[c][0] - r.m[c][0]) * cofactors.m[0][k] + (f.m[c][1] - r.m[c][1]) * cofactors.m[1][k] +
                  (f.m[c][2] - r.m[c][2]) * cofactors.m[2][k]) *
                 (stiffness * (-1.0f / 6.0f));
      sum[c] -= force[c];
    }
    add_vector(residual + corner[k + 1], force[0], force[1], force[2]);
  }
  add_vector(residual + corner[0], sum[0], sum[1], sum[2]);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.tets.shape[0];
    if (n > INT_MAX / 8 || m > INT_MAX / 12)
      throw std::runtime_error("fem_pd: more vertices or tetrahedra than 32 bits count");
    m_ = static_cast<int>(m);
    body_ = displaced::Body(static_cast<int>(n));
    tets_ = sorted_tets::SortedTets(static_cast<int>(n), m_);
    matrix_ = rows::MergedRows(static_cast<int>(n), 12 * m);
    solver_ = chebyshev::Solver(static_cast<int>(n));
    residual_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = body_.size();
    require_aligned("fem_pd", "tets", in.tets.data);
    body_.place(in);
    const displaced::Particles particles = body_.particles();
    const float stiffness = in.dt * in.dt * 2.0f * in.mu;
    if (in.iters > 0) {
      tets_.build(in.tets.data, in.X.data, body_.number(), matrix_.room());
      constexpr unsigned threads = 128;
      const auto blocks =
          static_cast<unsigned>((m_ + static_cast<int>(threads) - 1) / static_cast<int>(threads));
      add_matrices<<<blocks, threads>>>(tets_.tets(), m_, tets_.rest(), stiffness, matrix_.begin());
      solver_.prepare(matrix_.finish(particles.mass), kPartOfError);
      const float4* step = nullptr;
      for (int k = 0; k < in.iters; ++k) {
        displaced::advance<<<displaced::blocks_for(n), displaced::kThreads>>>(particles, step, n,
                                                                              residual_.get());
        add_forces<<<blocks, threads>>>(tets_.tets(), m_, tets_.rest(), particles, stiffness,
                                        residual_.get());
        step = solver_.solve(residual_.get());
      }
      displaced::advance<<<displaced::blocks_for(n), displaced::kThreads>>>(particles, step, n,
                                                                            residual_.get());
    }
    body_.write(in, out);
  }

 private:
  int m_ = 0;
  displaced::Body body_;
  sorted_tets::SortedTets tets_;
  rows::MergedRows matrix_;
  chebyshev::Solver solver_;
  DeviceBuffer<float4> residual_;
};

}  // namespace
}  // namespace gpuphys::fem_pd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(fem_pd, fem_pd::Reference)
}
