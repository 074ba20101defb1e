// The neighbour grid as a building block. On the host: the grid that is chosen for a box, and the cells of
// coordinates. On the device: what a build sorts, and what a search meets, at the sizes where its tiles and
// bins begin, end and overflow; these are taken from the policy. Exit code 77 if the device part was asked
// for (argument `device`) and there is none.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "core/base/error.hpp"
#include "core/generators/random.hpp"
#include "core/run/gpu/ceilings.hpp"
#include "references/blocks/neighbour_grid.cuh"

namespace gpuphys::testing {
namespace {

using neighbour_grid::Grid, neighbour_grid::NeighbourGrid;
using Point = std::array<float, 3>;

/// Small tiles and bins, so that few points fill and overflow them.
struct SmallPolicy : neighbour_grid::DefaultPolicy {
  static constexpr int bounds_threads = 64;
  static constexpr int bounds_blocks_per_sm = 1;
  static constexpr int split_threads = 64;
  static constexpr int split_each = 2;
  static constexpr int split_blocks_per_sm = 1;
  static constexpr int bin_cells = 64;
  static constexpr int bin_items = 96;
  static constexpr int bin_threads = 32;
  static constexpr int bin_blocks_per_sm = 4;
  static constexpr int z_cells = 1;
};

/// Items with radii of their own, records of 32 bytes: position, radius, index.
struct Balls {
  struct alignas(32) Record {
    float4 ball;
    float4 index;
  };
  const float* x;
  const float* r;
  Record* split;
  float4* sorted;
  int count;

  __device__ const float* positions() const { return x; }
  __device__ const float* radii() const { return r; }
  static constexpr int chunk_floats = 4 * 32;
  __device__ void prefetch(float* chunk, int first, int end) const {
    const int i = first + static_cast<int>(threadIdx.x % 32);
    float* const own = chunk + 4 * (threadIdx.x % 32);
    for (int c = 0; c < 3; ++c) own[c] = i < end ? x[3 * i + c] : 0.0f;
    own[3] = i < end ? r[i] : 0.0f;
  }
  __device__ Record record(const float* chunk, int i) const {
    const float* const own = chunk + 4 * (threadIdx.x % 32);
    return {make_float4(own[0], own[1], own[2], own[3]), make_float4(__int_as_float(i), 0, 0, 0)};
  }
  __device__ float3 position(const Record& b) const { return {b.ball.x, b.ball.y, b.ball.z}; }
  __device__ void placed(const Grid&, int, const Record&) const {}
};

Point at(double x, double y, double z) {
  return {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)};
}

/// Points uniform in a box with a corner at `low`.
std::vector<Point> cloud(std::size_t n, Point low, Point size, std::uint64_t seed = 1) {
  std::vector<Point> points(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      points[i][c] = low[c] + size[c] * static_cast<float>(uniform01(seed, c, i));
  }
  return points;
}

// ---- host ----

neighbour_grid::detail::Bounds bounds_of(Point low, Point high, float radius) {
  return {{low[0], low[1], low[2]}, {high[0], high[1], high[2]}, radius, radius};
}

Grid grid_of(Point low, Point high, float radius, int capacity) {
  return neighbour_grid::detail::choose_grid<neighbour_grid::DefaultPolicy>(bounds_of(low, high, radius),
                                                                            capacity);
}

TEST(NeighbourGridHost, EdgesAreTheLargestReach) {
  // 10 x 20 x 5 m at a reach of 1 m: edges of 1, 1 and (two cells in one edge along z) 1/2 m.
  const Grid g = grid_of(at(0, 0, 0), at(10, 20, 5), 0.5f, 100000);
  EXPECT_EQ(g.cells[0], 11);
  EXPECT_EQ(g.cells[1], 21);
  EXPECT_EQ(g.cells[2], 11);
  EXPECT_EQ(g.total, 11 * 21 * 11);
}

TEST(NeighbourGridHost, CellsGrowWhereThereIsNoRoomForThem) {
  for (const float span : {1e3f, 1e6f, 1e12f, 1e30f}) {
    for (const int capacity : {4096, 100000, 8388608}) {
      const Grid g = grid_of(at(-span, 0, 5), at(span, span, 5), 0.5f, capacity);
      EXPECT_GE(g.total, 1);
      EXPECT_LE(g.total, capacity) << span;
      EXPECT_EQ(g.cells[2], 1);
      for (int d = 0; d < 3; ++d)
        EXPECT_EQ(neighbour_grid::cell_along(g, d, d == 2 ? 5.0f : -span * (d == 0)), 0);
      EXPECT_EQ(neighbour_grid::cell_along(g, 0, span), g.cells[0] - 1);
    }
  }
}

TEST(NeighbourGridHost, BoxesWithoutWidthAndRadiiOfZeroHaveAGrid) {
  EXPECT_EQ(grid_of(at(3, 3, 3), at(3, 3, 3), 1.0f, 4096).total, 1);
  EXPECT_EQ(grid_of(at(3, 3, 3), at(3, 3, 3), 0.0f, 4096).total, 1);
  const Grid line = grid_of(at(0, 0, 0), at(0, 0, 100), 0.5f, 4096);
  EXPECT_EQ(line.total, 201);
  EXPECT_LE(grid_of(at(0, 0, 0), at(1, 1, 1), 0.0f, 4096).total, 4096);
}

TEST(NeighbourGridHost, CellNumbersRiseWithTheCoordinateAndStayInside) {
  const Grid g = grid_of(at(1e6, -3, 0), at(1e6 + 100, 7, 1), 0.3f, 1000000);
  int before = 0;
  for (float x = 999990.0f; x < 1000120.0f; x = std::nextafter(x, 2e6f)) {
    const int c = neighbour_grid::cell_along(g, 0, x);
    EXPECT_GE(c, before);
    EXPECT_LT(c, g.cells[0]);
    before = c;
  }
  EXPECT_EQ(before, g.cells[0] - 1);
}

// ---- device ----

template <class T>
DeviceBuffer<T> upload(const std::vector<T>& host) {
  DeviceBuffer<T> device(host.size());
  GPUPHYS_CUDA(cudaMemcpy(device.get(), host.data(), sizeof(T) * host.size(), cudaMemcpyHostToDevice));
  return device;
}
template <class T>
std::vector<T> download(const T* device, std::size_t count) {
  std::vector<T> host(count);
  GPUPHYS_CUDA(cudaMemcpy(host.data(), device, sizeof(T) * count, cudaMemcpyDeviceToHost));
  return host;
}

__device__ bool within(float4 a, float4 b, float reach) {
  const float x = a.x - b.x, y = a.y - b.y, z = a.z - b.z;
  return x * x + y * y + z * z < reach * reach;
}

/// Of each slot: the others within reach, by columns, by ranges of at most four, and among all.
__global__ void count_neighbours(const Grid* grid, const int* start, const float4* sorted, int count,
                                 float reach, int3* found) {
  const int slot = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (slot >= count) return;
  const float4 p = sorted[slot];
  int3 n{0, 0, 0};
  neighbour_grid::visit_columns(*grid, start, {p.x, p.y, p.z}, reach, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) n.x += within(p, sorted[k], reach);
  });
  neighbour_grid::visit_ranges<4>(
      *grid, start, {p.x, p.y, p.z}, reach, [] {},
      [&](const neighbour_grid::Ranges& ranges) {
        for (int c = 0; c < neighbour_grid::kColumns; ++c) {
          for (int k = ranges.begin[c]; k < ranges.end[c]; ++k) n.y += within(p, sorted[k], reach);
        }
      });
  for (int k = 0; k < count; ++k) n.z += within(p, sorted[k], reach);
  found[slot] = n;
}

struct Built {
  Grid grid;
  std::vector<int> start;
  std::vector<float4> sorted;  // first words
  std::vector<int> index;
};

/// What must hold of any build: cells in order, each item once, in its cell.
void expect_sorted(const Built& b, const std::vector<Point>& points) {
  const int n = static_cast<int>(points.size());
  ASSERT_EQ(b.start.front(), 0);
  ASSERT_EQ(b.start.back(), n);
  std::vector<char> seen(points.size(), 0);
  for (int c = 0; c < b.grid.total; ++c) {
    ASSERT_LE(b.start[c], b.start[c + 1]) << "cell " << c;
    for (int s = b.start[c]; s < b.start[c + 1]; ++s) {
      const float4 p = b.sorted[s];
      const int i = b.index[s];
      ASSERT_TRUE(i >= 0 && i < n) << "slot " << s;
      ASSERT_FALSE(seen[i]) << "item " << i << " twice";
      seen[i] = 1;
      ASSERT_TRUE(p.x == points[i][0] && p.y == points[i][1] && p.z == points[i][2]) << "item " << i;
      ASSERT_EQ(neighbour_grid::cell_of(b.grid, {p.x, p.y, p.z}), c) << "item " << i;
    }
  }
}

std::vector<float> flat(const std::vector<Point>& points) {
  std::vector<float> x;
  for (const Point& p : points) x.insert(x.end(), p.begin(), p.end());
  return x;
}

template <class Policy>
void build_points(const std::vector<Point>& points, float reach, bool count = true) {
  const int n = static_cast<int>(points.size());
  const std::size_t size = points.size();
  const DeviceBuffer<float> x = upload(flat(points));
  NeighbourGrid<Policy> grid;
  grid.template allocate<neighbour_grid::Points>(n);
  DeviceBuffer<float4> split(grid.records(n)), sorted(size);
  // Twice: the second build finds what the first left.
  for (int round = 0; round < 2; ++round) {
    grid.build(neighbour_grid::Points{x.get(), reach, split.get(), sorted.get(), n});
    GPUPHYS_CUDA(cudaDeviceSynchronize());
    Built b;
    b.grid = download(grid.grid(), 1)[0];
    b.start = download(grid.start(), static_cast<std::size_t>(b.grid.total) + 1);
    b.sorted = download(sorted.get(), size);
    for (const float4& p : b.sorted) {
      int i;
      std::memcpy(&i, &p.w, sizeof i);
      b.index.push_back(i);
    }
    ASSERT_NO_FATAL_FAILURE(expect_sorted(b, points)) << "round " << round << ", n " << n;
  }
  if (!count) return;
  DeviceBuffer<int3> found(size);
  count_neighbours<<<static_cast<unsigned>(n + 127) / 128, 128>>>(grid.grid(), grid.start(), sorted.get(), n,
                                                                  reach, found.get());
  GPUPHYS_CUDA(cudaGetLastError());
  for (const int3& f : download(found.get(), size)) {
    ASSERT_EQ(f.x, f.z);
    ASSERT_EQ(f.y, f.z);
  }
}

template <class Policy>
void build_balls(const std::vector<Point>& points, float least, float most) {
  const int n = static_cast<int>(points.size());
  const std::size_t size = points.size();
  std::vector<float> radius(size);
  for (std::size_t i = 0; i < size; ++i)
    radius[i] = least + (most - least) * static_cast<float>(i % 7) / 6.0f;
  const DeviceBuffer<float> x = upload(flat(points)), r = upload(radius);
  NeighbourGrid<Policy> grid;
  grid.template allocate<Balls>(n);
  DeviceBuffer<Balls::Record> split(grid.records(n));
  DeviceBuffer<float4> sorted(2 * size);
  grid.build(Balls{x.get(), r.get(), split.get(), sorted.get(), n});
  GPUPHYS_CUDA(cudaDeviceSynchronize());
  Built b;
  b.grid = download(grid.grid(), 1)[0];
  b.start = download(grid.start(), static_cast<std::size_t>(b.grid.total) + 1);
  b.sorted = download(sorted.get(), 2 * size);
  for (std::size_t s = 0; s < size; ++s) {
    int i;
    std::memcpy(&i, &b.sorted[size + s].x, sizeof i);
    b.index.push_back(i);
    ASSERT_TRUE(i >= 0 && i < n);
    ASSERT_EQ(b.sorted[s].w, radius[static_cast<std::size_t>(i)]);
  }
  ASSERT_NO_FATAL_FAILURE(expect_sorted(b, points)) << "n " << n;
  EXPECT_EQ(b.grid.smallest, *std::min_element(radius.begin(), radius.end()));
  EXPECT_EQ(b.grid.largest, *std::max_element(radius.begin(), radius.end()));
}

TEST(NeighbourGridDevice, OneItem) {
  build_points<SmallPolicy>({at(3, -4, 5)}, 1.0f);
  build_points<neighbour_grid::DefaultPolicy>({at(0, 0, 0)}, 1.0f);
  build_balls<SmallPolicy>({at(1e6, 0, 0)}, 0.5f, 0.5f);
}

// A block splits several tiles once all blocks have one of the largest size. With the last tile a whole one,
// short by one, and of one item.
TEST(NeighbourGridDevice, TilesThatAreFullAndShortOrLongByOne) {
  const auto wave = static_cast<std::size_t>(SmallPolicy::split_blocks_per_sm * multiprocessors());
  const std::size_t tile = NeighbourGrid<SmallPolicy>::kMostInTile;
  for (const std::size_t items : {std::size_t{32}, tile, wave * 32, wave * tile}) {
    for (const std::size_t n : {items - 1, items, items + 1}) {
      build_points<SmallPolicy>(cloud(n, at(-5, 0, 2), at(20, 9, 14), n), 0.9f, n < 5000);
      build_balls<SmallPolicy>(cloud(n, at(-5, 0, 2), at(20, 9, 14), n), 0.2f, 0.45f);
    }
  }
}

// All in one place, so in one bin; and others around, that must not suffer.
TEST(NeighbourGridDevice, ABinThatOverflowsByOneLosesNoItem) {
  for (const int extra : {-1, 0, 1, 2, 500}) {
    std::vector<Point> points = cloud(300, at(0, 0, 0), at(30, 30, 30));
    for (int k = 0; k < SmallPolicy::bin_items + extra; ++k) points.push_back(at(100, 100, 100));
    build_points<SmallPolicy>(points, 2.0f);
    build_balls<SmallPolicy>(points, 0.5f, 1.0f);
  }
  std::vector<Point> points = cloud(300, at(0, 0, 0), at(30, 30, 30));
  for (int k = 0; k < neighbour_grid::DefaultPolicy::bin_items + 1; ++k) points.push_back(at(100, 100, 100));
  build_points<neighbour_grid::DefaultPolicy>(points, 2.0f);
}

TEST(NeighbourGridDevice, SeveralBinsOverflowAtOnce) {
  std::vector<Point> points;
  for (int k = 0; k < 5 * SmallPolicy::bin_items; ++k) {
    points.push_back(at(40 * (k % 3), 0, 0));
    points.push_back(at(0, 40 + 0.01 * k, 0));
  }
  build_points<SmallPolicy>(points, 1.0f);
}

TEST(NeighbourGridDevice, FarCoordinates) {
  for (const double far : {1e4, 1e6, 1e12}) {
    std::vector<Point> points = cloud(700, at(far, -far, 0), at(12, 12, 12));
    build_points<SmallPolicy>(points, 1.0f);
    for (const Point& p : cloud(700, at(-far, far, 3), at(12, 12, 12), 2)) points.push_back(p);
    build_points<SmallPolicy>(points, 1.0f);
    build_points<neighbour_grid::DefaultPolicy>(points, 1.0f);
  }
}

// Pairs exactly at the reach along one axis, and points on edges of cells.
TEST(NeighbourGridDevice, LatticesAtTheReach) {
  std::vector<Point> points;
  for (int i = 0; i < 9; ++i) {
    for (int j = 0; j < 7; ++j) {
      for (int k = 0; k < 11; ++k) points.push_back(at(i, j, -k));
    }
  }
  for (const float reach : {0.5f, 1.0f, 1.0000001f, 2.0f, 2.5f}) build_points<SmallPolicy>(points, reach);
}

TEST(NeighbourGridDevice, BoxesWithoutWidth) {
  for (int axis = 0; axis < 3; ++axis) {
    Point size = at(0, 0, 0);
    size[static_cast<std::size_t>(axis)] = 300;
    build_points<SmallPolicy>(cloud(1500, at(1, 2, 3), size), 1.0f);
  }
}

TEST(NeighbourGridDevice, ReachesFromTinyToHuge) {
  for (const float reach : {1e-9f, 1e9f}) {
    build_points<SmallPolicy>(cloud(900, at(0, 0, 0), {9 * reach, 9 * reach, 9 * reach}), reach);
  }
}

}  // namespace
}  // namespace gpuphys::testing

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const bool device = argc == 2 && std::string(argv[1]) == "device";
  if (argc > 2 || (argc == 2 && !device && std::string(argv[1]) != "host")) {
    std::fprintf(stderr, "usage: test_neighbour_grid_device [host|device]\n");
    return 2;
  }
#ifndef GPUPHYS_EMULATED
  if (device) {
    try {
      gpuphys::require_gpu();
    } catch (const gpuphys::Error& e) {
      std::fprintf(stderr, "test_neighbour_grid_device: %s\n", e.what());
      return static_cast<int>(e.code());
    }
  }
#endif
  testing::GTEST_FLAG(filter) = device ? "NeighbourGridDevice.*" : "NeighbourGridHost.*";
  return RUN_ALL_TESTS();
}
