// The matrices of the multigrid hierarchy: seven-point systems in the layout of the task inputs, coarsened by
// 2 x 2 x 2 aggregates.
//
// Coarse couplings are rediscretised: the sum of the fine couplings across the shared face, halved along that
// axis because the distance between centres doubles. What a fine diagonal holds beyond the sum of its
// couplings is summed: as it is where all six neighbours exist (a mass term); where one is missing it is
// taken for a face at which the solution is held at zero, and weakened by the growth of the distance to that
// face. For constant coefficients this is the standard coarse operator; the plain aggregation operator (no
// halving) would be twice as stiff, level after level.
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
/// for the previous one. Bit `kHeld`: what lies beyond its other faces is held at zero rather than closed.
using Gates = std::uint8_t;
constexpr Gates kHeld = 64;
/// Share of the diagonal from which on a cell counts as held: less is next to closed. (Where there is a mass
/// term, which is no holding, more has to be asked for.)
constexpr float kHeldShare = 0.02f;

struct MutableMatrix {
  float *diag, *ax, *ay, *az;
  Gates* gates;
  float* rhs;  ///< cleared
};

/// How a level is made from the finer one.
struct Coarsening {
  bool rows_sum_to_zero;  ///< drops the excess of the diagonals altogether
  float coupling;  ///< times the sum of the fine couplings: one over the growth of the distance of centres
  float thin;      ///< the same next to a last layer without a partner, whose centre stays where it is
  float held;  ///< times what holds a boundary cell at zero: the same for the distance to where it is zero
  float held_share = kHeldShare;  ///< see there
};

/// Coarsening to level `l` >= 1. Zero is one cell width from the centre of a boundary cell of level 0, and
/// half a (coarse) cell farther out each time.
inline Coarsening coarsening_to(int l, bool rows_sum_to_zero, float first_coupling,
                                float held_share = kHeldShare) {
  const auto distance = [](int level) { return 0.5f * static_cast<float>(1 << level) + 0.5f; };
  const float coupling = l == 1 ? first_coupling : 0.5f, held = distance(l - 1) / distance(l);
  return {rows_sum_to_zero, coupling, rows_sum_to_zero ? coupling : 2 * coupling * held, held, held_share};
}

/// A product that is not contracted into a sum: what is added is what is stored.
__host__ __device__ __forceinline__ float rounded_product(float a, float b) {
#ifdef __CUDA_ARCH__
  return __fmul_rn(a, b);
#else
  return a * b;
#endif
}

/// start + inner + outer, summed without rounding errors.
__host__ __device__ __forceinline__ float exact_sum(float start, const float (&inner)[3],
                                                    const float (&outer)[3]) {
  float sum = start, lost = 0;
  for (int d = 0; d < 6; ++d) {
    const float term = d < 3 ? inner[d] : outer[d - 3], next = sum + term, gained = next - sum;
    lost += (sum - (next - gained)) + (term - gained);
    sum = next;
  }
  return sum + lost;
}

/// What the diagonal holds beyond its couplings (<= 0); what the rounding of the diagonal itself may be
/// counts as nothing.
__host__ __device__ __forceinline__ float excess_of(float diag, const float (&inner)[3],
                                                    const float (&outer)[3]) {
  const float excess = exact_sum(diag, inner, outer);
  return excess > 1.2e-7f * diag ? excess : 0.0f;
}

/// Row of a coarse matrix.
struct CoarseCell {
  float diag, ax, ay, az;
  Gates gates;
};

/// Entry (i,j,k) of one of the matrix's arrays, 0 outside the grid.
__host__ __device__ __forceinline__ float entry_or_zero(const Matrix& m, const float* a, int i, int j,
                                                        int k) {
  return i >= 0 && j >= 0 && k >= 0 && i < m.nx && j < m.ny && k < m.nz ? a[m.at(i, j, k)] : 0.0f;
}

/// Coarse cell (i,j,k) from its children.
__host__ __device__ __forceinline__ CoarseCell coarse_cell(const Matrix& fine, int i, int j, int k,
                                                           const Coarsening& rule) {
  const auto entry = [&](const float* a, int fi, int fj, int fk) {
    return entry_or_zero(fine, a, fi, fj, fk);
  };
  const int i0 = 2 * i, j0 = 2 * j, k0 = 2 * k;
  // Faces of the 2x2x2 children along one axis: below, between and above the two layers of children.
  float face[3][3] = {};  // [axis][layer], summed over the four columns
  float excess = 0;
  float child_x[3][2][2], child_y[2][3][2], child_z[2][2][3];
  for (int a = 0; a < 2; ++a) {
    for (int b = 0; b < 2; ++b) {
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
  if (!rule.rows_sum_to_zero) {
    for (int a = 0; a < 2; ++a)
      for (int b = 0; b < 2; ++b)
        for (int c = 0; c < 2; ++c) {
          // Along each axis: the coupling to the partner within the coarse cell, and to the outside of it.
          const float inner[3] = {child_x[1][b][c], child_y[a][1][c], child_z[a][b][1]};
          const float outer[3] = {child_x[2 * a][b][c], child_y[a][2 * b][c], child_z[a][b][2 * c]};
          const bool partner[3] = {i0 + 1 < fine.nx, j0 + 1 < fine.ny, k0 + 1 < fine.nz};
          float missing = 0, weight = 0;
          for (int d = 0; d < 3; ++d) {
            if (outer[d] == 0) missing += 1, weight += rule.held;
            // Where there is no partner the centre stays; where it is inactive, it moves half as far.
            if (inner[d] == 0) missing += 1, weight += partner[d] ? 0.5f * (1 + rule.held) : 1.0f;
          }
          excess += (missing > 0 ? weight / missing : 1.0f) *
                    excess_of(entry(fine.diag, i0 + a, j0 + b, k0 + c), inner, outer);
        }
  }
  CoarseCell coarse{};
  for (int axis = 0; axis < 3; ++axis) {
    const int first = axis == 0   ? i0
                      : axis == 1 ? j0
                                  : k0,
              n = axis == 0   ? fine.nx
                  : axis == 1 ? fine.ny
                              : fine.nz;
    face[axis][0] = rounded_product(face[axis][0], first + 1 < n ? rule.coupling : rule.thin);
    face[axis][2] = rounded_product(face[axis][2], first + 3 < n ? rule.coupling : rule.thin);
    if (face[axis][2] != 0) coarse.gates |= static_cast<Gates>(1u << (2 * axis));
    if (face[axis][0] != 0) coarse.gates |= static_cast<Gates>(2u << (2 * axis));
  }
  // Rounded once: where layers hang together by next to nothing, further errors would outweigh what does.
  coarse.diag =
      exact_sum(excess, {-face[0][0], -face[1][0], -face[2][0]}, {-face[0][2], -face[1][2], -face[2][2]});
  if (excess > rule.held_share * coarse.diag) coarse.gates |= kHeld;
  coarse.ax = face[0][2], coarse.ay = face[1][2], coarse.az = face[2][2];
  return coarse;
}

/// Which cells of level 0 are active, by granules of `rows` x `columns` cells of a plane: mark_live().
struct LiveMarks {
  const unsigned char* marks;  ///< null: take all for active
  int rows, columns, tiles_z, nx;

  __device__ bool any(int i, int j, int k) const {  // in plane i or the next one
    const unsigned char* at = marks + (j / rows * tiles_z + k / columns) * nx + i;
    return at[0] || (i + 1 < nx && at[1]);
  }
};

/// One thread per entry of the coarse arrays, padding included. `live` belongs to the finer level; a coarse
/// cell without an active child has a row of zeros.
__global__ void coarsen(Matrix fine, Matrix shape, MutableMatrix coarse, Coarsening rule, LiveMarks live) {
  const int at = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (at >= shape.size()) return;
  const int k = at % shape.pitch, j = (at / shape.pitch) % shape.ny, i = at / shape.plane();
  CoarseCell c{};
  if (!live.marks || (k < shape.nz && live.any(2 * i, 2 * j, 2 * k))) c = coarse_cell(fine, i, j, k, rule);
  coarse.diag[at] = c.diag;
  coarse.ax[at] = c.ax;
  coarse.ay[at] = c.ay;
  coarse.az[at] = c.az;
  coarse.gates[at] = c.gates;
  coarse.rhs[at] = 0.0f;
}

/// The coarse correction at a fine cell, interpolated linearly from the parent and, along each axis, the
/// neighbour of the parent on the child's side. A neighbour that the parent is not coupled to is replaced by
/// the parent, and the whole is multiplied by wall_weight() for each of them.
__host__ __device__ __forceinline__ float interpolate(float parent, float along_x, float along_y,
                                                      float along_z) {
  return parent + 0.25f * ((along_x - parent) + (along_y - parent) + (along_z - parent));
}

/// Towards a closed wall the correction is constant; towards one where the solution is held at zero it falls
/// to half at the child.
__host__ __device__ __forceinline__ float wall_weight(unsigned gates) {
  return gates & kHeld ? 0.5f : 1.0f;
}

}  // namespace gpuphys::multigrid
