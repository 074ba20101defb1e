// Broad phase of the collision tasks, on the device alone: a uniform grid over the centres of boxes swept
// over the step.
//
// The grid's cell is the mean extent of the boxes; its number of cells is bounded by a capacity that depends
// on the number of boxes only, for which the cell grows where the scene is sparse. A box is entered once, in
// the cell of its centre, so that a search must reach beyond the box searched for by the largest half extent
// of any box, per axis. Boxes much larger than the mean would make that reach useless: they go to a list of
// their own behind the last cell and meet every box there is.
//
// Overlapping boxes are never missed by rounding: with c_j the centre of j, R at least (c_j - low_j)(1 + u)
// and low_j <= high_i, the float32 number c_j is at most high_i + R and so, rounding being monotone, at most
// fl(high_i + R); the cell of a coordinate is monotone as well.
#pragma once

#include <cuda_runtime.h>

#include <cstdint>

namespace gpuphys::collision {

/// Sums over all boxes. Extrema are kept as the largest order-preserving code, for which 0 stands below
/// every number: one memset prepares all of them.
struct SceneSums {
  unsigned low_code[3],
      high_code[3];        ///< around the centres; the lower end as that of the negated coordinate
  unsigned reach_code[3];  ///< largest half extent of the boxes in the grid
  float extent_sum;        ///< of the largest extent of boxes
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

/// The same in every thread that asks, once the sums are complete (`reach` needs those of the second pass).
/// `boxes`: how many `extent_sum` is over, all or a sample.
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
  const float mean = sums.extent_sum / static_cast<float>(boxes);
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

  __device__ __forceinline__ float centre(int d) const { return 0.5f * low[d] + 0.5f * high[d]; }
  __device__ __forceinline__ float extent() const {
    return fmaxf(fmaxf(high[0] - low[0], high[1] - low[1]), high[2] - low[2]);
  }
};

__device__ __forceinline__ SweptBox box_of(float3 a0, float3 b0, float3 a1, float3 b1) {
  const auto low = [](float a, float b, float c, float d) { return fminf(fminf(a, b), fminf(c, d)); };
  const auto high = [](float a, float b, float c, float d) { return fmaxf(fmaxf(a, b), fmaxf(c, d)); };
  return {{low(a0.x, b0.x, a1.x, b1.x), low(a0.y, b0.y, a1.y, b1.y), low(a0.z, b0.z, a1.z, b1.z)},
          {high(a0.x, b0.x, a1.x, b1.x), high(a0.y, b0.y, a1.y, b1.y), high(a0.z, b0.z, a1.z, b1.z)}};
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

}  // namespace gpuphys::collision
