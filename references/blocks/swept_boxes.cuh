// Boxes swept over the step by the edges or triangles of a moving mesh, and a uniform grid over their
// centres: what the broad phases of the collision tasks are made of. Everything happens on the device.
//
// The grid's cell is the mean extent of the boxes; its number of cells is bounded by a capacity that depends
// on the number of boxes only, for which the cell grows where the scene is sparse. A box is entered once, in
// the cell of its centre, so that a search must reach beyond the box searched for by the largest half extent
// of any box, per axis. Boxes much larger than the mean would make that reach useless: they go to a list of
// their own behind the last cell and meet every box there is.
//
// An axis-aligned box around something long that lies aslant is mostly empty. So boxes also have an interval
// along one of the six diagonals of two axes, the same for all: the one along which a sample of them is
// thinnest compared with its boxes.
//
// Boxes are kept in 20 bytes: the lower corner, the extents as multiples of a unit (a power of two, 1/128 to
// 1/255 of the largest of them) and the interval along the diagonal in the same unit, relative to the corner.
// All are rounded outwards, and everything here works with what is kept.
//
// Overlapping boxes are never missed by rounding: with c_j the centre of j, R at least (c_j - low_j)(1 + u)
// and low_j <= high_i, the float32 number c_j is at most high_i + R and so, rounding being monotone, at most
// fl(high_i + R); the cell of a coordinate is monotone as well.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

#include "core/contract/module.hpp"

namespace gpuphys::collision {

/// x[p] + sign * x[q], p < q.
struct Diagonal {
  int p, q;
  float sign;

  __device__ __forceinline__ float of(float x, float y, float z) const {
    return (p == 0 ? x : y) + sign * (q == 1 ? y : z);
  }
};
constexpr int kDiagonals = 6;
__device__ __forceinline__ constexpr Diagonal diagonal(int number) {
  return {number / 4, number < 2 ? 1 : 2, number % 2 == 0 ? 1.0f : -1.0f};
}

/// Sums of extents: of the largest one of each box, of those along the axes and along the diagonals.
constexpr int kLargest = 0, kAlong = 1, kAlongDiagonal = 4, kExtents = 10;

/// Sums over all boxes, extents over a sample. Extrema are kept as the largest order-preserving code, for
/// which 0 stands below every number: one memset prepares all of them.
struct SceneSums {
  unsigned low_code[3],
      high_code[3];        ///< around the centres; the lower end as that of the negated coordinate
  unsigned reach_code[3];  ///< largest half extent of the boxes in the grid
  float extents[kExtents];
};

__device__ __forceinline__ unsigned encode(float x) {
  const unsigned bits = __float_as_uint(x);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}
__device__ __forceinline__ float decode(unsigned code) {
  return __uint_as_float(code & 0x80000000u ? code & 0x7fffffffu : ~code);
}

struct Grid {
  float low[3], inverse_cell[3];
  int n[3];
  float reach[3];
  float large;  ///< boxes whose largest extent exceeds it are not in the grid
  Diagonal diagonal;

  __device__ __forceinline__ int coordinate(float x, int d) const {
    // The clamp comes first: beyond the grid a float may not fit an int.
    const float top = static_cast<float>(n[d] - 1);
    return static_cast<int>(fminf(fmaxf((x - low[d]) * inverse_cell[d], 0.0f), top));
  }
  __device__ __forceinline__ int row(int y, int z) const { return (z * n[1] + y) * n[0]; }
};

/// Cells as a multiple of the mean extent; boxes above `large` times the mean are kept apart.
struct GridShape {
  float cell_over_extent[3], large_over_extent;
};

__device__ inline Diagonal thinnest_diagonal(const SceneSums& sums) {
  Diagonal thinnest = diagonal(0);
  float least = 2.0f;
  for (int k = 0; k < kDiagonals; ++k) {
    const Diagonal d = diagonal(k);
    const float share =
        sums.extents[kAlongDiagonal + k] / (sums.extents[kAlong + d.p] + sums.extents[kAlong + d.q]);
    if (share < least) {
      least = share;
      thinnest = d;
    }
  }
  return thinnest;
}

/// The same in every thread that asks, once the sums are complete (`reach` needs those of the second pass).
/// `boxes`: how many the sample has.
__device__ inline Grid make_grid(const SceneSums& sums, int boxes, int cell_capacity, GridShape shape) {
  Grid g;
  float range[3], longest = 0.0f;
  for (int d = 0; d < 3; ++d) {
    g.low[d] = -decode(sums.low_code[d]);
    range[d] = decode(sums.high_code[d]) - g.low[d];
    longest = fmaxf(longest, range[d]);
    // The margin covers the rounding of the half extents.
    g.reach[d] = sums.reach_code[d] ? decode(sums.reach_code[d]) * (1.0f + 0x1p-20f) : 0.0f;
  }
  const float mean = sums.extents[kLargest] / static_cast<float>(boxes);
  g.diagonal = thinnest_diagonal(sums);
  g.large = shape.large_over_extent * mean;
  float cell[3];
  for (int d = 0; d < 3; ++d)
    cell[d] = fmaxf(fmaxf(shape.cell_over_extent[d] * mean, 1e-6f * longest), 1e-30f);
  const float capacity = static_cast<float>(cell_capacity) * 0.999f;
  for (;;) {
    float product = 1.0f;
    for (int d = 0; d < 3; ++d) product *= floorf(range[d] / cell[d]) + 2.0f;
    if (!(product > capacity)) break;
    for (int d = 0; d < 3; ++d) cell[d] *= 1.2f;
  }
  for (int d = 0; d < 3; ++d) {
    g.inverse_cell[d] = 1.0f / cell[d];
    g.n[d] = static_cast<int>(floorf(range[d] / cell[d])) + 2;
  }
  return g;
}

/// Cells that boxes may need at least: a scene of a single cell per axis has up to two.
constexpr int kLeastCells = 16;

struct SweptBox {
  float low[3], high[3];
  float along_low, along_high;  ///< the interval along the scene's diagonal

  __device__ __forceinline__ float centre(int d) const { return 0.5f * low[d] + 0.5f * high[d]; }
  __device__ __forceinline__ float extent() const {
    return fmaxf(fmaxf(high[0] - low[0], high[1] - low[1]), high[2] - low[2]);
  }
};

struct CompactBox {
  float low[3];
  unsigned extents;  ///< a byte each, in units; above them the exponent of the unit
  unsigned along;    ///< lower and upper end along the diagonal, 16 bits each, in units from the low corner
};

template <int P>
__device__ __forceinline__ float least_of(const float (&x)[P]) {
  float least = x[0];
#pragma unroll
  for (int k = 1; k < P; ++k) least = fminf(least, x[k]);
  return least;
}
template <int P>
__device__ __forceinline__ float largest_of(const float (&x)[P]) {
  float largest = x[0];
#pragma unroll
  for (int k = 1; k < P; ++k) largest = fmaxf(largest, x[k]);
  return largest;
}

/// Where the corners of a primitive are at t = 0 and at t = 1.
template <int P>
struct Points {
  float x[P], y[P], z[P];

  __device__ __forceinline__ void set(int k, float3 a) {
    x[k] = a.x;
    y[k] = a.y;
    z[k] = a.z;
  }
};

/// Adds the extents of what sweeps from some of the points to the others.
template <int P>
__device__ __forceinline__ void add_extents(float (&sums)[kExtents], const Points<P>& points) {
  const auto extent = [](const float(&a)[P]) { return largest_of(a) - least_of(a); };
  const float along[3] = {extent(points.x), extent(points.y), extent(points.z)};
  sums[kLargest] += fmaxf(fmaxf(along[0], along[1]), along[2]);
#pragma unroll
  for (int d = 0; d < 3; ++d) sums[kAlong + d] += along[d];
#pragma unroll
  for (int k = 0; k < kDiagonals; ++k) {
    float at[P];
#pragma unroll
    for (int q = 0; q < P; ++q) at[q] = diagonal(k).of(points.x[q], points.y[q], points.z[q]);
    sums[kAlongDiagonal + k] += extent(at);
  }
}

/// The box of what sweeps from some of the points to the others, `beyond` times its largest extent wider on
/// each side (0 or a power of two of which 1/256 is much more).
template <int P>
__device__ __forceinline__ CompactBox compact_box(const Diagonal& diagonal, const Points<P>& points,
                                                  float beyond = 0.0f) {
  CompactBox box;
  box.low[0] = least_of(points.x);
  box.low[1] = least_of(points.y);
  box.low[2] = least_of(points.z);
  float extent[3] = {largest_of(points.x) - box.low[0], largest_of(points.y) - box.low[1],
                     largest_of(points.z) - box.low[2]};
  float largest = fmaxf(fmaxf(extent[0], extent[1]), fmaxf(extent[2], 1e-30f));
  if (beyond > 0.0f) {
    const float wider = beyond * largest;
    const float high[3] = {largest_of(points.x), largest_of(points.y), largest_of(points.z)};
#pragma unroll
    for (int d = 0; d < 3; ++d) {
      // The corner goes down by a unit in the last place at least, which may be more than all extents.
      box.low[d] = __fadd_rd(box.low[d], -wider);
      extent[d] = (high[d] - box.low[d]) + 2.0f * wider;
    }
    largest = fmaxf(fmaxf(extent[0], extent[1]), extent[2]);
  }
  // In a unit of 2^(e - 134), e the exponent below, the largest extent is less than 256 / (1 + 2^-7) < 254.1.
  const int e = static_cast<int>(__float_as_uint((1.0f + 0x1p-7f) * largest) >> 23);
  const float units = __uint_as_float(static_cast<unsigned>(261 - e) << 23);
  // Differences are good to 2^-24, so multiples of the unit up to 510 to 1e-4.
  constexpr float slack = 1e-3f;
  box.extents = static_cast<unsigned>(e - 7) << 24;
#pragma unroll
  for (int d = 0; d < 3; ++d)
    box.extents |= static_cast<unsigned>(ceilf(extent[d] * units + slack)) << (8 * d);
  float along[P];
#pragma unroll
  for (int k = 0; k < P; ++k)
    along[k] = diagonal.of(points.x[k] - box.low[0], points.y[k] - box.low[1], points.z[k] - box.low[2]);
  const float margin = slack + 1024.0f * beyond;
  const int low = static_cast<int>(floorf(least_of(along) * units - margin));
  const int high = static_cast<int>(ceilf(largest_of(along) * units + margin));
  box.along = (static_cast<unsigned>(low) & 0xffffu) | static_cast<unsigned>(high) << 16;
  return box;
}

/// What a compact box stands for. Products with the unit are exact.
__device__ __forceinline__ SweptBox expand(const Diagonal& diagonal, const CompactBox& box) {
  SweptBox swept;
  const float unit = __uint_as_float(box.extents >> 24 << 23);
#pragma unroll
  for (int d = 0; d < 3; ++d) {
    swept.low[d] = box.low[d];
    swept.high[d] = box.low[d] + static_cast<float>(box.extents >> (8 * d) & 0xffu) * unit;
  }
  const float p = diagonal.p == 0 ? box.low[0] : box.low[1];
  const float q = diagonal.sign * (diagonal.q == 1 ? box.low[1] : box.low[2]);
  const int low = static_cast<std::int16_t>(box.along), high = static_cast<std::int16_t>(box.along >> 16);
  swept.along_low = __fadd_rd(__fadd_rd(p, q), static_cast<float>(low) * unit);
  swept.along_high = __fadd_ru(__fadd_ru(p, q), static_cast<float>(high) * unit);
  return swept;
}

__device__ __forceinline__ unsigned warp_max(unsigned x) {
  return __reduce_max_sync(0xffffffffu, x);
}
__device__ __forceinline__ float warp_sum(float x) {
  for (int k = 16; k > 0; k /= 2) x += __shfl_xor_sync(0xffffffffu, x, k);
  return x;
}

/// The number of a box's cell; the cell behind the last for a large one.
__device__ __forceinline__ int cell_of(const Grid& g, const SweptBox& box, int cell_capacity) {
  if (box.extent() > g.large) return cell_capacity;
  return g.row(g.coordinate(box.centre(1), 1), g.coordinate(box.centre(2), 2)) +
         g.coordinate(box.centre(0), 0);
}

/// How many multiprocessors the current device has.
inline int multiprocessors() {
  int device = 0, count = 0;
  GPUPHYS_CUDA(cudaGetDevice(&device));
  GPUPHYS_CUDA(cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device));
  return count;
}

}  // namespace gpuphys::collision
