// cahn_hilliard: one lattice Boltzmann step of a Cahn-Hilliard phase field, D3Q19, periodic, FP32.
//
// Two kernels:
//
//     sum_populations    phi = sum of h                                    76 bytes in, 4 out per cell
//     step_rows          mu(phi), relaxation, streaming (lattice.cuh)      76 + 12 + 4 in, 76 out
//
// Mapping: four neighbouring cells per thread in the first. In the second a thread owns two neighbouring
// cells along z, a block whole rows; besides its populations it reads the 19 values of phi around each cell,
// in rows that the thread shares between its two cells and that L1 and L2 hold.
//
// What bounds it: DRAM, 248 bytes per cell, 4.14 GB at paper size: 0.97 ms at the copy rate of an H200. The
// populations are read twice, because a cell's mu needs the phase field of cells that other blocks own.
// (Keeping h in L2 between the two, plane by plane in one launch, would save 30 %; L2 must then hold some
// eight planes of 4.7 MB and what is written meanwhile.)
//
// Accuracy: phi is the rest population plus small ones, so those are summed first; the Laplacian is a sum of
// differences from the cell's own phi.
#include "cases/grid_lattice/cahn_hilliard.hpp"

#include "references/common/alignment.hpp"
#include "references/common/device_buffer.cuh"
#include "references/grid_lattice/lattice.cuh"

namespace gpuphys::cahn_hilliard {
namespace {

using L = lbm::Lattice<19>;

#ifdef GPUPHYS_OTHER_BLOCKS
// The paper's rows take the path without shared memory.
struct Policy : lbm::RowPolicy<64, 8> {
  static constexpr int sum_threads = 64;
};
#else
// Two of the paper's rows per block.
struct Policy : lbm::RowPolicy<240, 3> {
  static constexpr int sum_threads = 256;
};
#endif

/// The phase field of N neighbouring cells per thread.
template <int N>
__global__ void __launch_bounds__(Policy::sum_threads)
    sum_populations(const float* __restrict__ h, float* __restrict__ phi, const std::int64_t plane) {
  const std::int64_t first = N * (blockIdx.x * std::int64_t{Policy::sum_threads} + threadIdx.x);
  if (first >= plane) return;
  float populations[N][L::Q], sum[N];
  lbm::load_cells<L, N>(h + first, plane, populations);
#pragma unroll
  for (int n = 0; n < N; ++n) {
    float moving[3] = {0.0f, 0.0f, 0.0f};  // axes, and the edges in two short sums
    lbm::unrolled<0, L::pairs>([&](auto pair) {
      constexpr int p = decltype(pair)::value, part = p < 3 ? 0 : p < 6 ? 1 : 2;
      moving[part] += populations[n][2 * p + 1] + populations[n][2 * p + 2];
    });
    sum[n] = populations[n][0] + (moving[0] + (moving[1] + moving[2]));
  }
  lbm::store_pack(phi + first, sum);
}

/// What a step does with the populations of neighbouring cells along z.
struct Relaxation {
  const float *phi, *ux, *uy, *uz;
  lbm::Grid grid;
  float four_beta, kappa, eta, rate;  ///< rate = 1/tau

  /// N values of phi in a row, and the one on either side.
  template <int N>
  __device__ __forceinline__ void load_row(int row, int k, float (&values)[N + 2]) const {
    const float* at = phi + row * grid.nz;
    float pack[N];
    lbm::load_pack(at + k, pack);
    values[0] = __ldg(at + lbm::neighbour<-1>(k, grid.nz));
    values[N + 1] = __ldg(at + lbm::neighbour<1>(k + N - 1, grid.nz));
#pragma unroll
    for (int n = 0; n < N; ++n) values[n + 1] = pack[n];
  }

  template <int N>
  __device__ __forceinline__ void operator()(float (&h)[N][L::Q], int i, int j, int k) const {
    const int im = lbm::neighbour<-1>(i, grid.nx) * grid.ny, ip = lbm::neighbour<1>(i, grid.nx) * grid.ny,
              jm = lbm::neighbour<-1>(j, grid.ny), jp = lbm::neighbour<1>(j, grid.ny), i0 = i * grid.ny;
    float own[N + 2], axis[N], edge[N];
    load_row<N>(i0 + j, k, own);
#pragma unroll
    for (int n = 0; n < N; ++n) {
      axis[n] = (own[n] - own[n + 1]) + (own[n + 2] - own[n + 1]);
      edge[n] = 0.0f;
    }
    // Rows beside the own one: a neighbour along an axis, and two across edges.
    for (const int row : {im + j, ip + j, i0 + jm, i0 + jp}) {
      float beside[N + 2];
      load_row<N>(row, k, beside);
#pragma unroll
      for (int n = 0; n < N; ++n) {
        axis[n] += beside[n + 1] - own[n + 1];
        edge[n] += (beside[n] - own[n + 1]) + (beside[n + 2] - own[n + 1]);
      }
    }
    // Rows across an edge.
    for (const int row : {im + jm, im + jp, ip + jm, ip + jp}) {
      float across[N];
      lbm::load_pack(phi + row * grid.nz + k, across);
#pragma unroll
      for (int n = 0; n < N; ++n) edge[n] += across[n] - own[n + 1];
    }
    float u[3][N];
    const int cell = (i0 + j) * grid.nz + k;
    lbm::load_pack(ux + cell, u[0]);
    lbm::load_pack(uy + cell, u[1]);
    lbm::load_pack(uz + cell, u[2]);
#pragma unroll
    for (int n = 0; n < N; ++n) {
      const float c = own[n + 1], laplacian = axis[n] * (1.0f / 3) + edge[n] * (1.0f / 6);
      const float driven = eta * (four_beta * c * (c - 1.0f) * (c - 0.5f) - kappa * laplacian);
      const float flow[3] = {3.0f * c * u[0][n], 3.0f * c * u[1][n], 3.0f * c * u[2][n]};
      constexpr float moving_weight = static_cast<float>(1 - L::weight(0));
      h[n][0] += rate * ((c - moving_weight * driven) - h[n][0]);
      lbm::unrolled<1, L::Q>([&](auto direction) {
        constexpr int q = decltype(direction)::value;
        constexpr float weight = static_cast<float>(L::weight(L::nonzero(q)));
        h[n][q] += rate * (weight * (driven + lbm::along<L, q>(flow)) - h[n][q]);
      });
    }
  }
};

struct Reference {
  void allocate(const Inputs& in, const Outputs<float>&) {
    phi_ = DeviceBuffer<float>(static_cast<std::size_t>(lbm::make_grid(in.h).plane));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    for (const View<const float, 3>& u : {in.ux, in.uy, in.uz}) require_aligned("cahn_hilliard", "u", u.data);
    const lbm::Grid grid = lbm::make_grid(in.h);
    const auto sum = [&](auto cells) {
      constexpr int N = decltype(cells)::value, per_block = N * Policy::sum_threads;
      sum_populations<N>
          <<<static_cast<unsigned>((grid.plane + per_block - 1) / per_block), Policy::sum_threads>>>(
              in.h.data, phi_.get(), grid.plane);
    };
    if (lbm::in_packs<4>(in.h.data, phi_.get(), grid.plane)) {
      sum(std::integral_constant<int, 4>{});
    } else {
      sum(std::integral_constant<int, 1>{});
    }
    const Relaxation relaxation{phi_.get(),     in.ux.data, in.uy.data, in.uz.data,   grid,
                                4.0f * in.beta, in.kappa,   in.eta,     1.0f / in.tau};
    lbm::launch_step<L, Policy>(in.h, out.h.data, relaxation);
  }

 private:
  DeviceBuffer<float> phi_;
};

}  // namespace
}  // namespace gpuphys::cahn_hilliard

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(cahn_hilliard, cahn_hilliard::Reference)
}
