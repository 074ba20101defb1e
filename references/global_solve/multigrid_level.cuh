// The matrices of the multigrid hierarchy: seven-point systems in the layout of the task inputs, coarsened by
// 2 x 2 x 2 aggregates.
//
// Coarse couplings are rediscretised: the sum of the fine couplings across the shared face, halved along that
// axis because the distance between centres doubles. What a fine diagonal holds beyond the sum of its
// couplings (a Dirichlet face, a mass term) is summed. For constant coefficients this is the standard coarse
// operator; the plain aggregation operator (no halving) would be twice as stiff, level after level.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

namespace gpuphys::multigrid {

/// A seven-point matrix. Entry (i,j,k) lies at (i*ny + j)*pitch + k; entries k >= nz (padding) are zero.
struct Matrix {
  const float* diag = nullptr;
  const float* ax = nullptr;  ///< signed coupling to (i+1,j,k), and so on
  const float* ay = nullptr;
  const float* az = nullptr;
  int nx = 0, ny = 0, nz = 0, pitch = 0;

  __host__ __device__ int plane() const { return ny * pitch; }
  __host__ __device__ int size() const { return nx * ny * pitch; }
  __host__ __device__ int at(int i, int j, int k) const { return (i * ny + j) * pitch + k; }
};

/// Which of its six neighbours a coarse cell is coupled to: bit d*2 for the next cell along axis d, d*2 + 1
/// for the previous one.
using Gates = std::uint8_t;

struct MutableMatrix {
  float *diag, *ax, *ay, *az;
  Gates* gates;
};

/// What the diagonal holds beyond the couplings; rounding noise of either sign counts as nothing.
__device__ __forceinline__ float excess_of(float diag, float couplings) {
  const float excess = diag + couplings;  // couplings are <= 0
  return excess > 2e-6f * diag ? excess : 0.0f;
}

/// One thread per entry of the coarse arrays, padding included. `rows_sum_to_zero` drops the excess
/// altogether.
__global__ void coarsen(Matrix fine, Matrix shape, MutableMatrix coarse, bool rows_sum_to_zero) {
  const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (at >= shape.size()) return;
  const int k = at % shape.pitch, j = (at / shape.pitch) % shape.ny, i = at / shape.plane();
  const int i0 = 2 * i, j0 = 2 * j, k0 = 2 * k;

  const auto entry = [&](const float* a, int fi, int fj, int fk) {
    return fi >= 0 && fj >= 0 && fk >= 0 && fi < fine.nx && fj < fine.ny && fk < fine.nz
               ? __ldg(a + fine.at(fi, fj, fk))
               : 0.0f;
  };
  // Faces of the 2x2x2 children along one axis: below, between and above the two layers of children.
  float face[3][3] = {};  // [axis][layer], summed over the four columns
  float excess = 0;
  float child_x[3][2][2], child_y[2][3][2], child_z[2][2][3];
#pragma unroll
  for (int a = 0; a < 2; ++a) {
#pragma unroll
    for (int b = 0; b < 2; ++b) {
#pragma unroll
      for (int layer = 0; layer < 3; ++layer) {
        child_x[layer][a][b] = entry(fine.ax, i0 - 1 + layer, j0 + a, k0 + b);
        child_y[a][layer][b] = entry(fine.ay, i0 + a, j0 - 1 + layer, k0 + b);
        child_z[a][b][layer] = entry(fine.az, i0 + a, j0 + b, k0 - 1 + layer);
        face[0][layer] += child_x[layer][a][b];
        face[1][layer] += child_y[a][layer][b];
        face[2][layer] += child_z[a][b][layer];
      }
    }
  }
  if (!rows_sum_to_zero) {
#pragma unroll
    for (int a = 0; a < 2; ++a)
#pragma unroll
      for (int b = 0; b < 2; ++b)
#pragma unroll
        for (int c = 0; c < 2; ++c) {
          const float couplings = child_x[a][b][c] + child_x[a + 1][b][c] + child_y[a][b][c] +
                                  child_y[a][b + 1][c] + child_z[a][b][c] + child_z[a][b][c + 1];
          excess += excess_of(entry(fine.diag, i0 + a, j0 + b, k0 + c), couplings);
        }
  }
  constexpr float kDistance = 0.5f;
  float couplings = 0;
  Gates gates = 0;
#pragma unroll
  for (int axis = 0; axis < 3; ++axis) {
    face[axis][0] *= kDistance;
    face[axis][2] *= kDistance;
    couplings += face[axis][0] + face[axis][2];
    if (face[axis][2] != 0) gates |= static_cast<Gates>(1u << (2 * axis));
    if (face[axis][0] != 0) gates |= static_cast<Gates>(2u << (2 * axis));
  }
  coarse.diag[at] = excess - couplings;
  coarse.ax[at] = face[0][2];
  coarse.ay[at] = face[1][2];
  coarse.az[at] = face[2][2];
  coarse.gates[at] = gates;
}

/// Cells from which the coarse correction of fine cell (i,j,k) is interpolated linearly: the parent, and
/// along each axis the neighbour of the parent on the child's side. A neighbour the parent is not coupled to
/// does not exist physically (wall, end of the box): the correction is then constant in that direction.
__device__ __forceinline__ float interpolate(float parent, float along_x, float along_y, float along_z) {
  return parent + 0.25f * ((along_x - parent) + (along_y - parent) + (along_z - parent));
}

}  // namespace gpuphys::multigrid
